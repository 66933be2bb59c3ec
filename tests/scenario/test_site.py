"""The table [site]: what follows from place and date, and what contradicts them."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.site import parse_time
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_changes, with_values
from lunarsim.scenario.scenario_warnings import warnings_for
from lunarsim.world.ephemeris import sky_at
from tests.worlds import TINY_FLIGHT

SITE = {"latitude_deg": 26.1322, "longitude_deg": 3.6339, "time": "1971-07-30T22:16:29Z"}
LATER = "1971-08-02T17:11:00Z"
DATED = Scenario.from_dict({"site": SITE})
ROUND = {
    "moon": {}, "navigation": {"kind": "fixes"}, "tasking": {}, "mappers": {},
    "sensors": {"fix": {"kind": "navigation-fix"}}, "control": {"kind": "ideal"},
}  # fmt: skip


def _angles(sun):
    return (sun.azimuth_deg, sun.elevation_deg, sun.earth_azimuth_deg, sun.earth_elevation_deg)


def _ephemeris(time):
    place = np.deg2rad([SITE["latitude_deg"], SITE["longitude_deg"]])
    return sky_at(*place, np.array([parse_time("time", time)]))


def test_the_date_gives_the_directions_and_the_earthshine():
    for time in (SITE["time"], LATER):
        sky, sun = _ephemeris(time), DATED.changed(site={"time": time}).sun
        wanted = [sky.sun_azimuth, sky.sun_elevation, sky.earth_azimuth, sky.earth_elevation]
        np.testing.assert_allclose(_angles(sun), np.rad2deg(wanted)[:, 0], rtol=0, atol=1e-5)
        assert sun.earthshine == pytest.approx(sky.earthshine[0], abs=1e-8)
        assert sun.diameter_deg == 0.0
    assert 3e-5 < DATED.sun.earthshine < 4e-5


def test_a_site_without_a_date_changes_nothing():
    place = {key: SITE[key] for key in ("latitude_deg", "longitude_deg")}
    assert Scenario.from_dict({"site": place}).sun == Scenario.from_dict({}).sun
    assert Scenario.from_dict({}).site is None


def test_a_scenario_with_a_date_survives_saving_and_pickling(tmp_path):
    DATED.save(tmp_path / "s.toml")
    assert Scenario.load(tmp_path / "s.toml") == DATED
    assert pickle.loads(pickle.dumps(DATED)) == DATED
    assert Scenario.world_from_toml(DATED.to_toml()).sun == DATED.sun


@pytest.mark.parametrize(
    "key", ["azimuth_deg", "elevation_deg", "earth_azimuth_deg", "earth_elevation_deg"]
)
def test_a_direction_that_contradicts_the_date_is_an_error(key):
    with pytest.raises(InputError, match=rf"sun\.{key}: must be omitted.*because site\.time gives"):
        Scenario.from_dict({"site": SITE, "sun": {key: 33.0}})
    same = getattr(DATED.sun, key) + 0.005
    assert getattr(Scenario.from_dict({"site": SITE, "sun": {key: same}}).sun, key) == same


def test_brightness_and_diameter_stay_as_given():
    sun = {"earthshine": 0.0, "diameter_deg": 0.53}
    found = Scenario.from_dict({"site": SITE, "sun": sun})
    assert (found.sun.earthshine, found.sun.diameter_deg) == (0.0, 0.53)
    assert found.changed(site={"time": LATER}).sun.earthshine == 0.0
    assert found.changed(rocks={"cover": 0.1}).sun == found.sun


def test_a_change_of_a_direction_removes_the_date():
    """Campaigns that disperse the Sun's elevation work on dated scenarios."""
    for change in (
        DATED.changed(sun={"elevation_deg": 5.0}),
        with_changes(DATED, ["sun.elevation_deg=5"]),
        with_values(DATED, {"sun.elevation_deg": 5.0}, "dispersions"),
    ):
        assert change.site.time is None
        assert change.site.latitude_deg == SITE["latitude_deg"]
        assert change.sun.elevation_deg == 5.0
        assert _angles(change.sun)[2:] == _angles(DATED.sun)[2:]
        assert change.sun.azimuth_deg == DATED.sun.azimuth_deg
        assert change.changed(site={"time": SITE["time"]}).sun == DATED.sun
    assert DATED.changed(sun={"albedo": 0.2}).site == DATED.site


def test_a_change_of_the_date_replaces_directions_also_explicit_ones():
    plain = Scenario.from_dict({"sun": {"azimuth_deg": 10.0, "elevation_deg": 3.0}})
    assert plain.changed(site=SITE).sun == DATED.sun
    moved = with_changes(DATED, [f"site.time={LATER}", "site.longitude_deg=10"])
    assert moved.sun.elevation_deg > DATED.sun.elevation_deg + 25.0
    with pytest.raises(InputError, match=r"sun\.elevation_deg: must be omitted"):
        DATED.changed(site={"time": LATER}, sun={"elevation_deg": 5.0})
    assert _angles(DATED.changed(site=None).sun) == _angles(Scenario.from_dict({}).sun)


def test_the_latitude_of_the_moon_follows_the_site():
    found = Scenario.from_dict({**ROUND, "site": SITE})
    assert found.moon.latitude_deg == SITE["latitude_deg"]
    assert found.moon.make().axis[2] > 0.0
    assert found.changed(site={"latitude_deg": -10.0}).moon.latitude_deg == -10.0
    assert Scenario.from_toml(found.to_toml()) == found
    with pytest.raises(
        InputError, match=r"moon\.latitude_deg: must be omitted.*site\.latitude_deg"
    ):
        Scenario.from_dict({**ROUND, "moon": {"latitude_deg": 3.0}, "site": SITE})
    with pytest.raises(InputError, match=r"moon\.latitude_deg: must be omitted"):
        found.changed(moon={"latitude_deg": 3.0})
    assert Scenario.from_dict(ROUND).moon.latitude_deg == 0.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"time": "2027-03-01T12:00"}, r"site\.time: must state its time zone.*Add Z"),
        ({"time": "2027-03-01"}, r"site\.time: must be a date and time \(UTC\)"),
        ({"time": "2027-03-01T12:00+02:00"}, r"site\.time: must be a date and time \(UTC\)"),
        ({"time": "2027-02-30T12:00Z"}, r"site\.time: must be a date and time \(UTC\)"),
        ({"time": "1899-12-31T23:59Z"}, r"site\.time: must be from 1900 to 2100"),
        ({"time": "2101-01-01T00:00Z"}, r"site\.time: must be from 1900 to 2100"),
        ({"time": 5}, r"site\.time: must be a text in quotes"),
        ({"latitude_deg": 91.0}, r"site\.latitude_deg: must be at most 90"),
        ({"longitude_deg": -181.0}, r"site\.longitude_deg: must be -180 or more"),
        ({"longitude_deg": None}, r"site\.longitude_deg: must be a number"),
        ({"zone": "Z"}, r"site\.zone: is an unknown key"),
    ],
)
def test_bad_values_are_refused(change, words):
    with pytest.raises(InputError, match=words):
        Scenario.from_dict({"site": SITE | change})


def test_latitude_and_longitude_are_required():
    for missing in ("latitude_deg", "longitude_deg"):
        given = {key: value for key, value in SITE.items() if key != missing}
        with pytest.raises(InputError, match=rf"site\.{missing}: is required"):
            Scenario.from_dict({"site": given})


def test_dates_of_toml_without_quotes_are_read():
    text = "[site]\nlatitude_deg = 26.1322\nlongitude_deg = 3.6339\ntime = "
    assert Scenario.from_toml(text + "1971-07-30T22:16:29Z").sun == DATED.sun
    for bad in ("1971-07-30T22:16:29", "1971-07-30", "1971-07-30T22:16:29+02:00"):
        with pytest.raises(InputError, match=r"site\.time: must"):
            Scenario.from_toml(text + bad)


def test_directions_of_the_date_give_no_warning_without_cameras():
    """Users did not write them."""
    tiny = Scenario.from_dict(TINY_FLIGHT)
    assert list(warnings_for(tiny.changed(site=SITE))) == list(warnings_for(tiny))
    dark = tiny.changed(site=SITE, sun={"albedo": 0.2})
    assert any("sun.albedo" in note for note in warnings_for(dark))
