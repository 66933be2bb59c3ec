"""Test the unscented filter against a linear Kalman filter, and its mass estimate."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
)
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.models.instruments import (
    AltimeterInstrument,
    StarTrackerInstrument,
    VelocimeterInstrument,
)
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from lunarsim.onboard.navigation.unscented import UnscentedFilter, UnscentedNavigation

TILT = quat_from_rotation_vector([0.2, -0.1, 0.3])
BEAMS = ((0.6, 0.0, -0.8), (-0.6, 0.0, -0.8), (0.0, 0.6, -0.8))
INSTRUMENTS = {
    "down": AltimeterInstrument((0.0, 0.0, -1.0)), "doppler": VelocimeterInstrument(BEAMS),
    "stars": StarTrackerInstrument(1e-4),
}  # fmt: skip
STILL = TriadErrors(0.0, 0.0, 0.0, 0.0, 0.0)
PUSHED = TriadErrors(random_walk=3e-4, bias=3e-3, bias_walk=1e-5, scale_factor=0, misalignment=0)
GYROSCOPES = TriadErrors(random_walk=3e-4, bias=1e-4)
STEP, GRAVITY, GROUND = 0.01, 1.62, 4.0
STARTS = StartSigmas(20.0, 0.5, 1e-9)


def made(attitude=TILT, *, errors=STARTS, settings=None, off=10.0, gyroscopes=STILL, **more):
    state = StrapdownState(
        np.array([5.0, -8.0, 300.0]), np.array([12.0, 3.0, -9.0]), attitude, GRAVITY,
        step=STEP, gyroscopes=gyroscopes, accelerometers=PUSHED,
    )  # fmt: skip
    return UnscentedFilter(
        state, errors, settings, terrain_prior=TerrainPrior(GROUND, off),
        instruments=INSTRUMENTS, **more
    )  # fmt: skip


class Linear:
    """Explicit Kalman filter of position, velocity and bias without rotation."""

    def __init__(self) -> None:
        self.x = np.array([5.0, -8.0, 300.0, 12.0, 3.0, -9.0, 0.0, 0.0, 0.0])
        self.p = np.diag(np.repeat([20.0**2, 0.5**2, PUSHED.bias**2], 3))
        self.r = quat_to_matrix(TILT)
        self.readings = 0

    def carry(self, pushes) -> None:
        eye, none = np.eye(3), np.zeros((3, 3))
        t = STEP
        f = np.block([
            [eye, t * eye, -0.5 * t * t * self.r], [none, eye, -t * self.r], [none, none, eye],
        ])  # fmt: skip
        g = np.array([0.0, 0.0, -GRAVITY])
        walk, drift = PUSHED.random_walk**2, PUSHED.bias_walk**2
        q = np.block([
            [walk * t**3 / 3 * eye, walk * t**2 / 2 * eye, none],
            [walk * t**2 / 2 * eye, walk * t * eye, none], [none, none, drift * t * eye],
        ])  # fmt: skip
        for push in pushes:
            a = self.r @ push / t + g
            self.x = f @ self.x + np.concatenate((0.5 * t * t * a, t * a, np.zeros(3)))
            self.p = f @ self.p @ f.T + q

    def correct(self, h, z, r) -> None:
        gain = self.p @ h.T @ np.linalg.inv(h @ self.p @ h.T + r)
        self.x = self.x + gain @ (z - h @ self.x)
        self.p = (np.eye(9) - gain @ h) @ self.p

    def speeds(self, z, sigma) -> None:
        h = np.zeros((3, 9))
        h[:, 3:6] = np.array(BEAMS) @ self.r.T
        # The beam bias (0.02 m/s, random walk 0.005 m/s in 1 s) persists for 100 readings.
        self.correct(h, z, (sigma**2 + 100.0 * (0.02**2 + 10.0 * 0.005**2)) * np.eye(3))

    def range(self, z, sigma, ground) -> None:
        down = -self.r[2, 2]
        h = np.zeros((1, 9))
        h[0, 2] = -1.0 / down
        k = self.readings
        self.readings += 1
        noise = sigma**2 + (ground / down) ** 2 * (k + 1) * (k + 2)
        self.correct(h, np.array([z - GROUND / down]), np.array([[noise]]))


def test_where_the_model_is_linear_it_is_the_kalman_filter():
    rng = np.random.default_rng(1)
    own, plain = made(off=3.0), Linear()
    refused = 0
    for k in range(1, 41):
        pushes = STEP * (np.array([0.1, -0.2, 1.9]) + 0.1 * rng.normal(size=(10, 3)))
        own.take("imu", InertialSamples(0.1 * k, np.zeros((10, 3)), pushes), 0.1 * k)
        plain.carry(pushes)
        speeds = np.array(BEAMS) @ plain.r.T @ plain.x[3:6] + 0.05 * rng.normal(size=3)
        reading = DopplerReading(
            0.1 * k, speeds, np.full(3, np.nan), np.full(3, 0.05), np.full(3, np.nan)
        )
        own.take("doppler", reading, 0.1 * k)
        plain.speeds(speeds, 0.05)
        distance = (plain.x[2] - GROUND) / plain.r[2, 2] + 2.0 * rng.normal()
        own.take("down", AltimeterReading(0.1 * k, distance, 2.0), 0.1 * k)
        plain.range(distance, 2.0, 3.0)
        refused += sum(w.rejected_count for w in own.monitors.values())
    assert refused == 0
    assert own.kalman.x[:9] == pytest.approx(plain.x, abs=1e-6)
    scale = np.sqrt(np.outer(np.diag(plain.p), np.diag(plain.p)))
    assert np.abs(own.kalman.P[:9, :9] - plain.p).max() < 1e-5 * scale.max()
    assert (np.abs(own.kalman.P[:9, :9] - plain.p) / scale).max() < 1e-5
    assert own.inertial.position == pytest.approx(plain.x[:3], abs=1e-6)
    assert own.covariance[:9, :9] == pytest.approx(own.kalman.P[:9, :9])


def flown(own: UnscentedFilter, thrust, mass: float, seconds: float, lag=0.0, rng=None) -> float:
    """Fly with a thrust by time (N) for some seconds; return the true mass at the end."""
    given = thrust(0.0)
    gain = 1.0 if rng is None else 1.0 + 0.01 * rng.normal()
    for k in range(1, round(seconds / 0.1) + 1):
        asked, pushes = thrust(0.1 * (k - 1)), np.zeros((10, 3))
        for i in range(10):
            keep = np.exp(-STEP / lag) if lag else 0.0
            mean = asked + (given - asked) * (lag / STEP * (1.0 - keep) if lag else 0.0)
            given = asked + (given - asked) * keep
            mass -= STEP * gain * mean / 3000.0
            pushes[i, 2] = STEP * gain * mean / mass
        own.record_thrust(asked, 0.1)
        own.take("imu", InertialSamples(0.1 * k, np.zeros((10, 3)), pushes), 0.1 * k)
    return mass


UP = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("lag", [0.0, 0.1, 0.7])
def test_mass_falls_by_what_the_engine_burns(lag):
    """With commands that change every second, and a thrust lag."""
    own = made(UP, mass=1500.0, lag=lag)
    true = flown(own, lambda t: 2400.0 + 900.0 * (int(t) % 2), 1500.0, 20.0, lag)
    assert 1500.0 - true > 15.0
    mass, sigma = own.mass
    assert mass == pytest.approx(true, abs=0.02)
    assert 0.5 < sigma < 1.2
    assert own.estimate(20.0, 7.0).mass == mass


def test_mass_is_found_where_it_was_not_known():
    """30 starts with random mass errors of 40 kg and thrust errors of 1 %."""
    settings = UnscentedNavigation(mass_sigma=40.0)
    squares = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        own = made(UP, mass=1500.0 + 40.0 * rng.normal(), settings=settings)
        true = flown(own, lambda t: 2600.0, 1500.0, 6.0, 0.0, rng)
        mass, sigma = own.mass
        assert sigma < 25.0
        squares.append(((mass - true) / sigma) ** 2)
    # Chi-squared of 30, 99.9 %.
    assert 0.35 < np.mean(squares) < 2.05


def test_without_thrust_the_computers_mass_counts():
    own = made()
    own.take("imu", InertialSamples(0.1, np.zeros((10, 3)), np.full((10, 3), 0.016)), 0.1)
    assert own.estimate(0.1, 777.0).mass == 777.0


def test_attitude_is_what_the_tracker_gives_and_what_turns_do_since():
    own = made(errors=StartSigmas(1.0, 0.1, 1e-2), gyroscopes=GYROSCOPES)
    seen = quat_multiply(TILT, quat_from_rotation_vector([2e-3, 0.0, -1e-3]))
    own.take("stars", AttitudeReading(0.0, seen, np.diag([1e-8, 1e-8, 4e-8])), 0.0)
    assert np.abs(own.inertial.attitude @ seen) == pytest.approx(1.0, abs=1e-12)
    assert np.diag(own.covariance)[9:12] == pytest.approx([2e-8, 2e-8, 5e-8])
    before = np.diag(own.covariance)[9:12]
    for k in range(1, 101):
        own.take("imu", InertialSamples(0.1 * k, np.zeros((10, 3)), np.zeros((10, 3))), 0.1 * k)
    grown = np.diag(own.covariance)[9:12] - before
    assert grown == pytest.approx(np.full(3, (10.0 * 1e-4) ** 2 + 10.0 * 3e-4**2), rel=0.05)
    wrong = quat_multiply(seen, quat_from_rotation_vector([0.2, 0.0, 0.0]))
    held = own.inertial.attitude.copy()
    own.take("stars", AttitudeReading(10.0, wrong, 1e-8 * np.eye(3)), 10.0)
    assert np.array_equal(own.inertial.attitude, held)
    assert own.monitors["stars attitude"].rejected_count == 1


def test_unexplained_measurements_lose_navigation():
    own = made()
    for k in range(1, 41):
        reading = DopplerReading(
            0.1 * k, np.array([30.0, -30.0, 12.0]), np.full(3, 1.0), np.full(3, 0.03), np.ones(3)
        )
        own.take("doppler", reading, 0.1 * k)
    assert own.estimate(4.0, 1.0).lost
    assert "lost" in [event.name for event in own.events]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e9, -1e9])
def test_wild_readings_change_nothing(value):
    own = made()
    x, p = own.kalman.x.copy(), own.kalman.P.copy()
    own.take("down", AltimeterReading(0.1, value, 0.1), 0.1)
    own.take("down", AltimeterReading(0.2, 300.0, -abs(value)), 0.2)
    for speed, sigma in ((value, 0.03), (1.0, np.nan), (1.0, -1.0)):
        reading = DopplerReading(
            0.3, np.full(3, speed), np.ones(3), np.full(3, sigma), np.ones(3)
        )  # fmt: skip
        own.take("doppler", reading, 0.3)
    own.take("stars", AttitudeReading(0.4, np.full(4, value), np.eye(3)), 0.4)
    own.take("stars", AttitudeReading(0.4, 1.5 * TILT, np.eye(3)), 0.4)
    assert np.array_equal(own.kalman.x, x)
    assert np.array_equal(own.kalman.P, p)


@pytest.mark.parametrize("spread", [4.0, 1e30, 1e300])
def test_an_attitude_error_above_one_turn_contains_no_information(spread):
    own = made()
    p, q = own.covariance.copy(), own.inertial.attitude.copy()
    own.take("stars", AttitudeReading(0.1, TILT, spread * np.eye(3)), 0.1)
    assert np.array_equal(own.covariance, p)
    assert np.array_equal(own.inertial.attitude, q)


@pytest.mark.parametrize(
    ("sensor", "measurement", "field"),
    [
        ("imu", InertialSamples(0.1, np.zeros((10, 2)), np.zeros((10, 2))), "inertial"),
        ("imu", InertialSamples(0.1, np.zeros((10, 3)), np.zeros((9, 3))), "inertial"),
        ("doppler", DopplerReading(0.1, *np.ones((4, 2))), "speed"),
        ("stars", AttitudeReading(0.1, TILT, np.eye(2)), "covariance"),
        ("stars", AttitudeReading(0.1, TILT[:3], np.eye(3)), "attitude"),
    ],
)
def test_readings_with_wrong_shape_are_rejected_without_change(sensor, measurement, field):
    own = made()
    x, p = own.kalman.x.copy(), own.kalman.P.copy()
    with pytest.raises(InputError, match=field):
        own.take(sensor, measurement, 0.1)
    assert np.array_equal(own.kalman.x, x)
    assert np.array_equal(own.kalman.P, p)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_implausible_parameters_are_rejected(value):
    with pytest.raises(InputError, match="mass"):
        made(mass=value)
    with pytest.raises(InputError, match="exhaust"):
        made(exhaust_velocity=value)
    for key in ("mass_sigma", "thrust_sigma"):
        with pytest.raises(InputError, match=key):
            UnscentedNavigation(**{key: value})
    own = made()
    with pytest.raises(InputError, match="thrust"):
        own.record_thrust(value if value else -1.0, 0.1)
    with pytest.raises(InputError, match="seconds"):
        own.record_thrust(100.0, value if value else -1.0)


def test_measurements_move_site_not_lander_in_local_frame():
    own = made(off=0.5)
    before = own.estimate(0.0, 1.0).position
    own.take("down", AltimeterReading(0.0, 260.0, 0.5), 0.0)
    found = own.estimate_in_site(0.0, 1.0).position
    assert abs(found[2] - before[2]) > 3.0
    np.testing.assert_allclose(own.estimate(0.0, 1.0).position, before, atol=1e-9)
    np.testing.assert_allclose(own.site_to_local.to_local(found), before, atol=1e-9)


def test_indefinite_covariance_is_repaired():
    own = made()
    root = np.random.default_rng(3).normal(size=(10, 10))
    own.kalman.P = root @ root.T
    values, axes = np.linalg.eigh(own.kalman.P)
    own.kalman.P = (axes * np.r_[-0.1, values[1:]]) @ axes.T
    own.take("imu", InertialSamples(0.1, np.zeros((10, 3)), np.zeros((10, 3))), 0.1)
    own.take("down", AltimeterReading(0.1, 296.0, 0.5), 0.1)
    found = np.linalg.eigvalsh(own.kalman.P)
    assert found.min() > 0.0
    assert np.isfinite(own.estimate(0.1, 1.0).position).all()
    # Other estimates are not affected.
    assert found.max() == pytest.approx(values.max(), rel=0.5)
