from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_rotate
from lunarsim.models.inertial_unit import TriadErrors
from lunarsim.models.lander import Lander
from lunarsim.sensors.imu import Imu, ImuSettings
from lunarsim.vehicle import Dynamics, State

STILL = np.zeros((400_000, 3))


def allan_deviation(increments, step, samples):
    """Overlapping Allan deviation of the rate at an averaging time of `samples` steps."""
    angle = np.concatenate((np.zeros((1, 3)), np.cumsum(increments, axis=0)))
    m = samples
    second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
    tau = m * step
    return np.sqrt(np.mean(second**2) / 2.0) / tau


@pytest.mark.parametrize("seconds", [0.1, 1.0, 10.0])
def test_allan_deviation_of_white_noise(seconds):
    errors = TriadErrors(random_walk=3e-4)
    imu = Imu(np.random.default_rng(1), 100.0, errors, TriadErrors())
    angle, _ = imu.measure(STILL, STILL)
    samples = round(seconds * 100)
    # Relative error of the estimate: about one over the root of the number of intervals.
    intervals = 3 * len(STILL) / samples
    found = allan_deviation(angle, 0.01, samples)
    assert found == pytest.approx(3e-4 / np.sqrt(seconds), rel=3.0 / np.sqrt(intervals))


@pytest.mark.parametrize("seconds", [10.0, 40.0])
def test_allan_deviation_of_a_walking_bias(seconds):
    errors = TriadErrors(bias_walk=2e-4)
    imu = Imu(np.random.default_rng(2), 100.0, TriadErrors(), errors)
    _, velocity = imu.measure(STILL, STILL)
    samples = round(seconds * 100)
    intervals = 3 * len(STILL) / samples
    found = allan_deviation(velocity, 0.01, samples)
    assert found == pytest.approx(2e-4 * np.sqrt(seconds / 3.0), rel=3.0 / np.sqrt(intervals))


def test_constants_of_a_power_on_have_their_spread():
    errors = TriadErrors(bias=1e-3, scale_factor=1e-2, misalignment=5e-3)
    rows = []
    for seed in range(3000):
        imu = Imu(np.random.default_rng(seed), 100.0, errors, TriadErrors())
        still, _ = imu.measure(np.zeros(3), np.zeros(3))
        turning, _ = imu.measure([1.0, 0.0, 0.0], np.zeros(3))
        rows.append(np.concatenate((still, turning - still)) * 100.0)
    rows = np.array(rows)
    assert rows[:, :3].std() == pytest.approx(1e-3, rel=0.04)
    assert (rows[:, 3] - 1.0).std() == pytest.approx(1e-2, rel=0.05)
    assert rows[:, 4:].std() == pytest.approx(5e-3, rel=0.05)
    assert abs(rows[:, :3].mean()) < 4.0 * 1e-3 / np.sqrt(9000)


def test_quantised_sums_lose_nothing():
    errors = TriadErrors(quantum=1e-3)
    imu = Imu(np.random.default_rng(0), 100.0, errors, errors)
    total = np.zeros(3)
    for _ in range(997):
        angle, _ = imu.measure([0.0137, -0.2, 0.0], np.zeros(3))
        assert np.allclose(angle / 1e-3, np.rint(angle / 1e-3))
        total += angle
    assert np.all(np.abs(total - 997 * 0.01 * np.array([0.0137, -0.2, 0.0])) <= 0.5e-3 + 1e-9)


def test_one_by_one_or_together_without_noise_is_the_same():
    errors = TriadErrors(bias=1e-3, scale_factor=1e-2, misalignment=1e-3, quantum=1e-4)
    rate = np.random.default_rng(5).normal(size=(50, 3))
    at_once, _ = Imu(np.random.default_rng(3), 50.0, errors, errors).measure(rate, rate)
    imu = Imu(np.random.default_rng(3), 50.0, errors, errors)
    assert np.allclose(at_once, [imu.measure(r, r)[0] for r in rate], atol=1e-12)


def test_bad_units_are_refused():
    with pytest.raises(InputError, match=r"imu\.rate"):
        Imu(np.random.default_rng(0), 0.0)
    with pytest.raises(InputError, match=r"imu\.bias"):
        TriadErrors(bias=-1.0)
    with pytest.raises(InputError, match=r"imu\.specific_force"):
        Imu(np.random.default_rng(0)).measure(np.zeros((2, 3)), np.zeros((3, 3)))


def moved(steps=200):
    """Return true states (steps + 1, 15) of a lander that turns under thrust."""
    dynamics = Dynamics(Lander(), 1.622)
    attitude = quat_from_rotation_vector([0.2, -0.1, 0.5])
    now = State(np.zeros(3), np.array([20.0, 0.0, -9.0]), attitude, np.zeros(3), 1400.0, 2000.0)
    rows = [now.as_vector()]
    for n in range(steps):
        now = dynamics.advance(now, 3000.0, 30.0 * np.array([np.sin(0.1 * n), 1.0, -1.0]))
        rows.append(now.as_vector())
    return np.array(rows)


def test_samples_of_a_motion_carry_a_state_along_it():
    """Perfect samples, dead reckoned plainly, end where the lander is."""
    rows = moved()
    unit = ImuSettings(TriadErrors(), TriadErrors()).build(np.random.default_rng(0), 0.01)
    samples = unit.sample_trajectory(rows, 0.01, 1.622, 2.0)
    assert samples.time == 2.0
    assert samples.angle.shape == samples.velocity.shape == (200, 3)
    r, v, q = rows[0, 0:3], rows[0, 3:6], rows[0, 6:10]
    for angle, velocity in zip(samples.angle, samples.velocity, strict=True):
        middle = quat_multiply(q, quat_from_rotation_vector(0.5 * angle))
        faster = v + quat_rotate(middle, velocity) - [0.0, 0.0, 0.01622]
        r, v = r + 0.005 * (v + faster), faster
        q = quat_multiply(q, quat_from_rotation_vector(angle))
    assert v == pytest.approx(rows[-1, 3:6], abs=1e-9)
    assert r == pytest.approx(rows[-1, 0:3], abs=1e-4)
    assert abs(q @ rows[-1, 6:10]) == pytest.approx(1.0, abs=1e-12)


def test_free_fall_is_felt_as_nothing():
    unit = Imu(np.random.default_rng(0), 100.0, TriadErrors(), TriadErrors())
    fall = State(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1400.0)
    rows = [fall.as_vector()]
    for _ in range(10):
        fall = Dynamics(Lander(), 1.622).advance(fall, 0.0, np.zeros(3))
        rows.append(fall.as_vector())
    samples = unit.sample_trajectory(np.array(rows), 0.01, 1.622, 0.1)
    assert np.abs(samples.velocity).max() < 1e-12
    assert np.abs(samples.angle).max() < 1e-12


def test_what_gyroscopes_gave_on_the_way_is_not_sampled_again():
    rows = moved(10)
    errors = TriadErrors(random_walk=1e-3)
    given = np.random.default_rng(1).standard_normal((10, 3))
    first, second = (Imu(np.random.default_rng(2), 100.0, errors, errors) for _ in range(2))
    samples = first.sample_trajectory(rows, 0.01, 1.622, 0.1, given)
    assert samples.angle is given
    # Accelerometers draw from a stream of their own.
    assert np.array_equal(
        samples.velocity, second.sample_trajectory(rows, 0.01, 1.622, 0.1).velocity
    )


def test_bias_instability_is_the_maximum_of_the_allan_deviation():
    """An averaging time of 1.89 correlation times shows the value of the datasheet."""
    errors = TriadErrors(bias_instability=1e-4, correlation_time=5.0)
    units = [Imu(np.random.default_rng(seed), 20.0, errors, TriadErrors()) for seed in range(2)]
    found = [allan_deviation(u.measure(STILL, STILL)[0], 0.05, 189) for u in units]
    # 6 axes of 20000 s are 12700 averaging times: a relative deviation of about 1 %.
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1e-4, rel=0.06)


def test_bias_instability_widens_what_the_filter_expects():
    errors = TriadErrors(bias=3e-6, bias_instability=0.617 * 4e-6, bias_walk=6e-7,
                         correlation_time=50.0)  # fmt: skip
    assert errors.total_bias_sigma == pytest.approx(5e-6)
    assert errors.total_bias_walk == pytest.approx(1e-6)
