from __future__ import annotations

import os
import subprocess
import sys

import pytest
from click.testing import CliRunner

from lunarsim.cli import main
from tests.conftest import SCENARIOS


def run(*args: str):
    return CliRunner().invoke(main, list(args))


@pytest.mark.parametrize("command", [(), ("fly",), ("compare",)], ids=str)
def test_help(command):
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert "Usage:" in result.output
    assert len(result.output) > 300


def test_version():
    assert "lunarsim, version" in run("--version").output


@pytest.fixture
def small(small_scenario, tmp_path):
    path = tmp_path / "small.toml"
    small_scenario.save(path)
    return path


def test_fly_prints_the_verdict_and_writes_the_record(small, tmp_path):
    out = tmp_path / "flight"
    result = run("fly", str(small), "--seed", "3", "--out", str(out))
    assert result.exit_code == 0, result.output
    assert "vertical speed" in result.output
    assert {p.name for p in out.iterdir()} >= {"flight.json", "descent.png", "maps.png"}


def test_compare_prints_a_row_a_policy(small, tmp_path):
    out = tmp_path / "results"
    result = run(
        "compare", str(small), "--policies", "no-divert,safest", "--flights", "1", "--jobs", "1",
        "--out", str(out), "--no-figures",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "no-divert" in result.output
    assert "exactly safe share" in result.output


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        ("[terrain]\nposting_km = 1", ["terrain.posting_km", "did you mean"]),
        ('[lander]\ndry_mass_kg = "1 t"', ["lander.dry_mass_kg", "1 t", "plain number in kg"]),
        ("[lander]\nthrust_max_n = 1000", ["lander.thrust_max_n", "cannot hover"]),
        ('[terrain]\nkind = "dtm"\npath = "gone.tif"', ["terrain.path", "gone.tif", "existing"]),
        ('[terrain]\nkind = "dtm"\npath = "bad.toml"', ["terrain.path", "GDAL"]),
        ("[start]\nposition_m = [0, 0, -10]", ["start.position_m", "above the ground"]),
        ("[target]\nposition_m = [900, 0]", ["target.position_m", "within the map"]),
    ],
)
def test_mistakes_end_with_code_2_and_write_nothing(tmp_path, edit, words):
    path = tmp_path / "bad.toml"
    path.write_text(edit)
    out = tmp_path / "out"
    for arguments in (["fly", str(path)], ["compare", str(path), "--flights", "1"]):
        result = run(*arguments, "--out", str(out))
        assert result.exit_code == 2, result.output
        assert "Traceback" not in result.output
        for word in words:
            assert word in result.output.replace("\n", "")
    assert not out.exists()


def test_a_folder_with_other_files_is_refused(small, tmp_path):
    result = run("fly", str(small), "--out", str(tmp_path))
    assert result.exit_code == 2
    assert "holds other files" in result.output


def test_unwritable_output_is_a_clean_error(small, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("x")
    result = run("fly", str(small), "--out", str(blocked / "sub"))
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_command_is_installed():
    done = subprocess.run(
        [sys.executable, "-m", "lunarsim.cli", "fly", str(SCENARIOS / "none.toml")],
        capture_output=True, text=True, env=os.environ | {"COLUMNS": "120"}, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.startswith("error: scenario")
