"""The Gaussian DEM scripts run; the tables hold what they promise, small."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

from tests.conftest import SCENARIOS

SCRIPT = SCENARIOS / "gaussian_dem" / "tables.py"


def run(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout


def test_configurations_are_those_of_table_4(tmp_path):
    out = tmp_path / "table.json"
    run("--table", "4", "--json", str(out))
    rows = json.loads(out.read_text())["4"]["rows"]
    assert rows[3][0] == pytest.approx(100.0, abs=1.1)
    assert rows[8][2] == pytest.approx(1.611, abs=0.02)


@pytest.mark.slow
def test_table_3_has_no_false_safe_cell(tmp_path):
    out = tmp_path / "table.json"
    run("--table", "3", "--json", str(out), "--out", str(tmp_path))
    rows = json.loads(out.read_text())["3"]["rows"]
    assert all(row["false_safe"] == 0 for row in rows)
    recall = [row["recall"][0] for row in rows]
    assert recall == sorted(recall, reverse=True)
    assert min(row["bounded"][0] for row in rows if row["c"] <= 0.5) > 0.8
    assert (tmp_path / "figure_12_conservativeness.png").exists()


@pytest.mark.slow
def test_table_5_beats_the_paper_everywhere(tmp_path):
    assert run("--table", "5").count("yes │            yes") == 9


def test_unknown_table_is_refused():
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--table", "9"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_sampled_terrain_has_the_errors_that_the_map_states(tmp_path, script):
    study = script("gaussian_dem", "monte_carlo")
    for configuration in (1, 3):
        dem = study.scanned(configuration, 0)[-1]
        task = study.Task(configuration, 0, 0, 1)
        ratio = [
            (study.error_field(task, np.random.default_rng([9, n])) ** 2 / dem.variance)[
                dem.observed
            ].mean()
            for n in range(3)
        ]
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.08)
    done = CliRunner().invoke(study.main, ["--samples", "2", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert done.output.count("support planes") == 4
    assert (tmp_path / "monte_carlo.png").stat().st_size > 20_000
    assert CliRunner().invoke(study.main, ["--samples", "0"]).exit_code == 2


def test_calibration_wants_fields_to_judge_by(script):
    study = script("gaussian_dem", "calibration")
    done = CliRunner().invoke(study.main, ["--fields", "1"])
    assert done.exit_code == 2
