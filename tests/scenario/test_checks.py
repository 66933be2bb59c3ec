"""Parts that lack each other, contradict each other, or have no effect."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from tests.worlds import SCENARIOS

IMU = {"kind": "imu"}
FIX = {"kind": "navigation-fix"}
FLASH = {"kind": "flash-lidar"}
FIXED = {"imu": IMU, "fix": FIX, "flash": FLASH}
DEM = {"kind": "gaussian-dem"}
CAMERA = {"kind": "camera"}
SHADOW = {"kind": "shadow", "sensor": "eye"}


def camera_lander(**tables):
    """Return the tables of a lander that maps by its camera, with some replaced."""
    return {
        "sensors": {"imu": IMU, "eye": CAMERA, "radar": {"kind": "radar-altimeter"}},
        "tasking": {"eye": {"kind": "periodic"}},
        "navigation": {"kind": "rocks"},
        "mappers": {"rocks": SHADOW},
    } | tables


def map_lander(**tables):
    """Return the tables of a lander that finds its place on a prior map."""
    return {
        "sensors": {"imu": IMU, "flash": FLASH},
        "navigation": {"kind": "prior-map"},
        "prior_map": {},
    } | tables


def test_what_the_others_break_is_whole():
    for tables in ({}, camera_lander(), map_lander(), {"control": {"kind": "ideal"}}):
        Scenario.from_dict(tables)


# tables, field, value, what the message tells
WRONG = {
    "mapper's sensor is missing": (
        {"mappers": {"dem": {"kind": "gaussian-dem", "sensor": "flush"}}},
        "mappers.dem.sensor", "flush",
        "Sensors and their kinds: imu (imu), altimeter (radar-altimeter), velocimeter",
    ),
    "mapper's sensor is missing, and there is none at all": (
        {"sensors": {}, "tasking": {}},
        "mappers.dem.sensor", "flash", "Sensors and their kinds: none.",
    ),
    "mapper's sensor is of another kind": (
        {"mappers": {"dem": {"kind": "gaussian-dem", "sensor": "imu"}}},
        "mappers.dem.sensor", "imu",
        "a sensor of kind 'flash-lidar', but the sensor 'imu' is of kind 'imu'",
    ),
    "camera mapped by LiDAR": (
        camera_lander(mappers={"dem": {"kind": "quadtree", "sensor": "eye"}}),
        "mappers.dem.sensor", "eye",
        "a sensor of kind 'flash-lidar', but the sensor 'eye' is of kind 'camera'",
    ),
    "one of several cameras is missing": (
        camera_lander(
            mappers={"rocks": {"kind": "shadow", "sensors": ["eye", "other"]}},
            navigation={"kind": "rocks"},
        ),
        "mappers.rocks.sensors", "other", "but no sensor is named 'other'",
    ),
    "one of several cameras is none": (
        camera_lander(
            mappers={"rocks": {"kind": "shadow", "sensors": ["eye", "imu"]}},
            navigation={"kind": "rocks"},
        ),
        "mappers.rocks.sensors", "imu", "but the sensor 'imu' is of kind 'imu'",
    ),
    "shadow mapper without rocks navigation": (
        camera_lander(navigation={"kind": "fixes"}),
        "navigation.kind", "fixes", "must be 'rocks', because mappers.rocks",
    ),
    "navigation without what it needs": (
        {"sensors": {"imu": IMU, "flash": FLASH}, "navigation": {"kind": "fixes"}},
        "navigation.kind", "fixes",
        "needs a sensor of kind 'navigation-fix'",
    ),
    "inertial navigation without an inertial unit": (
        camera_lander(
            sensors={"eye": CAMERA, "radar": {"kind": "radar-altimeter"}},
            control={"kind": "ideal"},
        ),
        "navigation.kind", "rocks", "needs a sensor of kind 'imu'",
    ),
    "prior-map navigation without a LiDAR": (
        map_lander(sensors={"imu": IMU}, tasking={}, mappers={}),
        "navigation.kind", "prior-map", "needs a sensor of kind 'flash-lidar'",
    ),
    "prior-map navigation without a map": (
        {name: table for name, table in map_lander().items() if name != "prior_map"},
        "prior_map", None, "is required, because navigation of kind 'prior-map'",
    ),
    "a map that nothing uses": (
        {"sensors": FIXED, "prior_map": {}},
        "prior_map", "given", "is not used by navigation of kind 'fixes'",
    ),
    "knowledge of the start that nothing uses": (
        {"sensors": FIXED, "initial_uncertainty": {}},
        "initial_uncertainty", "given", "is not used by navigation of kind 'fixes'",
    ),
    "control on gyroscopes without any": (
        {"sensors": {"fix": FIX, "flash": FLASH}},
        "control.kind", "pd",
        "use control.kind = 'ideal'",
    ),
    "control too fast for its clock": (
        {"control": {"frequency_rad_s": 26.0}},
        "control.frequency_rad_s", 26.0, "at most 15 rad/s for a stable attitude loop",
    ),
    "control too fast for a slower clock": (
        {"simulation": {"step_s": 0.1}},
        "control.frequency_rad_s", 4.0, "at most 1.5",
    ),
    "tasking of a sensor that is not there": (
        {"tasking": {"flash": {"kind": "at-altitudes"}, "flesh": {"kind": "periodic"}}},
        "tasking.flesh", "flesh", "Did you mean 'flash'?",
    ),
    "tasking of a sensor that measures by itself": (
        {"tasking": {"flash": {"kind": "at-altitudes"}, "imu": {"kind": "periodic"}}},
        "tasking.imu", "periodic", "a sensor of kind 'imu' measures in every cycle",
    ),
    "a sensor that nobody tells to measure": (
        {"tasking": {}},
        "sensors.flash", "flash-lidar", "needs a table [tasking.flash]",
    ),
    "more measurements than cycles": (
        {"tasking": {"flash": {"kind": "periodic", "rate_hz": 10.5}}},
        "tasking.flash.rate_hz", 10.5, "must be at most 10 Hz, one measurement per control cycle",
    ),
    "more measurements on the site than cycles": (
        {
            "tasking": {"flash": {"kind": "sweep", "dwell_rate_hz": 25.0}},
            "simulation": {"cycle_s": 0.05},
        },
        "tasking.flash.dwell_rate_hz", 25.0, "at most 20",
    ),
    "a sensor that no part uses": (
        {"sensors": {"imu": IMU, "fix": FIX, "flash": FLASH, "radar": {"kind": "radar-altimeter"}}},
        "sensors.radar", "radar-altimeter",
        "navigation of kind 'fixes' does not use sensors of kind 'radar-altimeter'",
    ),
    "a LiDAR that no mapper maps": (
        {"sensors": FIXED, "mappers": {}},
        "sensors.flash", "flash-lidar", "is not used: no mapper names it",
    ),
    "decisions on a map that is not there": (
        {"decisions": {"map": "dam"}},
        "decisions.map", "dam", "Did you mean 'dem'?",
    ),
    "shadows along ground that nobody measures": (
        {"mappers": {"dem": DEM, "rocks": {"kind": "shadow", "sensor": "flash",
        "terrain_mapper": "dam"}}},
        "mappers.rocks.terrain_mapper", "dam", "Did you mean 'dem'?",
    ),
    "shadows along the ground of the map that they make": (
        {"mappers": {"dem": DEM, "rocks": {"kind": "shadow", "terrain_mapper": "rocks"}}},
        "mappers.rocks.terrain_mapper", "rocks", "Known names: dem",
    ),
    "a fused map of one that is not there": (
        {"mappers": {"dem": DEM, "all": {"kind": "fused", "inputs": ["dam"]}}},
        "mappers.all.inputs", "dam", "Did you mean 'dem'?",
    ),
    "a fused map of itself": (
        {"mappers": {"dem": DEM, "all": {"kind": "fused", "inputs": ["dem", "all"]}}},
        "mappers.all.inputs", "all", "provide elevations or rocks",
    ),
    "a fused map of a mapper twice": (
        {"mappers": {"dem": DEM, "all": {"kind": "fused", "inputs": ["dem", "dem"]}}},
        "mappers.all.inputs", ("dem", "dem"), "each mapper once",
    ),
    "a fused map of two maps of the same returns": (
        {"mappers": {"dem": DEM, "other": DEM, "all": {"kind": "fused"}}},
        "mappers.all.inputs", ("dem", "other"), "only one mapper that provides elevations",
    ),
    "a fused map of nothing": (
        {"mappers": {"all": {"kind": "fused"}}},
        "mappers.all.inputs", (), "needs other mappers whose maps",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(WRONG))
def test_each_mistake_names_field_value_and_remedy(name):
    tables, field, value, told = WRONG[name]
    with pytest.raises(InputError) as caught:
        Scenario.from_dict(tables)
    assert (caught.value.field, caught.value.value) == (field, value)
    assert told in str(caught.value)


def test_limits_themselves_are_allowed():
    Scenario.from_dict({"control": {"frequency_rad_s": 15.0}})
    Scenario.from_dict({"tasking": {"flash": {"kind": "periodic", "rate_hz": 10.0}}})
    named = Scenario.from_dict({"decisions": {"map": "dem"}})
    assert named.decisions.map == "dem"


def test_an_inertial_unit_serves_control_alone():
    """Fixes take its rate; with an ideal actuator it is still of use to them."""
    Scenario.from_dict({"control": {"kind": "ideal"}})
    Scenario.from_dict({"sensors": {"fix": FIX, "flash": FLASH}, "control": {"kind": "ideal"}})


@dataclass(frozen=True)
class ArrivalOnly:
    """Navigation of another package, which needs and takes nothing."""

    needs = ()
    accepts = ()
    needs_prior_map = False
    uses_prior_map = False

    def build(self, briefing):
        """Return nothing: it is only checked."""


def test_parts_of_other_packages_are_checked_by_what_they_say(monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", __name__)
    kind = f"{__name__}:ArrivalOnly"
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({"navigation": {"kind": kind}, "sensors": FIXED})
    assert caught.value.field == "sensors.fix"
    assert kind in caught.value.problem
    Scenario.from_dict({"navigation": {"kind": kind}, "sensors": {"imu": IMU, "flash": FLASH}})


def test_changes_are_checked_too():
    with pytest.raises(InputError, match=r"prior_map: is required"):
        Scenario.load(SCENARIOS / "morpheus.toml").changed(prior_map=None)


@pytest.mark.parametrize(
    ("tables", "field", "words"),
    [
        ({"mappers": {"a/b": {"kind": "gaussian-dem"}}}, "mappers", "letters, digits"),
        ({"mappers": {"": {"kind": "gaussian-dem"}}}, "mappers", "letters, digits"),
        (
            {"sensors": {n: {"kind": "imu"} for n in ("one", "two")}},
            "sensors.two",
            "a second inertial measurement unit",
        ),
        (
            {"sensors": {n: {"kind": "navigation-fix"} for n in ("one", "two")}},
            "sensors.two",
            "a second navigation-fix sensor",
        ),
        (
            {"tasking": {"flash": {"kind": "at-altitudes", "altitudes_m": []}}},
            "tasking.flash.altitudes_m",
            "at least one",
        ),
        (
            {"control": {"damping": 3.0, "frequency_rad_s": 8.0}},
            "control.frequency_rad_s",
            "at most 6.66667",
        ),
        ({"control": {"damping": 50.0}}, "control.damping", "at most 3"),
        (
            map_lander(prior_map={"size_m": 1e5, "posting_m": 0.1}),
            "prior_map.size_m",
            "at most 400 m (4000 points of 0.1 m)",
        ),
    ],
)
def test_names_doubles_and_gains(tables, field, words):
    with pytest.raises(InputError) as caught:
        Scenario.from_dict(tables)
    assert caught.value.field == field
    assert words in caught.value.problem
