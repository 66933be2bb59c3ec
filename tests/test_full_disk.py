"""Full disks, closed streams and a deleted working folder: one line, exit code 1, nothing left."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import contextmanager

import pytest

from lunarsim.scenario import Scenario
from tests.worlds import ROOT, TINY_FLIGHT

# Runs commands, one a line, in one process; no file may grow beyond a size.
RUN = """
import resource, shlex, sys
from click.testing import CliRunner
from lunarsim.cli import main

most = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
for line in sys.stdin:
    result = CliRunner().invoke(main, shlex.split(line))
    errors = [l for l in result.stderr.splitlines() if l.startswith("error")]
    print(result.exit_code, errors, type(result.exception).__name__)
"""
COMMANDS = """terrain truth tiny.toml --size 40 --posting 0.2 --out left/truth.nc
terrain preview tiny.toml --out left/preview.png
terrain export tiny.toml --out left/world.tif
terrain export tiny.toml --out left/world.glb
render tiny.toml --altitude 60 --out left/image.png --truth left/truth.npz
fly tiny.toml --policy safest --out left/flight
scenario new hirise --out left/new.toml
"""


@pytest.fixture
def work(tmp_path):
    """Return a folder with a scenario and an empty folder."""
    Scenario.from_dict(TINY_FLIGHT).save(tmp_path / "tiny.toml")
    (tmp_path / "left").mkdir()
    return tmp_path


def _environment():
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "envs")])}


def _run(work, commands, most=2**40):
    return subprocess.run(
        [sys.executable, "-c", RUN, str(most)], input=commands, capture_output=True, text=True,
        check=False, cwd=work, env=_environment(),
    )  # fmt: skip


def _assert_one_line_each(done, commands, problem):
    assert done.returncode == 0, done.stderr  # a segmentation fault comes at the end
    lines = done.stdout.splitlines()
    assert len(lines) == len(commands.splitlines())
    for command, line in zip(commands.splitlines(), lines, strict=True):
        assert line.startswith("1 ['error: left/"), (command, line)
        assert line.endswith(f": {problem}'] SystemExit"), (command, line)


def test_files_that_cannot_be_written_leave_one_line_and_nothing(work):
    done = _run(work, COMMANDS, 20_000)
    _assert_one_line_each(done, COMMANDS, "File too large")
    assert list((work / "left").iterdir()) == []


@contextmanager
def _disk(folder, size):
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", folder], check=True)


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0, reason="needs root to mount a small disk")
def test_a_full_disk_leaves_one_line_and_nothing(work):
    spec = work / "spec.toml"
    spec.write_text('scenario = "tiny.toml"\nflights = 2\nrecords = "all"\n')
    assert _run(work, "campaign run spec.toml --out flown --jobs 1").stdout.startswith("0 ")
    more = """evaluate Guidance-v1 --agent zero --episodes 1 --jobs 1 --out left/evaluated
campaign run spec.toml --out left/campaign --jobs 1
compare tiny.toml --policies no-divert --flights 1 --jobs 1 --out left/compared
campaign report flown --out left/report.html
campaign export flown --out left/rows.parquet
"""
    with _disk(work / "left", "4k"):
        done = _run(work, COMMANDS + more)
        left = list((work / "left").iterdir())
    _assert_one_line_each(done, COMMANDS + more, "No space left on device")
    assert left == []


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0, reason="needs root to mount a small disk")
@pytest.mark.parametrize(
    ("command", "arm", "size"),
    [
        ("campaign run spec.toml --out left/campaign", "all", "60k"),
        ("compare tiny.toml --policies no-divert --flights 2 --no-figures --out left/campaign",
         "no-divert", "100k"),
    ],
    ids=["campaign", "compare"],
)  # fmt: skip
def test_rows_without_records_are_kept_and_end_a_command_with_an_error(work, command, arm, size):
    (work / "spec.toml").write_text('scenario = "tiny.toml"\nflights = 2\nrecords = "all"\n')
    with _disk(work / "left", size):
        done = _run(work, f"{command} --jobs 1")
        flights = list((work / "left" / "campaign" / "flights" / arm).iterdir())
    assert done.stdout.startswith('1 ["error: 2 flights have rows but no record: ')
    assert "No space left on device" in done.stdout
    assert flights == []


@pytest.mark.slow
@pytest.mark.skipif(os.getuid() != 0, reason="needs root to mount a small disk")
@pytest.mark.parametrize("size", ["60k", "200k", "300k"])  # the last: during figures
def test_a_disk_that_fills_up_during_a_flights_files_is_left_empty(work, size):
    command = "fly tiny.toml --policy safest --out left/flight\n"
    with _disk(work / "left", size):
        done = _run(work, command)
        left = list((work / "left").iterdir())
    _assert_one_line_each(done, command, "No space left on device")
    assert left == []


def _shell(line, cwd):
    done = subprocess.run(
        f"{sys.executable} -m lunarsim {line}", shell=True, capture_output=True, text=True,
        check=False, cwd=cwd, env=_environment(),
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("scenario list >&-", "stdout is closed"),
        ("scenario list > /dev/full", "No space left on device"),
        ("--help > /dev/full", "No space left on device"),
    ],
)
def test_output_that_cannot_be_written_is_one_line(tmp_path, line, problem):
    code, text = _shell(line, tmp_path)
    assert code == 1
    assert text.startswith("error: output: ")
    assert problem in text
    assert text.count("\n") == 1


def test_a_reader_that_stops_and_a_closed_stderr_are_no_errors_of_their_own(tmp_path):
    assert _shell("scenario list | head -1", tmp_path)[1].count("\n") == 1
    assert _shell("--version 2>&-", tmp_path)[0] == 0
    assert _shell("parts --none 2>&-", tmp_path) == (2, "")


def test_a_deleted_working_folder_is_one_line(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    done = subprocess.run(
        ["sh", "-c", f"rmdir {gone}; {sys.executable} -m lunarsim fly golombek"],
        capture_output=True, text=True, check=False, cwd=gone, env=_environment(),
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("error: working folder: ")
    assert done.stderr.count("\n") == 1
