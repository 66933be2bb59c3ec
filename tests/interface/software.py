"""Build and configure external flight software for tests."""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight
from tests.conftest import ROOT

EXAMPLES = ROOT / "scenarios" / "external"
FAULTY = Path(__file__).with_name("faulty_software.py")
# A flight of a few seconds of processor time, with a map and decisions.
SMALL = {
    "name": "small",
    "simulation": {"cycle_s": 0.2},
    "sensors": {
        "imu": {"kind": "imu"},
        "fix": {"kind": "navigation-fix"},
        "flash": {"kind": "flash-lidar"},
    },
    "terrain": {"size_m": 80.0},
    "rocks": {"cover": 0.04, "min_diameter_m": 0.4},
    "mappers": {"dem": {"kind": "gaussian-dem", "posting_m": 0.5, "size_m": 50.0}},
}


def small(**changes: object) -> Scenario:
    return Scenario.from_dict(SMALL).changed(**changes)


def compiler(name: str) -> str:
    """Return the path of a compiler; skip the test without one."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"needs the compiler {name}")
    return found


@cache
def build_folder() -> Path:
    folder = tempfile.mkdtemp(prefix="lunarsim-test-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


@cache
def _library(source: Path) -> Path:
    """Compile a library once per process of the tests."""
    is_c = source.suffix == ".c"
    target = build_folder() / f"{source.stem}-{os.getpid()}.so"
    command = [
        compiler("gcc" if is_c else "g++"), "-std=c11" if is_c else "-std=c++17", "-O2", "-Wall",
        "-Wextra", "-Werror", "-ffp-contract=off", "-fPIC", "-shared",
        f"-I{ROOT / 'lunarsim' / 'interface'}", str(source), "-o", str(target), "-lm",
    ]  # fmt: skip
    made = subprocess.run(command, check=False, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    return target


def library(name: str) -> Path:
    """Return the compiled library of an example, or of a source beside this file."""
    beside = Path(__file__).with_name(name)
    return _library(beside if beside.exists() else EXAMPLES / name)


def assert_same_flight(a: Flight, b: Flight) -> None:
    for table in ("trajectory", "navigation", "commands"):
        one, other = getattr(a, table), getattr(b, table)
        assert one.keys() == other.keys()
        for name in one:
            assert np.array_equal(one[name], other[name], equal_nan=True), name
    assert str(a.outcome) == str(b.outcome)
    assert str(a.decisions) == str(b.decisions)
