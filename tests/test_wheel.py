"""The wheel: it holds what the command line needs, and works where nothing else is."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.scenario import Scenario
from tests.worlds import ROOT, SCENARIOS


def examples() -> list[list[str]]:
    """Return the commands that `lunarsim --help` shows."""
    text = CliRunner().invoke(main, ["--help"]).output
    return [line.split() for line in text.splitlines() if re.match(r"\s+lunarsim \w", line)]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(out), str(ROOT)], check=True, capture_output=True)
    (found,) = out.glob("*.whl")
    return found


def test_help_shows_examples():
    assert [e[1] for e in examples()] == ["scenario", "scenario", "fly", "fly", "compare"]


@pytest.mark.slow
def test_the_wheel_holds_every_scenario_and_its_data(wheel):
    held = set(zipfile.ZipFile(wheel).namelist())
    for path in SCENARIOS.glob("*.toml"):
        assert f"lunarsim/shipped/{path.name}" in held
        data = getattr(Scenario.load(path).terrain.table, "path", None)
        assert data is None or f"lunarsim/shipped/data/{data.name}" in held
    assert not [name for name in held if name.startswith(("tests/", "docs/"))]


@pytest.mark.slow
def test_the_examples_of_help_work_in_an_empty_folder(wheel, tmp_path):
    """In a new environment, with what the package index gives; kernels are compiled anew."""
    place, here = tmp_path / "environment", tmp_path / "empty"
    here.mkdir()
    venv.create(place, with_pip=True)
    subprocess.run([place / "bin" / "pip", "install", "--quiet", wheel], check=True)
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    for command in examples():
        if "--flights" in command:
            command[command.index("--flights") + 1] = "1"
        done = subprocess.run(
            [place / "bin" / "lunarsim", *command[1:]], cwd=here, env=clean, check=False,
            capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert (here / "out" / "one" / "scenario.toml").is_file()
    assert (here / "out" / "compare" / "results.parquet").is_file()
    again = Scenario.load(here / "out" / "one" / "scenario.toml")
    assert again.policy.kind == "safest"
    assert Path(again.terrain.path).parent == here / "data"
