"""Test the time order of measurements and gaps in inertial samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    CameraImage,
    InertialSamples,
    LidarScan,
)
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.measurement_sequencer import MeasurementSequencer
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.scan_odometry import remove_implausible_ranges
from lunarsim.onboard.navigation.unscented import UnscentedFilter

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def made():
    told = []
    return MeasurementSequencer(0.01, lambda *event: told.append(event)), told


def samples(time: float, count: int = 10, push: float = 0.016) -> InertialSamples:
    return InertialSamples(time, np.zeros((count, 3)), np.tile([0.0, 0.0, push], (count, 1)))


def scan(time: float) -> LidarScan:
    rays = np.array([[0.0, 0.0, -1.0], [0.1, 0.0, -0.99]])
    return LidarScan(time, np.full(2, 100.0), rays, np.eye(3), np.full(2, 0.1), (1, 2))


@pytest.mark.parametrize("time", [0.9, np.nan, -np.inf])
def test_the_clock_does_not_run_backwards(time):
    arrivals, _ = made()
    arrivals.advance(1.0)
    with pytest.raises(InputError, match=r"time: must be (finite|at least the previous time)"):
        arrivals.advance(time)
    with pytest.raises(InputError, match="time"):
        arrivals.admit("flash", scan(0.0), time)


@pytest.mark.parametrize("stamp", [0.9, 1.2, np.nan, -np.inf])
def test_old_and_future_measurements_are_rejected_with_event(stamp):
    arrivals, told = made()
    first = scan(1.0)
    assert arrivals.admit("flash", first, 1.0) is first
    assert arrivals.admit("flash", scan(stamp), 1.1) is None
    ((time, name, details),) = told
    assert (time, name, details["sensor"], details["last"]) == (1.1, "out-of-order", "flash", 1.0)
    # The order is checked per sensor, and a later measurement is admitted again.
    assert arrivals.admit("other", scan(1.08), 1.1) is not None
    assert arrivals.admit("flash", scan(1.1), 1.1) is not None


def test_increments_are_not_integrated_twice():
    arrivals, told = made()
    assert arrivals.admit("imu", samples(0.1), 0.1) is not None
    assert arrivals.admit("imu", samples(0.1), 0.1) is None
    assert [name for _, name, _ in told] == ["out-of-order"]


@pytest.mark.parametrize("missing", [1, 7, 10, 25])
def test_samples_that_never_came_are_missing_ones(missing):
    arrivals, told = made()
    arrivals.admit("imu", samples(0.1), 0.1)
    late = 0.1 + 0.01 * (10 + missing)
    found = arrivals.admit("imu", samples(late), late)
    assert len(found.angle) == len(found.velocity) == 10 + missing
    assert np.isnan(found.angle[:missing]).all()
    assert np.isfinite(found.angle[missing:]).all()
    assert told == [(late, "samples-missing", {"sensor": "imu", "count": missing})]


def test_a_gap_of_an_hour_does_not_fill_the_memory():
    arrivals, _ = made()
    arrivals.admit("imu", samples(0.1), 0.1)
    assert len(arrivals.admit("imu", samples(3600.0), 3600.0).angle) == 6000


def flown(give):
    """Run a hovering filter for 2 s; `give` returns the measurements of each 0.1 s."""
    state = StrapdownState(np.array([0.0, 0.0, 100.0]), np.zeros(3), UPRIGHT, 1.6)
    navigation = Navigator(state, StartSigmas(), None)
    for k in range(1, 21):
        for sensor, measurement in give(k):
            navigation.take(sensor, measurement, 0.1 * k)
    return navigation


def test_filter_rejects_late_measurements():
    plain = flown(lambda k: [("imu", samples(0.1 * k))])
    late = flown(
        lambda k: [
            ("imu", samples(0.1 * k)),
            ("imu", samples(0.1 * (k - 1), push=5.0)),
            ("down", AltimeterReading(0.1 * k if k == 1 else 0.0, np.nan, np.nan)),
        ]
    )
    assert np.array_equal(plain.covariance, late.covariance)
    assert np.array_equal(plain.inertial.velocity, late.inertial.velocity)
    names = [event.name for event in late.events]
    assert names == ["out-of-order"] * len(names)
    # 20 old packets of samples, and 19 readings older than the first.
    assert len(names) == 39


def test_old_scans_and_readings_change_nothing():
    navigation = flown(lambda k: [("imu", samples(0.1 * k)), ("flash", scan(0.1 * k))])
    before, key = navigation.covariance.copy(), len(navigation.events)
    navigation.take("flash", replace(scan(0.5), range=np.array([3.0, 4.0])), 2.0)
    assert np.array_equal(navigation.covariance, before)
    assert [event.name for event in navigation.events[key:]] == ["out-of-order"]
    with pytest.raises(InputError, match="time"):
        navigation.take("flash", scan(1.0), 1.0)


def test_lost_packet_costs_accuracy_not_distance():
    """A gap of 1 s is bridged with the last specific force, and the covariance grows."""
    whole = flown(lambda k: [("imu", samples(0.1 * k))])
    with_gap = flown(lambda k: [] if 5 <= k < 15 else [("imu", samples(0.1 * k))])
    assert with_gap.inertial.velocity == pytest.approx(whole.inertial.velocity, abs=1e-9)
    assert with_gap.inertial.position == pytest.approx(whole.inertial.position, abs=1e-9)
    grown = np.diag(with_gap.covariance)[3:6] - np.diag(whole.covariance)[3:6]
    assert grown == pytest.approx(np.full(3, 1.0**2 * 1.0), rel=0.05)


def test_measurements_during_gap_correct_propagated_state():
    """Attitude readings during a gap: the true rotation is not taken for an error."""
    turned = [np.array([0.0, 0.0, np.sin(0.005 * k), np.cos(0.005 * k)]) for k in range(21)]
    spin = np.tile([0.0, 0.0, 0.001], (10, 1))

    def give(k, silent):
        if not silent:
            yield "imu", replace(samples(0.1 * k), angle=spin)
        yield "stars", AttitudeReading(0.1 * k, turned[k], 1e-8 * np.eye(3))

    with_gap = flown(lambda k: give(k, 5 <= k < 15))
    whole = flown(lambda k: give(k, silent=False))
    names = [event.name for event in with_gap.events]
    assert names == ["samples-missing"] * 10
    assert with_gap.inertial.rate == pytest.approx(whole.inertial.rate, abs=2e-4)
    assert with_gap.inertial.position == pytest.approx(whole.inertial.position, abs=0.01)
    assert with_gap.monitors["stars attitude"].rejected_count == 0
    assert not with_gap.estimate(2.0, 1.0).lost


def test_late_samples_are_reported():
    arrivals, told = made()
    arrivals.admit("imu", samples(0.1), 0.1)
    unit, filled = arrivals.overdue_samples(0.2)
    assert (unit, len(filled.angle), filled.time) == ("imu", 10, 0.2)
    assert np.isnan(filled.angle).all()
    assert np.isnan(filled.velocity).all()
    assert arrivals.overdue_samples(0.2) is None
    assert arrivals.overdue_samples(np.nan) is None
    assert arrivals.admit("imu", samples(0.2), 0.2) is None
    assert len(arrivals.admit("imu", samples(0.3), 0.3).angle) == 10
    assert [name for _, name, _ in told] == ["samples-missing", "out-of-order"]


def test_nothing_is_overdue_before_the_first_samples():
    arrivals, told = made()
    assert arrivals.overdue_samples(5.0) is None
    assert told == []


def test_samples_before_late_start_are_missing():
    told = []
    arrivals = MeasurementSequencer(0.01, lambda *event: told.append(event), begin=0.0, unit="imu")
    unit, filled = arrivals.overdue_samples(0.2)
    assert (unit, len(filled.angle)) == ("imu", 20)
    assert len(arrivals.admit("imu", samples(0.5), 0.5).angle) == 30
    assert [details["count"] for _, _, details in told] == [20, 20]


def test_older_samples_of_second_unit_do_not_reset_time():
    arrivals, _ = made()
    arrivals.admit("imu", samples(0.2), 0.2)
    assert len(arrivals.admit("spare", samples(0.15), 0.2).angle) == 0
    assert len(arrivals.admit("imu", samples(0.3), 0.3).angle) == 10


def test_surplus_samples_are_dropped():
    arrivals, told = made()
    arrivals.admit("imu", samples(0.1), 0.1)
    many = replace(samples(0.2, 30), angle=np.arange(90.0).reshape(30, 3))
    found = arrivals.admit("imu", many, 0.2)
    assert np.array_equal(found.angle, np.arange(60.0, 90.0).reshape(10, 3))
    assert len(found.velocity) == 10
    assert told == [(0.2, "samples-surplus", {"sensor": "imu", "count": 20})]


def test_second_inertial_unit_is_not_integrated_twice():
    arrivals, told = made()
    arrivals.admit("imu", samples(0.1), 0.1)
    assert len(arrivals.admit("imu", samples(0.2), 0.2).angle) == 10
    assert len(arrivals.admit("spare", samples(0.2), 0.2).angle) == 0
    assert [name for _, name, _ in told] == ["samples-surplus"]


def test_stale_measurements_are_rejected():
    arrivals, told = made()
    arrivals.admit("imu", samples(1.0), 1.0)
    assert arrivals.admit("down", AltimeterReading(0.96, 90.0, 1.0), 1.0) is None
    assert told == [(1.0, "stale", {"sensor": "down", "stamp": 0.96})]
    assert arrivals.admit("down", AltimeterReading(0.98, 90.0, 1.0), 1.0) is not None
    # The middle of a long exposure is earlier.
    assert (
        arrivals.admit("eye", CameraImage(0.9, np.zeros((2, 2), np.uint8), None), 1.0) is not None
    )


@pytest.mark.parametrize(
    ("angle", "velocity", "field"),
    [((10, 2), (10, 2), "angle"), ((10, 3), (10, 2), "velocity"), ((3,), (3,), "angle"),
     ((9, 3), (10, 3), "velocity")],
)  # fmt: skip
def test_samples_with_wrong_shape_are_rejected_and_missing(angle, velocity, field):
    arrivals, told = made()
    arrivals.admit("imu", samples(0.1), 0.1)
    with pytest.raises(InputError, match=rf"inertial\.{field}"):
        arrivals.admit("imu", InertialSamples(0.2, np.zeros(angle), np.zeros(velocity)), 0.2)
    assert len(arrivals.admit("imu", samples(0.3), 0.3).angle) == 20
    assert told == [(0.3, "samples-missing", {"sensor": "imu", "count": 10})]


SIGMAS = StartSigmas(2.0, 0.1, 2e-3)


def with_rocks(state):
    return Navigator(state, SIGMAS, rocks=True)


@pytest.mark.parametrize("make", [with_rocks, UnscentedFilter])
def test_every_filter_checks_the_order(make):
    state = StrapdownState(np.array([0.0, 0.0, 100.0]), np.array([0.0, 0.0, -10.0]), UPRIGHT, 1.6)
    navigation = make(state)
    navigation.take("imu", samples(0.1), 0.1)
    navigation.take("down", AltimeterReading(0.5, np.nan, np.nan), 0.5)
    assert state.position[2] == pytest.approx(95.0, abs=0.01)
    navigation.take("imu", samples(0.5), 0.5)
    navigation.take("down", AltimeterReading(0.4, 50.0, 0.1), 0.5)
    assert state.position[2] == pytest.approx(95.0, abs=0.01)
    names = [event.name for event in navigation.events]
    assert names == ["samples-missing", "out-of-order", "out-of-order"]
    with pytest.raises(InputError, match="time"):
        navigation.take("imu", samples(0.2), 0.2)


@pytest.mark.parametrize(
    ("name", "value"),
    [("range", np.full(3, 9.0)), ("direction", np.zeros((2, 2))), ("sigma", np.ones(1)),
     ("mount", np.eye(2))],
)  # fmt: skip
def test_scans_whose_arrays_do_not_fit_are_refused(name, value):
    navigation = flown(lambda k: [("imu", samples(0.1 * k))])
    with pytest.raises(InputError, match=r"scan\."):
        navigation.take("flash", replace(scan(2.0), **{name: value}), 2.0)


@pytest.mark.parametrize(
    "mount",
    [np.zeros((3, 3)), 2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan)],
)
def test_scan_with_invalid_mount_is_ignored(mount):
    given = replace(scan(1.0), mount=mount)
    assert np.isnan(remove_implausible_ranges(given).range).all()


@pytest.mark.parametrize("ray", [np.nan, np.inf, 0.0, 1e9, 1e150, -1e300])
@pytest.mark.parametrize("place", [slice(None), (17, 0), (20, 2)])
def test_scan_with_invalid_rays_is_ignored(ray, place):
    """Such a scan once wrote past an array or covered an unlimited area."""
    east, north = np.meshgrid(np.linspace(-0.1, 0.1, 6), np.linspace(-0.1, 0.1, 6))
    rays = np.column_stack((east.ravel(), north.ravel(), np.full(36, -1.0)))
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    good = LidarScan(0.0, np.full(36, 100.0), rays, np.eye(3), np.full(36, 0.1), (6, 6))
    assert np.isfinite(remove_implausible_ranges(good).range).all()
    navigation = flown(
        lambda k: [("imu", samples(0.1 * k)), ("flash", replace(good, time=0.1 * k))]
    )
    before = navigation.covariance.copy()
    wrong = rays.copy()
    wrong[place] = ray
    navigation.take("flash", replace(good, time=2.0, direction=wrong), 2.0)
    assert np.array_equal(navigation.covariance, before)


def test_reading_with_several_ranges_is_rejected():
    navigation = flown(lambda k: [("imu", samples(0.1 * k))])
    with pytest.raises(
        InputError, match=r"down\.range: must be one number, not an array of shape \(2,\)"
    ):
        navigation.take("down", AltimeterReading(2.0, np.ones(2), np.ones(2)), 2.0)
