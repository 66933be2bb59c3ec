"""Schedules: when a sensor is told to measure, and where it is pointed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix
from lunarsim.models.instruments import PointedInstrument
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.tasking import Situation
from lunarsim.onboard.tasking.contract import MeasurementAltitudes
from lunarsim.onboard.tasking.schedules import AtAltitudes, Periodic, Sweep

SITE = np.array([5.0, -3.0, 1.0])
TILT = quat_from_rotation_vector([0.1, -0.2, 0.3])


def built(part, limit=np.pi, cycle=0.1):
    briefing = SimpleNamespace(instruments={"eye": PointedInstrument(limit)}, cycle=cycle)
    return part.build("eye", briefing)


def at(time, altitude, site=SITE) -> Situation:
    position = site + np.array([-40.0, 10.0, altitude + 1.6])
    pose = Estimate(time, position, np.zeros(3), TILT, np.zeros(3), 1400.0, np.eye(9))
    return Situation(time, altitude, site, pose)


def looked_at(task, situation) -> np.ndarray:
    """Return where the boresight meets the level of the site (2,)."""
    assert task.sensor == "eye"
    ray = quat_to_matrix(situation.estimate.attitude) @ task.mount[:, 2]
    r = situation.estimate.position
    return (r + ray * (situation.site[2] - r[2]) / ray[2])[:2]


def tasks(schedule, times, altitude=100.0):
    """Return the times at which it measures, and where it looks."""
    when, where = [], []
    for t in times:
        situation = at(float(t), altitude)
        task = schedule.task(situation)
        if task is not None:
            when.append(float(t))
            where.append(looked_at(task, situation))
    return np.array(when), np.array(where)


def test_one_measurement_at_each_altitude_in_falling_order():
    schedule = built(AtAltitudes((50.0, 200.0)))
    done = [h for h in np.arange(300.0, 0.0, -7.0) if schedule.task(at(0.0, h)) is not None]
    assert done == [195.0, 48.0]


def test_altitudes_that_are_passed_together_are_one_measurement():
    schedule = built(AtAltitudes((200.0, 150.0, 50.0)))
    assert schedule.task(at(0.0, 120.0)) is not None
    assert schedule.task(at(0.1, 119.0)) is None
    assert schedule.task(at(0.2, 50.0)) is not None


def test_boresights_are_the_site_or_straight_down():
    situation = at(0.0, 100.0)
    task = built(AtAltitudes()).task(situation)
    assert looked_at(task, situation) == pytest.approx(SITE[:2], abs=1e-9)
    task = built(AtAltitudes(boresight="nadir")).task(situation)
    assert looked_at(task, situation) == pytest.approx(situation.estimate.position[:2], abs=1e-9)


def test_a_gimbal_stops_at_its_limit():
    task = built(AtAltitudes(), limit=0.05).task(at(0.0, 100.0))
    assert np.arccos(-task.mount[2, 2]) == pytest.approx(0.05)


def test_periodic_keeps_its_rate_below_its_altitude_and_above_the_terrain():
    schedule = built(Periodic(rate=2.0, first_altitude=150.0))
    assert schedule.task(at(0.0, 151.0)) is None
    when, where = tasks(schedule, 0.1 * np.arange(1, 60), 149.0)
    assert np.diff(when) == pytest.approx(0.5)
    assert where == pytest.approx(np.tile(SITE[:2], (len(where), 1)), abs=1e-9)
    assert schedule.task(at(50.0, 0.0)) is None
    assert schedule.task(at(50.0, 0.1)) is not None


def test_one_camera_hands_over_to_another_at_an_altitude():
    high = built(Periodic(rate=2.0, first_altitude=900.0, last_altitude=400.0))
    low = built(Periodic(rate=2.0, first_altitude=400.0))
    looks = [
        (altitude, high.task(at(float(n), altitude)) is not None,
         low.task(at(float(n), altitude)) is not None)
        for n, altitude in enumerate((901.0, 900.0, 400.1, 400.0, 10.0))
    ]  # fmt: skip
    assert [one[1] for one in looks] == [False, True, True, False, False]
    assert [one[2] for one in looks] == [False, False, False, True, True]
    assert Periodic(
        first_altitude=900.0, last_altitude=400.0
    ).measurement_altitudes == MeasurementAltitudes(900.0, 400.0)
    with pytest.raises(InputError, match="last_altitude_m: must be less than"):
        Periodic(first_altitude=900.0, last_altitude=900.0)


def test_a_sweep_covers_its_square_row_by_row_and_then_dwells():
    schedule = built(Sweep(size=40.0, duration=10.0, rate=10.0, dwell_rate=2.0))
    when, where = tasks(schedule, 0.1 * np.arange(150))
    sweep = where[when < 10.0 - 1e-9] - SITE[:2]
    assert len(sweep) == 100
    # Ten rows of ten, 40 / 9 m apart, each begun where the last one ended.
    assert np.abs(sweep).max() == pytest.approx(20.0)
    steps = np.abs(np.diff(sweep, axis=0))
    assert np.sort(steps, axis=1) == pytest.approx(np.tile([0.0, 40.0 / 9.0], (99, 1)), abs=1e-9)
    assert len({tuple(spot) for spot in np.round(sweep, 6)}) == 100
    assert where[when >= 10.0 - 1e-9] == pytest.approx(np.tile(SITE[:2], (10, 1)), abs=1e-9)
    assert np.diff(when[when >= 10.0 - 1e-9]) == pytest.approx(0.5)


@pytest.mark.parametrize("rate", [3.0, 7.0, 8.0])
def test_rates_that_do_not_divide_the_cycles_are_kept_on_the_whole(rate):
    times = 0.1 * np.arange(1001)
    when, _ = tasks(built(Periodic(rate=rate)), times)
    assert len(when) == pytest.approx(100.0 * rate, abs=2)
    assert np.diff(when).max() < 1.0 / rate + 0.1 + 1e-9
    # A sweep so gets over all of its square.
    _, where = tasks(built(Sweep(size=40.0, duration=20.0, rate=rate)), times[:200])
    assert where.max(axis=0) == pytest.approx(SITE[:2] + 20.0)


def test_after_a_pause_the_rate_begins_again():
    schedule = built(Periodic(rate=2.0, first_altitude=150.0))
    assert schedule.task(at(1.0, 100.0)) is not None
    assert schedule.task(at(5.0, 200.0)) is None
    when, _ = tasks(schedule, 0.1 * np.arange(60, 80))
    assert when == pytest.approx([6.0, 6.5, 7.0, 7.5])


def test_a_sweep_turns_away_near_the_terrain():
    schedule = built(Sweep(last_altitude=15.0, rate=10.0))
    assert schedule.task(at(0.0, 15.0)) is None
    assert schedule.task(at(0.1, 15.1)) is not None


@pytest.mark.parametrize("part", [AtAltitudes(), Periodic(), Sweep(rate=10.0)], ids=str)
def test_stopped_is_stopped(part):
    schedule = built(part)
    assert schedule.task(at(0.0, 300.0)) is not None
    schedule.stop()
    assert all(schedule.task(at(float(t), 200.0 - t)) is None for t in range(1, 190))


@pytest.mark.parametrize(
    ("part", "key"),
    [(Periodic(rate=10.5), "rate_hz"), (Sweep(rate=10.5), "rate_hz"),
     (Sweep(rate=5.0, dwell_rate=10.5), "dwell_rate_hz")],
)  # fmt: skip
def test_no_more_than_one_measurement_a_cycle(part, key):
    with pytest.raises(InputError) as caught:
        built(part)
    assert (caught.value.field, caught.value.value) == (f"tasking.eye.{key}", 10.5)
    built(part, cycle=0.05)
