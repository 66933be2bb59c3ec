"""Quadtree scripts on one small field."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from lunarsim.scenario import Scenario
from lunarsim.studies import report_study, run_study
from lunarsim.studies.command import study_command
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


def test_hazard_field_prints_and_draws(small, monkeypatch, tmp_path, capsys):
    experiment = small("hazard_field")
    monkeypatch.setattr(experiment, "TIMES", (2.0, 4.0))
    out = tmp_path / "out"
    rows = run_study(experiment.study, seed=5, out=out)
    report_study(experiment.study, rows, seed=5, out=out)
    assert "landing zones with a true hazard" in capsys.readouterr().out
    assert json.loads((out / "results.json").read_text())["rows"] == rows
    summary = experiment.summarise(rows)
    last = summary["evaluations"][-1]
    assert summary["locked"] == 1
    assert max(summary["position_rms_m"]) < 0.5
    assert last["map_error_rms"] < 0.1
    assert last["sites"] == 5
    assert last["zones_with_hazard"] == 0
    assert 0.0 < last["missed_m2"] + last["false_m2"] < 0.2 * last["evaluated_m2"]
    for name in ("mapping", "slopes", "hazards", "quadtree", "sites", "choice", "navigation"):
        assert (out / f"{name}.png").stat().st_size > 20_000
    done = CliRunner().invoke(study_command(experiment.study), ["--fields", "0"])
    assert done.exit_code == 2


@pytest.mark.slow
def test_the_same_seed_gives_the_same_hazard_field_results(small, monkeypatch):
    experiment = small("hazard_field")
    monkeypatch.setattr(experiment, "TIMES", (2.0, 4.0))
    first = run_study(experiment.study, seed=5)
    experiment.fly_field.cache_clear()
    assert first == run_study(experiment.study, seed=5)
