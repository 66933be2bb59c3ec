"""Time that runs on, and measurements in the order in which they were made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.messages.measurements import AltimeterReading, InertialSamples, LidarScan
from lunarsim.onboard.navigation.arrivals import Arrivals
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.navigator import Navigator

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def made():
    told = []
    return Arrivals(0.01, lambda *event: told.append(event)), told


def samples(time: float, count: int = 10, push: float = 0.016) -> InertialSamples:
    return InertialSamples(time, np.zeros((count, 3)), np.tile([0.0, 0.0, push], (count, 1)))


def scan(time: float) -> LidarScan:
    rays = np.array([[0.0, 0.0, -1.0], [0.1, 0.0, -0.99]])
    return LidarScan(time, np.full(2, 100.0), rays, np.eye(3), np.full(2, 0.1), (1, 2))


@pytest.mark.parametrize("time", [0.9, np.nan, -np.inf])
def test_the_clock_does_not_run_backwards(time):
    arrivals, _ = made()
    arrivals.advance(1.0)
    with pytest.raises(InputError, match=r"time.*does not run backwards"):
        arrivals.advance(time)
    with pytest.raises(InputError, match="time"):
        arrivals.admit("flash", scan(0.0), time)


@pytest.mark.parametrize("stamp", [0.9, 1.2, np.nan, -np.inf])
def test_old_and_future_measurements_are_left_out_and_told(stamp):
    arrivals, told = made()
    first = scan(1.0)
    assert arrivals.admit("flash", first, 1.0) is first
    assert arrivals.admit("flash", scan(stamp), 1.1) is None
    ((time, name, details),) = told
    assert (time, name, details["sensor"], details["last"]) == (1.1, "out-of-order", "flash", 1.0)
    # Another sensor has an order of its own, and a later measurement is good again.
    assert arrivals.admit("other", scan(0.9), 1.1) is not None
    assert arrivals.admit("flash", scan(1.1), 1.1) is not None


def test_increments_are_not_flown_twice():
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
    """A filter that hovers for 2 s: `give` what comes at each tenth of a second."""
    state = StrapdownState(np.array([0.0, 0.0, 100.0]), np.zeros(3), UPRIGHT, 1.6)
    navigation = Navigator(state, StartSigmas(), None)
    for k in range(1, 21):
        for sensor, measurement in give(k):
            navigation.take(sensor, measurement, 0.1 * k)
    return navigation


def test_a_filter_leaves_out_what_comes_late():
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


def test_a_lost_packet_costs_certainty_not_way():
    """A gap of a second is carried over at the last known push, and the errors grow for it."""
    whole = flown(lambda k: [("imu", samples(0.1 * k))])
    gone = flown(lambda k: [] if 5 <= k < 15 else [("imu", samples(0.1 * k))])
    assert gone.inertial.velocity == pytest.approx(whole.inertial.velocity, abs=1e-9)
    assert gone.inertial.position == pytest.approx(whole.inertial.position, abs=1e-9)
    grown = np.diag(gone.covariance)[3:6] - np.diag(whole.covariance)[3:6]
    assert grown == pytest.approx(np.full(3, 1.0**2 * 1.0), rel=0.05)
