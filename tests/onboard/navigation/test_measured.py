"""Test measurement models against finite differences and random errors."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.frames import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_to_rotation_vector,
)
from lunarsim.messages.measurements import AttitudeReading
from lunarsim.models.instruments import StarTrackerInstrument
from lunarsim.onboard.navigation.error_state import ErrorState
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.measurement_models import (
    update_with_attitude,
    update_with_range,
    update_with_speeds,
)
from lunarsim.onboard.navigation.navigator import Navigator
from tests.chance import ratio_bounds

BEAMS = np.array([[0.38, 0.0, -0.925], [-0.19, 0.33, -0.925], [-0.19, -0.33, -0.925]])
BEAMS /= np.linalg.norm(BEAMS, axis=1)[:, None]
ERRORS = StartSigmas(2.0, 0.2, 4e-3)
BLOCKS = {"ground": [[1.0]], "stars": 1e-6 * np.eye(3), "beams": 4e-4 * np.eye(3)}


class Truth:
    """Lander and a filter with errors drawn from its covariance."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.attitude = quat_from_rotation_vector(0.15 * rng.normal(size=3))
        self.position = np.array([5.0, -3.0, 120.0]) + rng.normal(size=3)
        self.velocity = np.array([6.0, 1.0, -8.0]) + rng.normal(size=3)
        self.ground, self.mounted = rng.normal(), 1e-3 * rng.normal(size=3)
        self.off = 0.02 * rng.normal(size=3)
        drawn = rng.normal(size=(3, 3))
        turn = quat_from_rotation_vector(-ERRORS.attitude * drawn[2])
        self.state = ErrorState(
            StrapdownState(
                self.position - ERRORS.position * drawn[0],
                self.velocity - ERRORS.velocity * drawn[1],
                quat_multiply(self.attitude, turn), 1.6,
            ), ERRORS, blocks=BLOCKS,
        )  # fmt: skip

    def range(self, beam, sigma=0.0) -> float:
        down = -quat_rotate(self.attitude, beam)[2]
        return (self.position[2] - self.ground) / down + sigma * self.rng.normal()

    def speeds(self, sigma=0.0):
        own = quat_rotate(quat_conjugate(self.attitude), self.velocity)
        return BEAMS @ own + sigma * self.rng.normal(size=3)

    def biased(self, sigma):
        beams = self.state.block("beams")
        return update_with_speeds(
            self.state,
            self.speeds(sigma) + self.off,
            np.full(3, sigma),
            BEAMS,
            bias_indices=np.arange(beams.start, beams.stop),
            bias_estimates=self.state.value("beams"),
        )

    def stars(self, sigma=0.0):
        turn = self.mounted + sigma * self.rng.normal(size=3)
        return quat_multiply(self.attitude, quat_from_rotation_vector(turn))

    def error(self):
        """Return the error of position, velocity, attitude and blocks (16,), and its covariance."""
        s = self.state
        turn = quat_to_rotation_vector(
            quat_multiply(quat_conjugate(s.inertial.attitude), self.attitude)
        )
        error = np.concatenate((
            self.position - s.inertial.position, self.velocity - s.inertial.velocity, turn,
            self.ground - s.value("ground"), self.mounted - s.value("stars"),
            self.off - s.value("beams"),
        ))  # fmt: skip
        keep = np.r_[0:6, 9:12, 15:22]
        return error, s.covariance[np.ix_(keep, keep)]


TAKE = {
    "range": lambda t, s: update_with_range(t.state, t.range(BEAMS[0], s), s, BEAMS[0], 0.0,
                                     block="ground"),
    "speeds": lambda t, s: update_with_speeds(t.state, t.speeds(s), np.full(3, s), BEAMS),
    "biased speeds": lambda t, s: t.biased(s),
    "attitude": lambda t, s: update_with_attitude(
        t.state, t.stars(s), s**2 * np.eye(3), block="stars"
    ),
}  # fmt: skip
SIGMA = {"range": 0.5, "speeds": 0.05, "biased speeds": 0.01, "attitude": 1e-3}


@pytest.mark.statistical
@pytest.mark.parametrize("kind", list(TAKE))
def test_errors_match_covariance_after_update(kind):
    before, nees, nis, degrees = 0.0, 0.0, 0.0, 0
    flights = 400
    for seed in range(flights):
        t = Truth(seed)
        e, p = t.error()
        before += e @ np.linalg.solve(p, e)
        for _ in range(3):
            outcome = TAKE[kind](t, SIGMA[kind])
            assert outcome.is_accepted
            nis, degrees = nis + outcome.nis, degrees + outcome.dof
        e, p = t.error()
        nees += e @ np.linalg.solve(p, e)
    for total, count in ((before, 16 * flights), (nees, 16 * flights), (nis, degrees)):
        low, high = ratio_bounds(count)
        assert low < total / count < high


def test_common_errors_are_not_averaged():
    t = Truth(3)
    for _ in range(2000):
        TAKE["attitude"](t, 1e-4)
    sigma = np.sqrt(np.diag(t.state.covariance)[9:12])
    # Prior uncertainty: 1 mrad of the tracker's mount, 4 mrad of the attitude.
    assert sigma == pytest.approx(1e-3 * 4.0 / np.hypot(1.0, 4.0), rel=0.01)


def test_estimated_mount_is_used():
    """An attitude known to 0.1 mrad shows a mount error of 5 mrad (10 mrad prior)."""
    sure = StartSigmas(2.0, 0.2, 1e-4)
    state = ErrorState(
        StrapdownState(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1.6), sure,
        blocks={"stars": 1e-4 * np.eye(3)},
    )  # fmt: skip
    mounted = np.array([5e-3, -3e-3, 4e-3])
    for _ in range(10):
        found = update_with_attitude(
            state, quat_from_rotation_vector(mounted), 1e-10 * np.eye(3), block="stars"
        )
    assert state.value("stars") == pytest.approx(mounted, rel=1e-3)
    assert found.nis < 1e-6


def test_speeds_do_not_inform_on_position():
    t = Truth(4)
    p = np.diag(t.state.covariance).copy()
    for _ in range(50):
        TAKE["speeds"](t, 0.03)
    after = np.diag(t.state.covariance)
    assert (after[3:6] < 0.2 * p[3:6]).all()
    assert after[:3] == pytest.approx(p[:3])


BAD = [
    lambda s: update_with_range(s, np.nan, 1.0, BEAMS[0], 0.0),
    lambda s: update_with_range(s, 100.0, 0.0, BEAMS[0], 0.0),
    lambda s: update_with_range(s, 100.0, np.nan, BEAMS[0], 0.0),
    lambda s: update_with_range(s, 100.0, 1e155, BEAMS[0], 0.0),
    lambda s: update_with_range(s, np.inf, 1.0, BEAMS[0], 0.0),
    lambda s: update_with_range(s, 100.0, 1.0, -BEAMS[0], 0.0),
    lambda s: update_with_range(s, 100.0, 1.0, BEAMS[0], 1e4, gate=16.0),
    lambda s: update_with_range(s, -100.0, 1.0, BEAMS[0], 0.0),
    lambda s: update_with_range(s, 1e6, 1.0, BEAMS[0], 0.0, gate=16.0),
    lambda s: update_with_speeds(s, np.full(3, np.nan), np.full(3, 0.1), BEAMS),
    lambda s: update_with_speeds(s, np.zeros(3), np.zeros(3), BEAMS),
    lambda s: update_with_speeds(s, np.full(3, 1e6), np.full(3, 0.1), BEAMS, 23.0),
    lambda s: update_with_attitude(s, np.full(4, np.nan), np.eye(3)),
    lambda s: update_with_attitude(s, np.zeros(4), np.eye(3)),
    lambda s: update_with_attitude(s, [0.0, 0.0, 0.0, 1.5], np.eye(3)),
    lambda s: update_with_attitude(s, [0.0, 0.0, 0.0, 1.0], np.full((3, 3), np.nan)),
    lambda s: update_with_attitude(s, [0.0, 0.0, 0.0, 1.0], -np.eye(3)),
    lambda s: update_with_attitude(s, [0.0, 0.0, 0.0, 1.0], np.zeros((3, 3))),
    lambda s: s.measure([[1.0]], [2], [0.1], [-20.0]),
]


@pytest.mark.parametrize("call", BAD)
def test_invalid_reading_changes_nothing(call):
    state = Truth(5).state
    p, x = state.covariance.copy(), state.inertial.position.copy()
    assert not call(state).is_accepted
    assert np.array_equal(state.covariance, p)
    assert np.array_equal(state.inertial.position, x)


def test_asymmetric_attitude_covariance_is_ignored():
    """If it counted as a rejected innovation, navigation would soon be lost."""
    lopsided = np.array([[1.0, 1e6, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = update_with_attitude(Truth(5).state, [0.0, 0.0, 0.0, 1.0], lopsided)
    assert np.isnan(found.nis)
    assert not found.is_accepted


def test_a_beam_without_a_return_leaves_the_others():
    t = Truth(6)
    speed = t.speeds()
    speed[1] = np.nan
    assert update_with_speeds(t.state, speed, np.full(3, 0.1), BEAMS).dof == 2


def test_whitened_speeds_keep_the_places_of_their_beams():
    truth = Truth(11)
    speed = truth.speeds(0.03)
    speed[1] = np.nan
    found = update_with_speeds(truth.state, speed, np.full(3, 0.03), BEAMS)
    assert found.dof == 2
    assert np.isfinite(found.whitened).tolist() == [True, False, True]
    assert np.nansum(found.whitened**2) == pytest.approx(found.nis)


def test_successive_velocity_updates_do_not_inform_on_tilt():
    """One beam at a time, at many attitudes and no time step: tilt is not observable."""
    rng = np.random.default_rng(8)
    attitude = quat_from_rotation_vector([0.1, -0.2, 0.05])
    state = ErrorState(
        StrapdownState(np.zeros(3), np.array([30.0, 5.0, -20.0]), attitude, 1.6),
        StartSigmas(1.0, 10.0, 4e-3),
    )
    own = quat_rotate(quat_conjugate(attitude), state.inertial.velocity + [12.0, -9.0, 7.0])
    before = state.covariance[9:12, 9:12].copy()
    for k in range(60):
        seen = np.full(3, np.nan)
        # Three readings of a beam, then the next one.
        seen[k // 3 % 3] = BEAMS[k // 3 % 3] @ own + 0.03 * rng.normal()
        update_with_speeds(state, seen, np.full(3, 0.03), BEAMS)
    # The tilt limits the velocity accuracy: 45 m/s times 4 mrad.
    assert 0.05 < np.sqrt(np.diag(state.covariance)[3:6].max()) < 0.2
    assert state.covariance[9:12, 9:12] == pytest.approx(before, rel=1e-3, abs=1e-8)


def test_a_slanted_range_has_the_terrain_variance_along_the_beam():
    """A height error dh at the footprint changes the range by dh over the cosine of the beam."""
    t, rough = Truth(5), Truth(5)
    beam = np.array([np.sin(1.0), 0.0, -np.cos(1.0)])
    down = -quat_rotate(t.state.inertial.attitude, beam)[2]
    assert down < 0.7
    innovation = 3.0
    far = t.state.inertial.position[2] / down + innovation
    plain = update_with_range(t.state, far, 0.5, beam, 0.0, block="ground")
    found = update_with_range(
        rough.state, far, 0.5, beam, 0.0, block="ground", terrain_variance=10.0**2
    )
    more = innovation**2 / found.nis - innovation**2 / plain.nis
    assert more == pytest.approx(10.0**2 / down**2)
    assert np.trace(rough.state.covariance[:3, :3]) > np.trace(t.state.covariance[:3, :3])


@pytest.mark.parametrize("degrees", [0.5, 2.0, 5.0])
def test_star_tracker_corrects_large_initial_attitude_error(degrees):
    """Two successive rotations differ from their sum by half the cross product."""
    sigma = np.deg2rad(degrees)
    inertial = StrapdownState(np.array([0.0, 0, 300]), np.array([3.0, 0, -2]), [0, 0, 0, 1.0], 1.62)
    navigator = Navigator(
        inertial, StartSigmas(30.0, 0.3, sigma), instruments={"stars": StarTrackerInstrument(9e-5)}
    )
    true = quat_from_rotation_vector(sigma * np.array([1.0, -1.0, 1.0]))
    navigator.take("stars", AttitudeReading(0.0, true, np.diag([25e-6, 25e-6, 27e-5]) ** 2), 0.0)
    found = navigator.estimate_in_site(0.0, 1.0)
    off = quat_to_rotation_vector(quat_multiply(true, quat_conjugate(found.attitude)))
    own = found.covariance[6:9, 6:9]
    assert off @ np.linalg.solve(own, off) < 16.0
