"""Test the error state against filters with full matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.error_state import POSE, ErrorState
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.schmidt_kalman_covariance import inflate
from tests.onboard.navigation.states import BLOCKS, SIZE, UPRIGHT, made


def still() -> StrapdownState:
    """Return a lander at rest at the origin."""
    return StrapdownState(np.zeros(3), np.zeros(3), UPRIGHT, 1.6)


@given(st.integers(0, 10_000), st.integers(0, 9), st.integers(1, 4))
def test_measurement_equals_joseph_form(seed, tail, m):
    rng = np.random.default_rng(seed)
    state = made(rng, tail)
    p = state.covariance.copy()
    columns = rng.permutation(len(p))[: rng.integers(1, 7)]
    jacobian, innovation = rng.normal(size=(m, len(columns))), 1e-3 * rng.normal(size=m)
    noise = rng.uniform(0.1, 2.0, m)
    h = np.zeros((m, len(p)))
    h[:, columns] = jacobian
    s = h @ p @ h.T + np.diag(noise)
    gain = p @ h.T @ np.linalg.inv(s)
    left = np.eye(len(p)) - gain @ h
    expected = left @ p @ left.T + gain @ np.diag(noise) @ gain.T
    corrections = []
    state.listeners.append(corrections.append)
    before = state.inertial.position.copy()
    outcome = state.measure(jacobian, columns, innovation, noise)
    assert outcome.is_accepted
    assert outcome.nis == pytest.approx(innovation @ np.linalg.solve(s, innovation))
    assert state.covariance == pytest.approx(expected, rel=1e-8, abs=1e-10)
    assert corrections[0] == pytest.approx(gain @ innovation, abs=1e-12)
    assert state.inertial.position - before == pytest.approx(corrections[0][:3], abs=1e-12)
    assert state.value("ground") == pytest.approx(corrections[0][21:22], abs=1e-15)


@given(st.integers(0, 10_000))
def test_information_equals_measurement(seed):
    rng = np.random.default_rng(seed)
    one, other = made(rng), None
    other = ErrorState(
        StrapdownState(one.inertial.position, one.inertial.velocity, UPRIGHT, 1.6),
        StartSigmas(), blocks=BLOCKS,
    )  # fmt: skip
    other.covariance[:] = one.covariance
    jacobian, innovation = rng.normal(size=(9, 6)), 1e-3 * rng.normal(size=9)
    one.measure(jacobian, POSE, innovation, np.full(9, 0.25))
    other.update_with_information(
        POSE, jacobian.T @ jacobian / 0.25, jacobian.T @ innovation / 0.25
    )
    assert other.covariance == pytest.approx(one.covariance, rel=1e-7, abs=1e-9)
    assert other.inertial.position == pytest.approx(one.inertial.position, abs=1e-12)


@given(st.integers(0, 10_000))
def test_clone_has_error_of_source(seed):
    rng = np.random.default_rng(seed)
    state = made(rng)
    p = state.covariance.copy()
    copy = np.eye(SIZE)
    copy[15:21] = 0.0
    copy[np.arange(15, 21), POSE] = 1.0
    state.clone("key", POSE)
    assert state.covariance == pytest.approx(copy @ p @ copy.T)


def test_weighted_sum_has_error_of_sources():
    state = made(np.random.default_rng(3), tail=4)
    before = state.covariance.copy()
    at = state.size - 1
    sources, weights = np.array([1, at - 2, at]), np.array([0.2, 0.5, 0.3])
    h = np.eye(state.size)
    h[at] = 0.0
    h[at, sources] = weights
    expected = h @ before @ h.T
    expected[at, at] += 0.25
    state.replace_by_sum(at, sources, weights, 0.25)
    assert state.covariance == pytest.approx(expected)


def test_propagation_updates_cross_covariance():
    rng = np.random.default_rng(1)
    state = made(rng, 4)
    p = state.covariance.copy()
    angle, velocity = 1e-3 * rng.normal(size=(10, 3)), 1e-2 * rng.normal(size=(10, 3))
    twin = StrapdownState(state.inertial.position, state.inertial.velocity, UPRIGHT, 1.6)
    transition, noise = twin.propagate(angle, velocity)
    state.propagate(angle, velocity)
    whole = np.eye(len(p))
    whole[:15, :15] = transition
    expected = whole @ p @ whole.T
    expected[:15, :15] += noise
    assert state.covariance == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_gated_and_non_finite_innovations_change_nothing():
    state = made(np.random.default_rng(2))
    p, x = state.covariance.copy(), state.inertial.position.copy()
    for innovation, noise, gate in (
        ([100.0], [0.1], 16.0), ([np.nan], [0.1], 16.0), ([np.inf], [0.1], np.inf),
        ([0.1], [np.nan], 16.0),
    ):  # fmt: skip
        assert not state.measure([[1.0]], [2], innovation, noise, gate).is_accepted
    assert np.array_equal(state.covariance, p)
    assert np.array_equal(state.inertial.position, x)


def test_inflation_scales_conditional_variance_only():
    state = made(np.random.default_rng(3))
    p, at = state.covariance.copy(), [3, 4, 5]
    others = np.setdiff1d(np.arange(SIZE), at)
    told = p[np.ix_(at, others)] @ np.linalg.solve(p[np.ix_(others, others)], p[np.ix_(others, at)])
    state.inflate(at, 9.0, 1e3)
    expected = p.copy()
    expected[np.ix_(at, at)] = told + 9.0 * (p[np.ix_(at, at)] - told)
    assert state.covariance == pytest.approx(expected, rel=1e-6)
    grown = np.sqrt(expected[5, 5])
    for _ in range(40):
        state.inflate(at, 1e4, [50.0, 50.0, 1.0])
    assert np.sqrt(np.diag(state.covariance))[at] == pytest.approx([50.0, 50.0, max(1.0, grown)])
    assert np.linalg.eigvalsh(state.covariance).min() > 0.0


def test_uncorrelated_errors_are_inflated_entirely():
    state = ErrorState(still(), blocks={"two": [[4.0, 3.9], [3.9, 4.0]]})
    own, before = np.arange(15, 17), state.covariance.copy()
    state.inflate(own, 9.0, np.full(2, 1e3))
    assert state.covariance[15:, 15:] == pytest.approx(9.0 * before[15:, 15:])
    assert np.array_equal(state.covariance[:15], before[:15])
    whole = state.covariance.copy()
    state.inflate(np.arange(17), 2.0, np.full(17, 1e9))
    assert state.covariance == pytest.approx(2.0 * whole)


@pytest.mark.parametrize("doubted", [0, 1])
def test_inflated_errors_gain_no_information(doubted):
    """Two heights of 5 m, equal to 2 cm: inflating one gives no information on either."""
    both = 25.0 + np.diag([2e-4, 2e-4])
    state = ErrorState(still(), blocks={"heights": both})
    for _ in range(3):
        state.inflate([15 + doubted], 100.0, [1e3])
        difference = state.covariance[15, 15] + state.covariance[16, 16]
        difference -= 2.0 * state.covariance[15, 16]
        state.measure([[1.0, -1.0]], [15, 16], [0.0], [1e-4])
        assert difference > 5e-3, "either may have changed"
        assert np.sqrt(np.diag(state.covariance)[15:]).min() > 4.9


def test_indefinite_covariance_is_reported_and_not_used():
    state = made(np.random.default_rng(5))
    state.covariance[2, 2] = -10.0
    x = state.inertial.position.copy()
    outcome = state.measure([[1.0]], [2], [0.1], [0.1])
    assert not outcome.is_accepted
    assert outcome.nis == np.inf
    assert np.array_equal(state.inertial.position, x)


@pytest.mark.parametrize(
    ("angle", "velocity", "field"),
    [
        (np.zeros((10, 3)), np.zeros((9, 3)), "velocity"),
        (np.zeros((10, 2)), np.zeros((10, 2)), "angle"),
        (np.zeros((10, 3)), np.zeros((10, 4)), "velocity"),
        (np.zeros((2, 10, 3)), np.zeros((2, 10, 3)), "angle"),
    ],
)
def test_samples_of_another_shape_are_refused(angle, velocity, field):
    state = made(np.random.default_rng(4))
    p, x = state.covariance.copy(), state.inertial.position.copy()
    with pytest.raises(InputError, match=field):
        state.propagate(angle, velocity)
    assert np.array_equal(state.covariance, p)
    assert np.array_equal(state.inertial.position, x)


@pytest.mark.parametrize(
    "given", [[[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]], [[np.nan]], [[1.0, 0.0]]]
)
def test_invalid_covariances_are_rejected(given):
    inertial = StrapdownState(np.zeros(3), np.zeros(3), UPRIGHT, 1.6)
    with pytest.raises(InputError, match=r"navigation\.bias"):
        ErrorState(inertial, blocks={"bias": given})


def test_precise_comparisons_keep_covariance_valid():
    """Two nearly identical poses, compared repeatedly to 0.1 mm."""
    rng = np.random.default_rng(3)
    state = ErrorState(still(), StartSigmas(30.0, 10.0, 0.2), blocks={"key": np.zeros((6, 6))})
    state.clone("key", POSE)
    state.propagate(1e-3 * rng.normal(size=(10, 3)), 1e-2 * rng.normal(size=(10, 3)))
    part = np.concatenate((POSE, np.arange(15, 21)))
    own = rng.normal(size=(50, 6)) * [1.0, 1.0, 1.0, 100.0, 100.0, 100.0]
    jacobian = np.hstack((own, -own + 1e-3 * rng.normal(size=(50, 6))))
    for _ in range(5):
        found = state.update_with_information(part, 1e8 * jacobian.T @ jacobian, np.zeros(12))
        assert found.is_accepted
    sigma = np.sqrt(state.covariance.diagonal())
    assert np.linalg.eigvalsh(state.covariance / np.outer(sigma, sigma)).min() > -1e-12
    moved = jacobian @ state.covariance[np.ix_(part, part)] @ jacobian.T
    assert np.diag(moved).max() < 1e-8


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_non_finite_information_is_ignored(broken):
    state = ErrorState(still())
    before = state.covariance.copy()
    information, vector = np.eye(6), np.zeros(6)
    vector[2] = broken
    assert np.isnan(state.update_with_information(POSE, information, vector).nis)
    information[1, 1] = broken
    assert np.isnan(state.update_with_information(POSE, information, np.zeros(6)).nis)
    assert np.array_equal(state.covariance, before)


def test_information_on_invalid_covariance_is_rejected():
    state = ErrorState(still())
    state.p[0, 0] = -1.0
    found = state.update_with_information(POSE, np.eye(6), np.zeros(6))
    assert (found.nis, found.is_accepted) == (np.inf, False)
    state.inflate(POSE, 4.0, np.full(6, 10.0))
    assert np.isfinite(state.covariance).all()
    state.p[3, 3] = np.nan
    state.inflate(POSE, 4.0, np.full(6, 10.0))
    assert np.isfinite(state.covariance[np.ix_(POSE, POSE)]).all()


def test_information_is_gated_like_measurement():
    rng = np.random.default_rng(8)
    one, other = made(np.random.default_rng(5)), made(np.random.default_rng(5))
    jacobian, innovation = rng.normal(size=(6, 6)), 0.3 * rng.normal(size=6)
    expected = one.measure(jacobian, POSE, innovation, np.full(6, 0.2))
    found = other.update_with_information(
        POSE, jacobian.T @ jacobian / 0.2, jacobian.T @ innovation / 0.2
    )
    assert (found.nis, found.dof) == (pytest.approx(expected.nis, rel=1e-6), 6)
    assert found.whitened @ found.whitened == pytest.approx(found.nis)


def test_directions_without_information_do_not_count():
    state = ErrorState(still(), StartSigmas(1.0, 0.1, 0.01))
    # 1e-4 of what is known of the height, and a vector in it of a hundred deviations.
    information, vector = np.diag([4.0, 4.0, 1e-4, 0.0, 0.0, 0.0]), np.zeros(6)
    vector[2] = 1.0
    found = state.update_with_information(POSE, information, vector, min_probability=1e-3)
    assert (found.nis, found.dof, found.is_accepted) == (0.0, 2, True)
    # They move nothing either: repeated a thousand times, the steps would add up.
    assert not state.inertial.position.any()
    assert state.covariance[2, 2] == 1.0


@pytest.mark.parametrize(("deviations", "taken"), [(3.2, True), (3.4, False)])
def test_improbable_correction_is_rejected(deviations, taken):
    """One degree of freedom and a probability of 0.001: 3.29 standard deviations."""
    state = ErrorState(still(), StartSigmas(1.0, 0.1, 0.01))
    before = state.covariance.copy()
    # 1 m before and 0.5 m measured: the innovation has 1.25 m^2.
    innovation = deviations * np.sqrt(1.25)
    information, vector = np.diag([4.0, 0, 0, 0, 0, 0]), np.array([4.0 * innovation, 0, 0, 0, 0, 0])
    found = state.update_with_information(POSE, information, vector, min_probability=1e-3)
    assert found.nis == pytest.approx(deviations**2, rel=1e-6)
    assert found.is_accepted == taken
    assert np.array_equal(state.covariance, before) != taken
    assert bool(state.inertial.position.any()) == taken


def test_raised_variances_reach_given_sigma():
    state = made(np.random.default_rng(6))
    before = state.covariance.copy()
    sigma = np.sqrt(before.diagonal())
    state.raise_variances(np.array([3, 16]), [2.0 * sigma[3], 0.5 * sigma[16]])
    change = state.covariance - before
    assert change[3, 3] == pytest.approx(3.0 * before[3, 3])
    change[3, 3] = 0.0
    assert not change.any()


@pytest.mark.parametrize("error", [np.full(15, np.nan), np.zeros(12)])
def test_invalid_correction_changes_nothing(error):
    state = ErrorState(still(), StartSigmas())
    state.listeners.append(lambda told: pytest.fail("told of it"))
    before = state.covariance.copy()
    with pytest.raises(InputError, match=r"navigation\.error"):
        state.correct(error)
    assert np.array_equal(state.covariance, before)


@pytest.mark.parametrize("way", ["measure", "update_with_information", "at rest"])
def test_invalid_covariance_elsewhere_rejects_updates(way):
    """The measured errors are valid, but errors correlated with them are not finite."""
    state = ErrorState(still(), StartSigmas(), blocks={"spoilt": np.eye(1)}, capacity=2)
    state.tail = 2
    state.covariance[16:, 16:] = np.eye(2)
    state.freeze_tail(np.array([way == "at rest"] * 2))
    state.covariance[15, 0] = state.covariance[0, 15] = np.nan
    before = state.covariance.copy()
    if way == "update_with_information":
        found = state.update_with_information(np.arange(3), np.eye(3), np.ones(3))
    else:
        found = state.measure(np.eye(3), np.arange(3), np.ones(3), np.ones(3))
    assert not found.is_accepted
    assert found.nis == np.inf
    assert np.array_equal(state.covariance, before, equal_nan=True)
    assert np.array_equal(state.inertial.position, np.zeros(3))


@pytest.mark.parametrize("size", [0.02, 0.3, 5.0])
def test_velocity_correction_transforms_error_with_tilt(size):
    """The conserved error, ``e_v + v x e_tilt``, is that of an invariant filter."""
    rng = np.random.default_rng(7)
    turned = rng.normal(size=4)
    turned /= np.linalg.norm(turned)
    inertial = StrapdownState(rng.normal(size=3), rng.normal(size=3), turned, 1.6)
    state = ErrorState(inertial, StartSigmas(), blocks=BLOCKS)
    root = rng.normal(size=(SIZE, SIZE))
    state.covariance[:] = p = root @ root.T
    change = size * rng.normal(size=3)
    x, y, z = change
    error = np.zeros(SIZE)
    error[3:6] = change
    admit_and_propagate = np.eye(SIZE)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    admit_and_propagate[3:6, 9:12] = -cross @ Rotation.from_quat(turned).as_matrix()
    expected = admit_and_propagate @ p @ admit_and_propagate.T
    state.correct(error)
    assert state.covariance == pytest.approx(expected, abs=1e-10)


def test_inflation_works_with_identical_errors():
    # The first two errors are identical, and the third differs by 0.1.
    p = np.ones((3, 3))
    p[2, 2] = 1.01
    inflate(p, [2], 4.0, 1e3)
    assert p[2, 2] == pytest.approx(1.0 + 4.0 * 0.01, rel=1e-4)


def test_inflation_is_total_with_invalid_covariance():
    p = np.eye(3)
    p[0, 0] = np.nan
    inflate(p, [2], 4.0, 1e3)
    assert p[2, 2] == pytest.approx(4.0)
    inflate(p, [], 4.0, 1e3)
    assert p[2, 2] == pytest.approx(4.0)


@pytest.mark.parametrize(("factor", "most"), [(0.5, 1.0), (np.nan, 1.0), (4.0, np.nan), (4.0, -1)])
def test_invalid_inflation_is_rejected(factor, most):
    p = np.eye(3)
    with pytest.raises(InputError):
        inflate(p, [1], factor, most)
    assert np.array_equal(p, np.eye(3))
