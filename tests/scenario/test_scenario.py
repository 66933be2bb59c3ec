from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from tests.worlds import SCENARIOS


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_scenarios_load(path):
    assert Scenario.load(path).name == path.stem


def test_round_trip(tmp_path):
    scenario = Scenario.load(SCENARIOS / "hirise.toml")
    scenario.save(tmp_path / "copy.toml")
    assert Scenario.load(tmp_path / "copy.toml") == scenario


@pytest.mark.parametrize(
    ("data", "field", "hint"),
    [
        ({"terrain": {"posting_km": 1.0}}, "terrain.posting_km", "did you mean 'posting_m'"),
        ({"terain": {}}, "terain", "did you mean 'terrain'"),
        ({"lander": {"dry_mass_kg": "1.1 t"}}, "lander.dry_mass_kg", "a plain number in kg"),
        ({"lander": {"dry_mass_kg": -3}}, "lander.dry_mass_kg", "greater than 0"),
        ({"lander": {"dry_mass_kg": float("nan")}}, "lander.dry_mass_kg", "finite"),
        ({"rocks": {"cover": 0.9}}, "rocks.cover", "less than or equal to 0.2"),
        ({"rocks": {"min_diameter_m": 5.0}}, "rocks.min_diameter_m", "less than rocks.max"),
        ({"terrain": {"kind": "dtm"}}, "terrain.path", "give it for kind"),
        ({"simulation": {"cycle_s": 0.015}}, "simulation.cycle_s", "whole number"),
        ({"start": {"position_m": [0.0, 1.0]}}, "start.position_m.2", "required"),
        ({"guidance": {"attitude": "magic"}}, "guidance.attitude", "'pd' or 'slerp'"),
        ({"decisions": {"last_altitude_m": 900.0}}, "decisions.last_altitude_m", "less than"),
    ],
)
def test_mistakes_name_field_and_remedy(data, field, hint):
    with pytest.raises(InputError) as caught:
        Scenario.from_dict(data)
    assert caught.value.field == field
    assert hint in caught.value.expected


def test_missing_and_broken_files(tmp_path):
    with pytest.raises(InputError, match="existing TOML file"):
        Scenario.load(tmp_path / "none.toml")
    (tmp_path / "broken.toml").write_text("name = [")
    with pytest.raises(InputError, match="a TOML file"):
        Scenario.load(tmp_path / "broken.toml")
