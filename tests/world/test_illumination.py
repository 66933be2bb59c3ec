"""Hours of sunlight, Earth in view and landing windows, checked against directions of the sky."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.site import parse_time
from lunarsim.world.ephemeris import MOON_RADIUS_M, sky_at
from lunarsim.world.horizon import Horizon, smooth_horizon
from lunarsim.world.illumination import Illumination

START = parse_time("time", "2027-03-01T12:00Z")
LEVEL = smooth_horizon(0.0, MOON_RADIUS_M)


def _month(latitude_deg, longitude_deg, horizon=LEVEL, days=29.53, step=1.0):
    place = np.deg2rad([latitude_deg, longitude_deg])
    return Illumination.over(*place, horizon, START, days, step)


def _sky(latitude_deg, longitude_deg, *times):
    return sky_at(*np.deg2rad([latitude_deg, longitude_deg]), np.array(times))


def test_sunrise_and_sunset_are_the_upper_limb_on_the_horizon():
    found = _month(20.0, 30.0, days=60.0)
    days = found.sunlit()
    assert len(days) == 2
    for one in days:
        sky = _sky(20.0, 30.0, one.start, one.end)
        limb = np.rad2deg(sky.sun_elevation + 0.5 * sky.sun_diameter)
        cut = one.starts_before, one.ends_after
        for edge, is_cut in zip(limb, cut, strict=True):
            assert is_cut or abs(edge) < 0.01
    whole = [one for one in days if not one.starts_before and not one.ends_after]
    assert whole
    assert whole[0].hours == pytest.approx(29.53 * 12.0, rel=0.02)


def test_illuminated_hours_count_the_visible_fraction():
    """The total is that of short steps, and half of the month on the equator."""
    for place in ((0.0, 0.0), (-89.9, 0.0)):
        coarse, fine = _month(*place), _month(*place, step=0.1)
        assert coarse.illuminated_hours == pytest.approx(fine.illuminated_hours, abs=0.5)
    assert _month(0.0, 0.0).illuminated_hours == pytest.approx(29.53 * 12.0, rel=0.01)
    # Near the pole, the Sun is partly visible for more than a day at sunrise and at sunset.
    fine = _month(-88.5, 0.0, step=0.1)
    partly = (fine.sun_visible > 0.01) & (fine.sun_visible < 0.99)
    assert partly.mean() * fine.hours > 48.0
    lit_hours = sum(one.hours for one in fine.sunlit())
    assert fine.illuminated_hours < lit_hours - 24.0


def test_the_earth_is_in_view_on_the_near_side_only():
    near, far, limb = _month(10.0, 0.0), _month(10.0, 180.0), _month(0.0, 92.0, days=27.6)
    assert near.earth_hours == pytest.approx(near.hours)
    assert far.earth_hours == 0.0
    assert far.earth_in_view() == []
    assert 0.1 < limb.earth_hours / limb.hours < 0.9  # libration
    for one in limb.earth_in_view():
        sky = _sky(0.0, 92.0, one.start, one.end)
        for elevation, is_cut in zip(
            sky.earth_elevation, (one.starts_before, one.ends_after), strict=True
        ):
            assert is_cut or abs(np.rad2deg(elevation)) < 0.01


def test_terrain_hides_sun_and_earth():
    """A wall of 30 deg in the eastern half delays sunrise; one all around hides the Earth."""
    east = Horizon(np.where(np.arange(360) < 180, np.deg2rad(30.0), 0.0), np.zeros(360))
    open_, walled = _month(0.0, 0.0), _month(0.0, 0.0, east)
    assert walled.illuminated_hours == pytest.approx(
        open_.illuminated_hours - 30.0 / 180.0 * 29.53 * 12.0, abs=3.0
    )
    around = Horizon(np.full(360, np.deg2rad(85.0)), np.zeros(360))
    assert _month(0.0, 30.0, around).earth_hours == 0.0


def test_windows_satisfy_all_conditions_and_end_where_one_fails():
    found = _month(0.0, 88.0, days=60.0)
    low, high = np.deg2rad([5.0, 14.0])
    windows = found.landing_windows(low, high)
    assert windows
    for one in windows:
        inside = one.start + (one.end - one.start) * np.linspace(0.01, 0.99, 9)
        sky = _sky(0.0, 88.0, *inside)
        assert (sky.sun_elevation > low).all()
        assert (sky.sun_elevation < high).all()
        assert (sky.earth_elevation > 0.0).all()
        assert one.sun_visible == pytest.approx(1.0)
        assert one.hours == pytest.approx(float((one.end - one.start) / np.timedelta64(1, "h")))
        ends = _sky(0.0, 88.0, one.start, one.end)
        margin = np.minimum(ends.sun_elevation - low, high - ends.sun_elevation)
        margin = np.minimum(margin, ends.earth_elevation)
        assert np.abs(np.rad2deg(margin)).max() < 0.01
    assert found.landing_windows(*np.deg2rad([88.0, 89.0])) != windows
    dark = Horizon(np.full(360, np.deg2rad(20.0)), np.zeros(360))
    hidden = _month(0.0, 45.0, dark, days=60.0).landing_windows(low, high)
    assert hidden
    assert all(one.sun_visible == 0.0 for one in hidden)


def test_a_period_that_begins_and_ends_in_sunlight_is_marked():
    noon = np.argmax(_month(0.0, 0.0).sky.sun_elevation)
    start = _month(0.0, 0.0).sky.time[noon]
    found = Illumination.over(0.0, 0.0, LEVEL, start, 2.0, 1.0)
    (one,) = found.sunlit()
    assert (one.starts_before, one.ends_after) == (True, True)
    assert one.hours == pytest.approx(48.0)
    assert (one.start, one.end) == (found.sky.time[0], found.sky.time[-1])


def test_the_period_ends_within_the_years_of_the_ephemeris():
    start = parse_time("time", "2100-12-30T00:00Z")
    with pytest.raises(InputError, match="days: must end the period by the end of 2100"):
        Illumination.over(0.0, 0.0, LEVEL, start, 2.0, 1.0)
    assert Illumination.over(0.0, 0.0, LEVEL, start, 1.9, 1.0).hours == 45.0


@pytest.mark.parametrize(("days", "step"), [(0.01, 1.0), (4_000.0, 0.5)])
def test_the_number_of_samples_is_limited(days, step):
    with pytest.raises(InputError, match="days: must be from 1 to 100000 times the step"):
        _month(0.0, 0.0, days=days, step=step)
