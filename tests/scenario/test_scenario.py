"""Scenario files: reading, writing, changing, and what is told of mistakes."""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.scenario.layout import MOVED_TABLES
from tests.worlds import SCENARIOS

SHIPPED = sorted(SCENARIOS.glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_scenarios_load(path):
    assert Scenario.load(path).name == path.stem


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_round_trip(path, tmp_path):
    """By file, by text, by plain tables and to another process: the same, relative paths too."""
    scenario = Scenario.load(path)
    scenario.save(tmp_path / "copy.toml")
    assert Scenario.load(tmp_path / "copy.toml") == scenario
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert Scenario.from_dict(scenario.to_dict()) == scenario
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    assert scenario.changed() == scenario
    assert scenario.changed(name="other") != scenario


def test_defaults_make_a_whole_study():
    scenario = Scenario.from_dict({})
    assert scenario.name == "unnamed"
    assert scenario.vehicle.kind == "lander"
    assert scenario.vehicle.make() == Lander()
    assert sorted(scenario.sensors) == ["altimeter", "flash", "imu", "stars", "velocimeter"]
    assert scenario.navigation.kind == "inertial"
    assert (scenario.prior_map, scenario.initial_uncertainty) == (None, None)
    assert scenario.start.heading_deg == 90.0
    assert scenario.start.make().heading == pytest.approx(np.pi / 2)
    assert scenario.mappers["dem"].posting_m == scenario.mappers["dem"].make().posting == 0.2
    with pytest.raises(AttributeError):
        scenario.vehicle.wheels  # noqa: B018
    with pytest.raises(FrozenInstanceError):
        scenario.name = "other"


def test_relative_paths_start_from_the_files_folder(tmp_path):
    scenario = Scenario.load(SCENARIOS / "hirise.toml")
    assert scenario.terrain.path.is_absolute()
    assert scenario.terrain.path.parent == SCENARIOS / "data"
    (tmp_path / "s.toml").write_text('[terrain]\nkind = "dtm"\npath = "sub/ground.tif"')
    assert Scenario.load(tmp_path / "s.toml").terrain.path == tmp_path / "sub" / "ground.tif"


@pytest.mark.parametrize(
    ("data", "field", "hint"),
    [
        ({"terrain": {"posting_km": 1.0}}, "terrain.posting_km", "Did you mean 'posting_m'"),
        ({"terain": {}}, "terain", "Did you mean 'terrain'"),
        ({"vehicle": {"dry_mass_kg": "1.1 t"}}, "vehicle.dry_mass_kg", "a plain number in kg"),
        ({"vehicle": {"dry_mass_kg": -3}}, "vehicle.dry_mass_kg", "must be positive"),
        ({"vehicle": {"dry_mass_kg": float("nan")}}, "vehicle.dry_mass_kg", "finite"),
        ({"rocks": {"cover": 0.9}}, "rocks.cover", "at most 0.2"),
        ({"rocks": {"min_diameter_m": 5.0}}, "rocks.min_diameter_m", "less than max_diameter_m"),
        ({"terrain": {"kind": "dtm"}}, "terrain.path", "Name a raster file"),
        (
            {"simulation": {"cycle_s": 0.015}},
            "simulation.cycle_s",
            "a multiple of step_s, which is 0.01 s",
        ),
        ({"start": {"position_m": [0.0, 1.0]}}, "start.position_m", "a list of 3 values in m"),
        ({"start": {"position_m": [0.0, 1.0, 2.0, 3.0]}}, "start.position_m", "a list of 3 values"),
        ({"start": {"position_m": [0.0, 1.0, "2"]}}, "start.position_m[2]", "Delete the quotes."),
        ({"terrain": {"kind": "dtm", "path": "x", "dtm_window": [1]}}, "terrain.dtm_window", "4"),
        ({"policy": "safest"}, "policy", 'a table [policy] with kind = "safest"'),
        ({"control": {"kind": "magic"}}, "control.kind", "Known names: fmu, ideal, library, pd"),
        ({"decisions": {"last_altitude_m": 900.0}}, "decisions.last_altitude_m", "less than"),
        ({"gravity_m_s2": -1.6}, "gravity_m_s2", "a positive number below 1000"),
        ({"gravity_m_s2": True}, "gravity_m_s2", "a positive number below 1000"),
        ({"gravity_m_s2": float("nan")}, "gravity_m_s2", "a positive number below 1000"),
        ({"name": ""}, "name", "must not be empty"),
        ({"name": 3}, "name", "a text in quotes"),
        ({"sun": 3}, "sun", "a table"),
        ({"sensors": [1]}, "sensors", "a table"),
        ({"sensors": {"imu": 1}}, "sensors.imu", "a table"),
        ({"sensors": {"imu": {}}}, "sensors.imu.kind", "is required. Known names: "),
        ({"policy": {"kind": 3}}, "policy.kind", "a text in quotes"),
        ({"policy": {"kind": "safset"}}, "policy.kind", "Did you mean 'safest'"),
        ({"sensors": {"a": {"kind": "sonar"}}}, "sensors.a.kind", "Known names: camera"),
        ({"start": {"heading": 1.0}}, "start.heading", "Did you mean 'heading_deg'"),
        # What a part makes sure of itself is told by its key, in its unit.
        ({"vehicle": {"thrust_min_n": 7000}}, "vehicle.thrust_min_n", "6000 N"),
        (
            {"vehicle": {"inertia_dry_kg_m2": [1, 1, 9]}},
            "vehicle.inertia_dry_kg_m2",
            "sum of the other two",
        ),
    ],
    ids=str,
)
def test_mistakes_name_field_and_remedy(data, field, hint):
    with pytest.raises(InputError) as caught:
        Scenario.from_dict(data)
    assert caught.value.field == field
    assert hint in str(caught.value)


@pytest.mark.parametrize(
    ("table", "value", "owner"),
    [
        ("terrain", {"kind": "fractal", "path": "x.tif"}, "'dtm'"),
        ("terrain", {"kind": "hazard-field", "hurst": 0.5}, "'fractal' or 'dtm'"),
        ("policy", {"kind": "safest", "propellant_weight": 1.0}, "'fuel-aware' or 'scoreboard'"),
        ("control", {"kind": "ideal", "damping": 1.0}, "'pd' or 'quaternion-feedback'"),
    ],
)
def test_a_key_of_another_kind_names_that_kind(table, value, owner):
    key = list(value)[-1]
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({table: value})
    assert (caught.value.field, caught.value.value) == (f"{table}.{key}", value[key])
    assert caught.value.problem == f"is not a key of kind {value['kind']!r}"
    remedy = f"Delete the key, or use it with {table}.kind = {owner}."
    assert caught.value.remedy == remedy


def test_a_key_of_another_kind_in_a_named_table():
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({"mappers": {"dem": {"kind": "gaussian-dem", "split_count": 4}}})
    assert caught.value.field == "mappers.dem.split_count"
    assert "use it with mappers.dem.kind = 'quadtree'." in caught.value.remedy
    # A key of a table within a table is looked for there.
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({"mappers": {"q": {"kind": "quadtree", "sites": {"slope_limit": 1}}}})
    assert caught.value.field == "mappers.q.sites.slope_limit"
    assert "Did you mean 'slope_limit_deg'" in caught.value.remedy


def test_a_kind_without_keys_says_so():
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({"policy": {"kind": "no-divert", "boldness": 1.0}})
    assert caught.value.field == "policy.boldness"
    assert caught.value.remedy == "Kind 'no-divert' has no keys."


def test_an_unknown_key_names_the_tables_that_have_it():
    with pytest.raises(InputError, match=r"\[sensors\.NAME\]"):
        Scenario.from_dict({"navigation": {"kind": "fixes", "position_bias_m": 1.0}})
    with pytest.raises(InputError, match=r"\[approach\], \[braking\]"):
        Scenario.from_dict({"guidance": {"max_tilt_deg": 30.0}})


@pytest.mark.parametrize("table", list(MOVED_TABLES))
def test_tables_of_earlier_versions_report_where_they_are_now(table):
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({table: {}})
    assert caught.value.field == table
    assert caught.value.remedy == f"Use {MOVED_TABLES[table]} instead."
    # And what it names is there to be written.
    assert any(f"[{name}" in MOVED_TABLES[table] for name in Scenario.__dataclass_fields__)


def test_missing_and_broken_files(tmp_path):
    with pytest.raises(InputError, match="existing TOML file"):
        Scenario.load(tmp_path / "none.toml")
    (tmp_path / "broken.toml").write_text("name = [")
    with pytest.raises(InputError, match="a valid TOML file"):
        Scenario.load(tmp_path / "broken.toml")
    (tmp_path / "latin.toml").write_bytes('name = "é"'.encode("latin-1"))
    with pytest.raises(InputError, match="a text file in UTF-8"):
        Scenario.load(tmp_path / "latin.toml")


# --- changed ------------------------------------------------------------------------------


def test_a_change_is_laid_over_what_is_there():
    before = Scenario.from_dict({"sun": {"azimuth_deg": 45.0}, "rocks": {"cover": 0.02}})
    after = before.changed(sun={"elevation_deg": 5.0}, mappers={"dem": {"posting_m": 0.4}})
    assert (after.sun.azimuth_deg, after.sun.elevation_deg) == (45.0, 5.0)
    assert (after.mappers["dem"].posting_m, after.mappers["dem"].size_m) == (0.4, 100.0)
    assert after.rocks == before.rocks
    assert before.sun.elevation_deg == 20.0
    assert after.changed(sun={"elevation_deg": 20.0}, mappers={"dem": {"posting_m": 0.2}}) == before


def test_a_change_reaches_tables_within_tables():
    before = Scenario.load(SCENARIOS / "morpheus.toml")
    after = before.changed(mappers={"sites": {"sites": {"zone_half_side_m": 1.0}}})
    assert after.mappers["sites"].sites.zone_half_side_m == 1.0
    assert after.mappers["sites"].sites.count == before.mappers["sites"].sites.count
    assert after.mappers["sites"].size_m == 102.4


def test_another_kind_starts_from_its_own_defaults():
    before = Scenario.from_dict({"control": {"slew_limit_deg_s": 3.0}})
    assert before.changed(control={"kind": "pd"}).control.slew_limit_deg_s == 3.0
    assert before.changed(control={"kind": "ideal"}).control.slew_limit_deg_s == 15.0
    assert before.changed(control={"slew_limit_deg_s": 4.0}).control.kind == "pd"


def test_none_takes_a_table_or_a_value_away():
    morpheus = Scenario.load(SCENARIOS / "morpheus.toml")
    assert morpheus.changed(initial_uncertainty=None).initial_uncertainty is None
    with pytest.raises(InputError, match="prior_map: is required"):
        morpheus.changed(prior_map=None)
    assert morpheus.changed(approach={"time_to_go_s": None}).approach.time_to_go_s is None
    bare = Scenario.from_dict({}).changed(
        sensors={"flash": None}, tasking={"flash": None}, mappers={"dem": None}
    )
    assert sorted(bare.sensors) == ["altimeter", "imu", "stars", "velocimeter"]
    assert (bare.tasking, bare.mappers) == ({}, {})
    assert Scenario.from_toml(bare.to_toml()) == bare


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"sun": {"elevation_deg": 100.0}}, "sun.elevation_deg"),
        ({"son": {"elevation_deg": 1.0}}, "son"),
        ({"sun": 3}, "sun"),
        ({"mappers": {"dem": {"sensor": "imu"}}}, "mappers.dem.sensor"),
        ({"sensors": {"flash": None}}, "mappers.dem.sensor"),
        ({"gravity_m_s2": 0.0}, "gravity_m_s2"),
    ],
)
def test_a_change_is_checked(change, field):
    with pytest.raises(InputError) as caught:
        Scenario.from_dict({}).changed(**change)
    assert caught.value.field == field


@pytest.mark.parametrize(
    "text", ["[rocks]\ncover = " + "9" * 5000, "[" + ".".join(["a"] * 2000) + "]\nb = 1"],
    ids=["digits", "depth"],
)  # fmt: skip
def test_a_file_that_python_cannot_hold_is_refused(tmp_path, text):
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(InputError):
        Scenario.load(path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("rocks = " + "9" * 5000, "an integer has more than 64 bits"),
        ("rocks = " + "9" * 20, "an integer has more than 64 bits"),
        ("rocks = ", "Invalid value at end of document"),
    ],
    ids=["5,000 digits", "20 digits", "no value"],
)
def test_a_file_that_is_not_toml_gets_a_reason(tmp_path, text, reason):
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Scenario.load(path)
    expected = f"scenario: must be a valid TOML file ({reason}), got {str(path)!r}."
    assert str(caught.value) == expected


IMU, FIX, CAMERA = {"kind": "imu"}, {"kind": "navigation-fix"}, {"kind": "camera"}


@pytest.mark.parametrize(
    ("tables", "kind"),
    [
        ({}, "inertial"),
        ({"sensors": {"imu": IMU, "fix": FIX, "flash": {"kind": "flash-lidar"}}}, "fixes"),
        (
            {
                "sensors": {"imu": IMU, "eye": CAMERA},
                "tasking": {"eye": {"kind": "periodic"}},
                "mappers": {"rocks": {"kind": "shadow", "sensor": "eye"}},
            },
            "rocks",
        ),
        (
            {
                "sensors": {"imu": IMU, "eye": CAMERA, "fix": FIX},
                "tasking": {"eye": {"kind": "periodic"}},
                "mappers": {"rocks": {"kind": "shadow", "sensor": "eye"}},
            },
            "rocks: sensors.fix",
        ),
    ],
)
def test_navigation_left_out_goes_by_what_the_lander_carries(tables, kind):
    if ": " not in kind:
        assert Scenario.from_dict(tables).navigation.kind == kind
        return
    kind, field = kind.split(": ")
    with pytest.raises(InputError, match=f"navigation of kind '{kind}'") as caught:
        Scenario.from_dict(tables)
    assert caught.value.field == field


def test_navigation_goes_by_what_the_lander_carries_after_a_change():
    hard = Scenario.load(SCENARIOS / "hard.toml")
    assert hard.changed(sensors={"fix": None}).navigation.kind == "inertial"
    assert hard.changed(rocks={"cover": 0.1}).navigation.kind == "fixes"
    assert (
        Scenario.from_dict({})
        .changed(sensors={"fix": FIX, "stars": None, "altimeter": None, "velocimeter": None})
        .navigation.kind
        == "fixes"
    )
    # What is not as if left out stays.
    own = Scenario.from_dict({"navigation": {"terrain_slope_deg": 8.0}})
    assert own.changed(rocks={"cover": 0.1}).navigation.terrain_slope_deg == 8.0
    with pytest.raises(InputError, match="navigation-fix"):
        hard.changed(sensors={"fix": None}, navigation={"kind": "fixes"})


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_scenarios_navigate_by_what_the_lander_carries(path):
    """Only the one that states by how much its lander errs is told its place."""
    kind = Scenario.load(path).navigation.kind
    assert (kind == "fixes") == (path.stem == "hard")


@pytest.mark.parametrize(
    "tables", [{"sensors": 3}, {"sensors": {"a": 3}}, {"mappers": {"a": {"kind": [1]}}}]
)
def test_tables_that_are_none_are_reported_as_such(tables):
    with pytest.raises(InputError) as caught:
        Scenario.from_dict(tables)
    assert caught.value.field.startswith(next(iter(tables)))
