"""Commands run where every warning is an error, as test suites of users set it."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lunarsim.scenario import Scenario
from tests.worlds import TINY_FLIGHT

# Runs commands in one process, each given as one argument.
RUN = """
import sys
from lunarsim.cli import main
for line in sys.argv[1:]:
    main(line.split(), standalone_mode=False)
"""


def test_commands_raise_no_warning(tmp_path):
    """Elevations from a file are read, and a small flight is flown; the test below flies more."""
    Scenario.from_dict(TINY_FLIGHT).save(tmp_path / "tiny.toml")
    commands = ["scenario check apollo15", "fly tiny.toml"]
    words = [sys.executable, "-W", "error", "-c", RUN, *commands]
    done = subprocess.run(words, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "vertical speed" in done.stdout


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
