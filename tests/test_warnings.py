"""Commands run where every warning is an error, as test suites of users set it."""

from __future__ import annotations

import subprocess
import sys

import pytest


def test_a_check_of_a_scenario_raises_no_warning():
    command = [sys.executable, "-W", "error", "-m", "lunarsim", "scenario", "check", "apollo15"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["fly", "hirise", "--out", "o"], ["render", "apollo15", "--out", "o.png"],
        ["terrain", "truth", "apollo15", "--size", "30", "--out", "o.nc"],
        ["terrain", "preview", "hirise", "--out", "o.png"],
        ["compare", "hirise", "--policies", "no-divert", "--flights", "1", "--jobs", "1",
         "--cache-size", "0", "--out", "o"],
    ],
    ids=lambda words: " ".join(words[:2]),
)  # fmt: skip
def test_a_command_that_writes_raises_no_warning(words, tmp_path):
    command = [sys.executable, "-W", "error", "-m", "lunarsim", *words]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
