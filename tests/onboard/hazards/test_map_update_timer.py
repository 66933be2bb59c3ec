"""Test when maps are recomputed."""

from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.map_update_timer import MapUpdateTimer


def test_a_map_is_due_once_an_interval_and_always_without_a_time():
    times = MapUpdateTimer(0.3)
    times.mark_updated()
    assert times.is_due
    for time, due in ((0.0, False), (0.2, False), (0.1 + 0.2, True)):
        times.set_time(time)
        assert times.is_due == due, time
    times.mark_updated()
    assert not times.is_due
    times.force_update()
    assert times.is_due


@pytest.mark.parametrize("interval", [-1.0, float("nan"), float("inf")])
def test_impossible_intervals_are_refused(interval):
    with pytest.raises(InputError, match="interval"):
        MapUpdateTimer(interval)
