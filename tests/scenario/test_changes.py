"""Values laid over a scenario by `--set KEY=VALUE`."""

from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_changes


def test_values_are_read_as_toml_has_them_and_words_need_no_quotes():
    changed = with_changes(
        Scenario.from_dict({}),
        [
            "terrain.size_m=200", "sun.elevation_deg = 5", "start.position_m.2=450.5",
            "policy=nearest-safe", "target.position_m=[1, 2.5]", "mappers.dem.safety=level",
            "terrain.preset='mare'", "rocks.cover=2e-2",
        ],
    )  # fmt: skip
    assert (changed.terrain.size_m, changed.sun.elevation_deg) == (200.0, 5.0)
    assert changed.start.position_m == (-600.0, 0.0, 450.5)
    assert changed.policy.kind == "nearest-safe"
    assert changed.target.position_m == (1.0, 2.5)
    assert changed.mappers["dem"].safety == "level"
    assert (changed.terrain.preset, changed.rocks.cover) == ("mare", 0.02)
    assert changed.sun.azimuth_deg == 270.0


def test_no_change_is_the_scenario_itself():
    scenario = Scenario.from_dict({})
    assert with_changes(scenario, []) == scenario


def test_a_path_is_relative_to_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    changed = with_changes(Scenario.from_dict({}), ["terrain.kind=dtm", "terrain.path=sub/x.tif"])
    assert changed.terrain.path == tmp_path / "sub" / "x.tif"


@pytest.mark.parametrize(
    ("text", "field", "told"),
    [
        ("rocks.cover", "--set", "must be KEY=VALUE"),
        ("rocks.cover=", "--set", "must be KEY=VALUE"),
        ("=3", "--set", "must be KEY=VALUE"),
        ("rocks.cover=0.9", "--set rocks.cover", "at most 0.2"),
        ('rocks.cover="0.05"', "--set rocks.cover", "must be a number"),
        ("rocks.cover=true", "--set rocks.cover", "must be a number"),
        ("rocks.cover=nan", "--set rocks.cover", "finite"),
        ("rocks.cover=few", "--set rocks.cover", "must be a number"),
        ("rocks.cover=[0.1", "--set", "valid TOML value"),
        ("rocks.cover=1\nsun.elevation_deg=3", "--set", "one key and one value"),
        ("rocks.covr=0.1", "--set rocks.covr", "Did you mean 'cover'?"),
        ("roks.cover=0.1", "--set roks", "Did you mean 'rocks'?"),
        ("rocks..cover=0.1", "--set", "without empty parts"),
        ("start.position_m.7=1", "--set start.position_m.7", "an index from 0 to 2"),
        ("start.position_m.3=1", "--set start.position_m.3", "an index from 0 to 2"),
        ("rocks.cover.0=1", "--set rocks.cover.0", "the scenario has no list there"),
        ("self=1", "--set self", "unknown key"),
        ("sun=1", "--set sun", "a table"),
    ],
)
def test_a_change_that_will_not_do_names_key_and_remedy(text, field, told):
    with pytest.raises(InputError) as caught:
        with_changes(Scenario.from_dict({}), [text])
    assert caught.value.field == field
    assert told in str(caught.value)


def test_a_key_given_twice_is_refused():
    with pytest.raises(InputError, match="each key only once"):
        with_changes(Scenario.from_dict({}), ["rocks.cover=0.1", "rocks.cover=0.1"])
