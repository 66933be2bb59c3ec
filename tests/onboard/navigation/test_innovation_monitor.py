"""Test the innovation monitors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.innovation_monitor import (
    InnovationMonitor,
    InnovationMonitorSettings,
    MonitorResult,
)


def verdicts(watch: InnovationMonitor, outcomes, step=0.1) -> list[MonitorResult]:
    return [watch.record(step * k, o) for k, o in enumerate(outcomes)]


def drawn(rng, n, degrees=3, times=1.0):
    return [UpdateOutcome(times * rng.chisquare(degrees), degrees, True) for _ in range(n)]


def test_consistent_filter_raises_no_alarm():
    doubts = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        doubts += sum(
            v is not MonitorResult.CONSISTENT
            for v in verdicts(InnovationMonitor(), drawn(rng, 600))
        )
    # Half an hour and more of flight.
    assert doubts == 0


def test_repeated_rejections_inflate_then_lose():
    watch = InnovationMonitor()
    found = verdicts(watch, [UpdateOutcome(400.0, 1, False)] * 40)
    assert MonitorResult.INFLATE in found
    assert found.index(MonitorResult.INFLATE) == watch.settings.min_count - 1
    assert watch.nis_ratio == 400.0
    assert found.index(MonitorResult.LOST) > found.index(MonitorResult.INFLATE)
    assert watch.lost


def test_large_accepted_innovations_raise_alarm():
    rng = np.random.default_rng(1)
    found = verdicts(InnovationMonitor(), drawn(rng, 60, times=5.0))
    assert MonitorResult.INFLATE in found


def test_recovers_after_alarm():
    watch = InnovationMonitor()
    verdicts(watch, [UpdateOutcome(400.0, 1, False)] * 40)
    rng = np.random.default_rng(2)
    for k, outcome in enumerate(drawn(rng, 200, 1)):
        watch.record(4.0 + 0.1 * k, outcome)
    assert not watch.lost


def test_slow_sensor_is_monitored():
    found = verdicts(InnovationMonitor(SPEEDS), [UpdateOutcome(400.0, 3, False)] * 10, step=1.0)
    assert MonitorResult.LOST in found


def test_one_reading_after_gap_does_not_recover():
    watch = InnovationMonitor()
    verdicts(watch, [UpdateOutcome(400.0, 1, False)] * 40)
    watch.record(60.0, UpdateOutcome(400.0, 1, False))
    assert watch.lost


def test_empty_outcomes_are_ignored():
    watch = InnovationMonitor()
    nothing = [UpdateOutcome(np.nan, 1, False), UpdateOutcome(0.0, 0, False)] * 100
    assert set(verdicts(watch, nothing)) == {MonitorResult.CONSISTENT}


def whitened(rng, n, shift=0.0, degrees=3):
    for _ in range(n):
        white = rng.normal(size=degrees) + shift
        yield UpdateOutcome(float(white @ white), degrees, True, white)


SPEEDS = InnovationMonitorSettings(max_inflations=None, drift_time_scale_s=8.0)


def test_biased_small_innovations_are_detected():
    rng = np.random.default_rng(3)
    found = verdicts(InnovationMonitor(SPEEDS), whitened(rng, 300, np.array([0.0, 1.2, 0.0])))
    assert MonitorResult.DRIFT in found
    assert MonitorResult.INFLATE not in found
    never = [
        verdicts(InnovationMonitor(SPEEDS), whitened(np.random.default_rng(k), 600))
        for k in range(50)
    ]
    assert all(v is MonitorResult.CONSISTENT for row in never for v in row)


def test_drift_is_reported_above_threshold():
    """Test the fading mean against explicit sums."""
    outcomes = list(whitened(np.random.default_rng(4), 120, np.array([0.9, 0.0, 0.0])))
    found = verdicts(InnovationMonitor(SPEEDS), outcomes)
    first = found.index(MonitorResult.DRIFT)
    times, whites = 0.1 * np.arange(120), np.array([o.whitened for o in outcomes])
    levels = []
    for k in range(120):
        weight = np.exp(-(times[k] - times[: k + 1]) / 8.0)
        levels.append(np.abs(weight @ whites[: k + 1]).max() / np.sqrt((weight**2).sum()))
    expected = next(k for k, level in enumerate(levels) if k >= 5 and level > 5.5)
    assert first == expected


def test_jump_without_tolerance_is_lost_for_good():
    watch = InnovationMonitor(SPEEDS)
    assert MonitorResult.LOST in verdicts(watch, [UpdateOutcome(400.0, 3, False)] * 10)
    rng = np.random.default_rng(5)
    for k, outcome in enumerate(whitened(rng, 300)):
        watch.record(2.0 + 0.1 * k, outcome)
    assert watch.lost


def test_repeated_drift_is_lost():
    """A drift that no bias explains: detected, compensated, detected again."""
    always = whitened(np.random.default_rng(6), 600, np.array([0.0, 0.0, 2.0]))
    watch = InnovationMonitor(SPEEDS)
    told = []
    for k, outcome in enumerate(always):
        if watch.record(0.1 * k, outcome) is MonitorResult.DRIFT:
            told.append((0.1 * k, watch.lost))
    assert [lost for _, lost in told[:4]] == [False, False, False, True]
    assert told[3][0] < SPEEDS.drift_window_s
    assert watch.lost
    verdicts(watch, whitened(np.random.default_rng(7), 600))
    assert watch.lost, "the filter has followed the drift and stays lost"


def test_first_drift_is_lost_without_tolerance():
    watch = InnovationMonitor(replace(SPEEDS, max_drifts=0))
    found = verdicts(watch, whitened(np.random.default_rng(6), 30, np.array([0.0, 0.0, 2.0])))
    assert found.count(MonitorResult.CONSISTENT) < 30
    assert set(found) == {MonitorResult.CONSISTENT, MonitorResult.DRIFT}
    assert watch.lost


def test_monitor_is_calm_without_anomaly():
    watch = InnovationMonitor(SPEEDS)
    assert not watch.is_calm(0.0), "there are no measurements"
    verdicts(watch, whitened(np.random.default_rng(10), 60))
    assert watch.is_calm(6.0)
    assert not watch.is_calm(9.0), "no recent measurements"
    # With a third rejected there is no alarm yet, but the monitor is not calm.
    for k in range(20):
        watch.record(
            6.0 + 0.1 * k, UpdateOutcome(400.0 if k % 3 == 0 else 3.0, 3, k % 3 != 0, np.zeros(3))
        )
    assert not watch.lost
    assert not watch.is_calm(8.0)
    drifting = InnovationMonitor(SPEEDS)
    for k, outcome in enumerate(whitened(np.random.default_rng(11), 100, np.array([0.8, 0, 0]))):
        if drifting.record(0.1 * k, outcome) is not MonitorResult.CONSISTENT:
            break
        is_calm = drifting.is_calm(0.1 * k)
    assert not is_calm, "not calm before the alarm"


def test_drifts_far_apart_are_explained_each():
    """A bias that jumps every 16 s and is corrected each time at once."""
    rng = np.random.default_rng(8)
    watch, found, jumped = InnovationMonitor(SPEEDS), [], False
    for k in range(6 * 160):
        jumped = jumped or k % 160 == 0
        shift = np.array([1.8, 0.0, 0.0]) if jumped else 0.0
        found.append(watch.record(0.1 * k, next(whitened(rng, 1, shift))))
        jumped = jumped and found[-1] is MonitorResult.CONSISTENT
    assert found.count(MonitorResult.DRIFT) == 6
    assert set(found) == {MonitorResult.CONSISTENT, MonitorResult.DRIFT}
    assert not watch.lost


def test_intermittent_beam_keeps_its_mean():
    """Test each beam against explicit sums; a drift is detected despite dropouts."""
    rng = np.random.default_rng(9)
    times, white = 0.1 * np.arange(150), rng.normal(size=(150, 3)) + [0.0, 0.0, 0.9]
    white[rng.random(white.shape) < 0.4] = np.nan
    white[np.isnan(white).all(axis=1), 0] = 0.1
    outcomes = [
        UpdateOutcome(float(np.nansum(row**2)), int(np.isfinite(row).sum()), True, row)
        for row in white
    ]
    found = verdicts(InnovationMonitor(SPEEDS), outcomes)
    seen = np.isfinite(white)
    expected = None
    for k in range(150):
        weight = np.exp(-(times[k] - times[: k + 1]) / 8.0)[:, None] * seen[: k + 1]
        total = np.abs((weight * np.nan_to_num(white[: k + 1])).sum(axis=0))
        squares = (weight**2).sum(axis=0)
        if ((squares >= 6) & (total > 5.5 * np.sqrt(squares))).any():
            expected = k
            break
    assert expected is not None
    assert found.index(MonitorResult.DRIFT) == expected


@pytest.mark.parametrize(
    ("name", "value"),
    [("window_s", 0.0), ("window_s", np.nan), ("min_count", -1), ("max_rejected_share", 1.5),
     ("false_alarm_probability", np.nan), ("correlated_count", np.inf), ("max_inflations", -1),
     ("drift_time_scale_s", -8.0),
     ("drift_threshold", 0.0), ("max_drifts", -1), ("drift_window_s", np.nan)],
)  # fmt: skip
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=rf"monitor\.{name}"):
        InnovationMonitorSettings(**{name: value})


def test_no_recovery_soon_after_alarm():
    watch = InnovationMonitor()
    verdicts(watch, [UpdateOutcome(400.0, 1, False)] * 40)
    rng = np.random.default_rng(2)
    back = None
    for k, outcome in enumerate(drawn(rng, 200, 1)):
        watch.record(4.0 + 0.1 * k, outcome)
        if back is None and not watch.lost:
            back = 0.1 * k
    assert back is not None
    # Inflations count for three windows of 2 s.
    assert 4.0 < back < 6.5


def test_drift_mean_restarts_after_inflation():
    """An inflation changes the state: earlier innovations no longer apply to it."""
    watch = InnovationMonitor(
        InnovationMonitorSettings(drift_time_scale_s=1e3, window_s=1.0, min_count=6)
    )
    one = UpdateOutcome(2.2, 1, True, np.array([1.5]))
    assert all(watch.record(0.1 * k, one) is MonitorResult.CONSISTENT for k in range(10))
    verdicts = [watch.record(1.0 + 0.1 * k, UpdateOutcome(50.0, 1, False)) for k in range(8)]
    assert MonitorResult.INFLATE in verdicts
    assert all(watch.record(2.0 + 0.1 * k, one) is MonitorResult.CONSISTENT for k in range(8))
