"""When maps are drawn anew."""

from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.drawing_times import DrawingTimes


def test_a_map_is_due_once_an_interval_and_always_where_nobody_tells_the_time():
    times = DrawingTimes(0.3)
    times.drawn()
    assert times.due
    for time, due in ((0.0, False), (0.2, False), (0.1 + 0.2, True)):
        times.tell(time)
        assert times.due == due, time
    times.drawn()
    assert not times.due
    times.at_once()
    assert times.due


@pytest.mark.parametrize("interval", [-1.0, float("nan"), float("inf")])
def test_impossible_intervals_are_refused(interval):
    with pytest.raises(InputError, match="interval"):
        DrawingTimes(interval)
