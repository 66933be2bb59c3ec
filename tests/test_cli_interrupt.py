"""Ctrl-C: code 130, one line, nothing half written, whoever would swallow it."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from lunarsim import cli_common
from lunarsim.atomic_files import atomic_write, atomic_write_text, remove_contents_on_error
from lunarsim.cli import main
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from tests.worlds import SCENARIOS, TAKE_A_SCENARIO

GOOD = str(SCENARIOS / "golombek.toml")
HEAD = "import os, signal, time; from lunarsim.cli_start import run\n"
PRESS = "os.kill(os.getpid(), signal.SIGINT)"

SWALLOWED = f"""
class Freed:
    def __del__(self):
        {PRESS}; time.sleep(0)

def command():
    Freed()  # Python tells of what is raised there, and goes on
    time.sleep(20)
"""
TURNED = f"""
def command():
    try:
        {PRESS}; time.sleep(9)
    except KeyboardInterrupt:
        raise RuntimeError("no compiled object yet") from None
"""
TURNED_INTO_AN_END = TURNED.replace('RuntimeError("no compiled object yet")', "SystemExit(1)")
CLEANED = f"""
def command():
    try:
        {PRESS}; time.sleep(9)
    finally:
        for n in range(8):
            time.sleep(0.1)
            try:
                raise ValueError
            except ValueError:
                pass
        print("cleaned")
"""
LOST_AT_THE_END = f"""
class Freed:
    def __del__(self):
        {PRESS}; time.sleep(0)

def command():
    Freed()
    raise SystemExit(0)
"""
EVALUATED = f"""
def command():
    exec("{PRESS}; time.sleep(9)")
"""
ANSWERED = f"""
import sys
from lunarsim.cli_start import acknowledge_interrupt

def command():
    try:
        exec("{PRESS}; time.sleep(9)")
    except KeyboardInterrupt:  # as a group of commands does
        acknowledge_interrupt()
        sys.exit(130)
"""
FOLDERS_GO = f"""
def command():
    import tempfile
    global held
    held = tempfile.TemporaryDirectory()
    print(held.name)
    {PRESS}; time.sleep(9)
"""
TOLD = f"""
def command():
    try:
        {PRESS}; time.sleep(9)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("a.txt is there") from None
"""


def _hears():
    """Begin a process that hears Ctrl-C, also where this one was begun not to."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def state(folder):
    return {p: p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def _ended(command, before=""):
    """Run a command as `python -m` does: that one asks at its end whether it was interrupted."""
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as here:
        (Path(here) / "shown.py").write_text(HEAD + before + command + "\nrun(command)\n")
        done = subprocess.run(
            [sys.executable, "-m", "shown"], check=False, capture_output=True, text=True, cwd=here,
            preexec_fn=_hears,
        )  # fmt: skip
    return done, time.perf_counter() - begun


@pytest.mark.parametrize(
    ("command", "out", "err"),
    [
        (SWALLOWED, "", "interrupted\n"),
        (TURNED, "", "interrupted\n"),
        (TURNED_INTO_AN_END, "", ""),
        (LOST_AT_THE_END, "", "interrupted: the command had already finished\n"),
        (EVALUATED, "", "interrupted\n"),
        (ANSWERED, "", ""),
        (CLEANED, "cleaned\n", "interrupted\n"),
        (TOLD, "", "interrupted: a.txt is there\n"),
    ],
    ids=[
        "swallowed",
        "turned into an error",
        "turned into an end",
        "at the end",
        "evaluated",
        "answered in exec",
        "cleaned",
        "told",
    ],
)
def test_an_interrupt_is_heard(command, out, err):
    done, seconds = _ended(command)
    assert (done.returncode, done.stdout, done.stderr) == (130, out, err)
    assert seconds < 8.0


def test_errors_without_an_interrupt_are_what_they_were():
    done, _ = _ended("\ndef command():\n    raise RuntimeError('mine')\n")
    assert done.returncode == 1
    assert done.stderr.endswith("RuntimeError: mine\n")
    done, _ = _ended("\ndef command():\n    raise SystemExit(2)\n")
    assert (done.returncode, done.stderr) == (2, "")
    lost = "\nclass Freed:\n    def __del__(self):\n        1 / 0\n\ndef command():\n    Freed()\n"
    done, _ = _ended(lost)
    assert done.returncode == 0
    assert "ZeroDivisionError" in done.stderr


@pytest.mark.parametrize("command", [SWALLOWED, CLEANED, FOLDERS_GO])
def test_a_polite_kill_is_heard_as_an_interrupt_is(command):
    """Before a campaign opens its folder, too."""
    done, seconds = _ended(command.replace("SIGINT", "SIGTERM"))
    assert (done.returncode, done.stderr) == (130, "interrupted\n") and seconds < 8.0
    if command is FOLDERS_GO:
        assert not Path(done.stdout.strip()).exists()


def test_temporary_folders_go():
    done, _ = _ended(FOLDERS_GO)
    assert done.returncode == 130
    assert not Path(done.stdout.strip()).exists()


def test_a_command_that_is_done_is_not_killed():
    source = f"{HEAD}run(lambda: print('done'))\n{PRESS}\n"
    command = [sys.executable, "-c", source]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, preexec_fn=_hears
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


def test_who_asked_not_to_be_interrupted_is_not():
    """As a command that a shell runs in the background."""
    ignoring = "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    done, _ = _ended(f"\ndef command():\n    {PRESS}\n    print('went on')\n", ignoring)
    assert (done.returncode, done.stdout) == (0, "went on\n")


def test_the_command_that_is_installed_is_this_one():
    command = [sys.executable, "-m", "lunarsim", "scenario", "reference"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, preexec_fn=_hears, **pipes) as process:  # noqa: PLW1509
        time.sleep(0.6)  # within its imports, or after them
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=20)[1]
    assert (process.returncode, said) in {(130, b"interrupted\n"), (0, b"")}
    entry = (Path(__file__).parents[1] / "pyproject.toml").read_text()
    assert 'lunarsim = "lunarsim.__main__:main"' in entry


@pytest.mark.parametrize("name", TAKE_A_SCENARIO)
def test_every_command_ends_with_130(name, tmp_path, monkeypatch):
    def pressed(*_):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Scenario, "load", pressed)
    done = CliRunner().invoke(main, [*name.split(), GOOD, *TAKE_A_SCENARIO[name]])
    assert (done.exit_code, done.output) == (130, "interrupted\n")
    assert not state(tmp_path)


@pytest.fixture
def small(small_scenario, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small_scenario.save(tmp_path / "small.toml")
    return tmp_path


def _fly(*options):
    return CliRunner().invoke(main, ["fly", "small.toml", "--out", "above/out", *options])


def test_an_interrupt_in_flight_leaves_nothing(small, monkeypatch):
    def pressed(self, *settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(Simulation, "run", pressed)
    done = _fly()
    assert done.exit_code == 130
    assert done.stderr.splitlines()[-1] == "interrupted"
    assert set(state(small)) == {small / "small.toml"}


def test_a_record_is_there_whole_or_not_at_all(small, monkeypatch):
    def pressed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Scenario, "save", pressed)  # the record is written, the scenario not
        done = _fly()
    assert done.exit_code == 130
    assert set(state(small)) == {small / "small.toml"}
    with monkeypatch.context() as patch:
        patch.setattr("lunarsim.simulation.Flight.__str__", pressed)
        done = _fly()
    assert done.stderr.splitlines()[-1].endswith(
        "has the scenario and the record, but not all figures"
    )
    shutil.rmtree(small / "above")
    monkeypatch.setattr("lunarsim.viz.draw_flight", pressed)
    done = _fly()
    assert done.exit_code == 130
    told = "interrupted: above/out has the scenario and the record, but not all figures"
    assert done.stderr.splitlines()[-1] == told
    assert Flight.load(small / "above" / "out").outcome is not None
    assert Scenario.load(small / "above" / "out" / "scenario.toml").name


def test_a_file_is_there_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.txt"
    atomic_write_text(path, "old")

    def half(part):
        part.write_text("ne")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        atomic_write(path, half)
    assert state(tmp_path) == {path: b"old"}
    atomic_write_text(path, "new")
    assert state(tmp_path) == {path: b"new"}


def test_two_writers_of_one_file_do_not_mix(tmp_path):
    path = tmp_path / "a.txt"

    def slow(part):
        part.write_text("first, ")
        atomic_write_text(path, "second")
        with part.open("a") as file:
            file.write("first")

    atomic_write(path, slow)
    assert state(tmp_path) == {path: b"first, first"}


def test_a_folder_that_was_there_stays_and_what_is_made_goes(tmp_path):
    kept = tmp_path / "kept"
    kept.mkdir()
    for folder in (kept, tmp_path / "a" / "b"):
        with pytest.raises(OSError, match="full"), remove_contents_on_error(folder):
            (folder / "maps").mkdir(parents=True)
            (folder / "maps" / "one.nc").write_bytes(b"1")
            (folder / "two.txt").write_bytes(b"2")
            raise OSError("full")
    assert set(state(tmp_path)) == {kept}
    (kept / "mine.txt").write_bytes(b"mine")
    with pytest.raises(OSError, match="full"), remove_contents_on_error(kept):
        (kept / "two.txt").write_bytes(b"2")
        raise OSError("full")
    assert [path.name for path in kept.iterdir()] == ["mine.txt"]
    with remove_contents_on_error(tmp_path / "c"):
        (tmp_path / "c").mkdir()
    assert (tmp_path / "c").is_dir()


def test_a_nested_group_reports_it_once():
    @click.group(cls=cli_common.ErrorReportingGroup)
    def outer(): ...

    @outer.group(cls=cli_common.ErrorReportingGroup)
    def inner(): ...

    @inner.command()
    def leaf():
        raise KeyboardInterrupt

    done = CliRunner().invoke(outer, ["inner", "leaf"])
    assert (done.exit_code, done.output) == (130, "interrupted\n")
