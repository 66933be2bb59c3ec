"""Quadtree scripts on one small field."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from lunarsim.scenario import Scenario
from tests.conftest import SCENARIOS


@pytest.fixture
def small(script, monkeypatch, tmp_path):
    """A short sweep instead of the paper's, for the named script."""
    short = Scenario.load(SCENARIOS / "morpheus.toml").changed(
        terrain={"size_m": 200.0, "field_m": 70.0, "boulders": 150, "craters": 12},
        start={"position_m": [-220.0, 0.0, 150.0], "position_sigma_m": 1.0},
        initial_uncertainty={"position_m": 8.0},
        prior_map={"size_m": 180.0},
        sensors={"flash": {"half_fov_tangent": 0.025}},
        tasking={"flash": {"duration_s": 9.0, "rate_hz": 10.0, "size_m": 50.0}},
        mappers={"sites": {"size_m": 64.0}},
        approach={"time_to_go_s": 30.0},
        decisions={"first_altitude_m": 80.0},
        simulation={"cycle_s": 0.1},
    )

    def use(name):
        module = script("quadtree", name)
        short.save(tmp_path / "morpheus.toml")
        monkeypatch.setattr(module, "SCENARIOS", tmp_path)
        return module

    return use


def test_hazard_field_prints_and_draws(small, monkeypatch, tmp_path):
    experiment = small("hazard_field")
    monkeypatch.setattr(experiment, "TIMES", (2.0, 4.0))
    out, file = tmp_path / "out", tmp_path / "all.json"
    arguments = ["--seed", "5", "--out", str(out), "--json", str(file)]
    done = CliRunner().invoke(experiment.main, arguments)
    assert done.exit_code == 0, done.output
    assert "landing zones with a true hazard" in done.output
    data = json.loads(file.read_text())
    last = data["summary"]["looks"][-1]
    assert data["summary"]["locked"] == 1
    assert max(data["summary"]["position_rms_m"]) < 0.5
    assert last["map_error_rms"] < 0.1
    assert last["sites"] == 5
    assert last["zones_with_hazard"] == 0
    assert 0.0 < last["missed_m2"] + last["false_m2"] < 0.2 * last["judged_m2"]
    for name in ("mapping", "slopes", "hazards", "quadtree", "sites", "choice", "navigation"):
        assert (out / f"{name}.png").stat().st_size > 20_000
    assert CliRunner().invoke(experiment.main, ["--fields", "0"]).exit_code == 2


@pytest.mark.slow
def test_the_same_seed_gives_the_same_hazard_field_results(small, monkeypatch, tmp_path):
    experiment = small("hazard_field")
    monkeypatch.setattr(experiment, "TIMES", (2.0, 4.0))
    found = []
    for file in (tmp_path / "a.json", tmp_path / "b.json"):
        done = CliRunner().invoke(experiment.main, ["--seed", "5", "--json", str(file)])
        assert done.exit_code == 0, done.output
        found.append(json.loads(file.read_text()))
    assert found[0] == found[1]
