"""Test strapdown propagation against SciPy's rotations and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState


def samples(rng, n=50):
    return 0.01 * rng.standard_normal((n, 3)), 0.02 + 0.01 * rng.standard_normal((n, 3))


def test_a_correction_keeps_the_quaternion_a_rotation():
    state = StrapdownState(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1.622)
    rng = np.random.default_rng(4)
    for _ in range(10_000):
        state.correct(1e-2 * rng.standard_normal(15))
    assert np.linalg.norm(state.attitude) == pytest.approx(1.0, abs=1e-12)


UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def test_bad_starts_are_refused():
    zero = np.zeros(3)
    with pytest.raises(InputError, match="finite"):
        StrapdownState(np.full(3, np.nan), zero, UPRIGHT, 1.622)
    for attitude in (np.zeros(4), 1.5 * UPRIGHT):
        with pytest.raises(InputError, match=r"navigation\.attitude"):
            StrapdownState(zero, zero, attitude, 1.622)
    for step in (0.0, -0.01, np.nan):
        with pytest.raises(InputError, match=r"navigation\.step"):
            StrapdownState(zero, zero, UPRIGHT, 1.622, step=step)
    with pytest.raises(InputError, match=r"navigation\.velocity"):
        StartSigmas(velocity=0.0)


@pytest.mark.parametrize("gravity", [0.0, -1.0, 1e3, np.nan, np.inf])
def test_implausible_gravity_is_rejected(gravity):
    with pytest.raises(InputError, match=r"navigation\.gravity"):
        StrapdownState(np.zeros(3), np.zeros(3), UPRIGHT, gravity)


@pytest.mark.parametrize(
    ("position", "velocity", "field"),
    [
        ([0.0, 0.0, 1e9], [0.0, 0.0, 0.0], "position"),
        ([0.0, -2e6, 0.0], [0.0, 0.0, 0.0], "position"),
        ([0.0, 0.0, 100.0], [1e6, 0.0, 0.0], "velocity"),
    ],
)
def test_implausible_start_is_rejected(position, velocity, field):
    with pytest.raises(InputError, match=rf"navigation\.{field}"):
        StrapdownState(np.array(position), np.array(velocity), UPRIGHT, 1.622)


@pytest.mark.parametrize("error", [np.full(15, np.nan), np.r_[np.zeros(14), np.inf], np.zeros(14)])
def test_invalid_correction_is_rejected_without_change(error):
    state = StrapdownState(np.ones(3), np.ones(3), UPRIGHT, 1.622)
    with pytest.raises(InputError, match=r"navigation\.error"):
        state.correct(error)
    assert np.array_equal(state.position, np.ones(3))
    assert np.array_equal(state.attitude, UPRIGHT)


@pytest.mark.parametrize("value", [1e6, -1e6, np.inf])
@pytest.mark.parametrize("which", ["angle", "velocity"])
def test_a_sample_that_no_lander_could_give_counts_as_missing(which, value):
    rng = np.random.default_rng(5)
    angle, velocity = samples(rng, 10)
    wild = {"angle": angle.copy(), "velocity": velocity.copy()}
    wild[which][4, 1] = value
    angle[4], velocity[4] = np.nan, np.nan
    found = []
    for a, v in ((angle, velocity), (wild["angle"], wild["velocity"])):
        state = StrapdownState(np.zeros(3), np.zeros(3), UPRIGHT, 1.622)
        found.append((*state.propagate(a, v), state.position.copy(), state.velocity.copy()))
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


def test_rotation_adds_scale_factor_and_misalignment_errors():
    """Rotate about one axis and back with random errors; compare the attitude error."""
    errors = TriadErrors(scale_factor=1e-3, misalignment=5e-4)
    state = StrapdownState(
        np.zeros(3), np.zeros(3), UPRIGHT, 1e-3, gyroscopes=errors, accelerometers=TriadErrors()
    )
    turn = np.zeros((100, 3))
    turn[:, 1] = 0.5 / 100
    _, noise = state.propagate(turn, np.zeros((100, 3)))
    expected = np.square([5e-4 * 0.5, 1e-3 * 0.5, 5e-4 * 0.5])
    assert np.diag(noise)[9:12] == pytest.approx(expected, rel=1e-6)
    _, back = state.propagate(-turn, np.zeros((100, 3)))
    assert np.diag(back)[9:12] == pytest.approx(np.zeros(3), abs=1e-15)


def test_scale_factor_and_misalignment_are_biases_under_steady_thrust():
    """3 m/s^2 times each, in addition to the bias itself."""
    unit = TriadErrors(bias=3e-3, random_walk=1e-4, bias_walk=0.0, scale_factor=1e-3,
                       misalignment=2e-3)  # fmt: skip
    state = StrapdownState(
        np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1.6, accelerometers=unit
    )
    expected = 9e-6 + 9.0 * (1e-6 + 4e-6)
    assert np.diag(state.covariance(StartSigmas()))[6:9] == pytest.approx(np.full(3, expected))
