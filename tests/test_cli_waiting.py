"""What is told of compilation, and the process that compiles beside."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import ClassVar

import numba
import pytest

from lunarsim.compile_progress import report_compilation


class Beside:
    started: ClassVar[list] = []
    ended = 0

    def __init__(self, command, **streams):
        Beside.started.append(command)
        assert set(streams.values()) == {subprocess.DEVNULL}

    def terminate(self):
        Beside.ended += 1

    def wait(self):
        assert Beside.ended == len(Beside.started)


@pytest.fixture
def processes(monkeypatch):
    monkeypatch.setattr(subprocess, "Popen", Beside)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(Beside, "started", [])
    monkeypatch.setattr(Beside, "ended", 0)
    return Beside


def _compile_two():
    for number in (1, 2):
        assert numba.njit(lambda x, n=number: x + n)(1) == 1 + number


def test_what_is_compiled_is_reported_and_another_process_helps(processes, capsys):
    before = gc.get_threshold()
    with report_compilation(["a.module", "--word"]):
        assert gc.get_threshold() != before
        _compile_two()
        assert processes.ended == 0
    told = ["a.module", "--word", "--parent", str(os.getpid())]
    assert processes.started == [[sys.executable, "-m", *told]]
    assert processes.ended == 1
    assert gc.get_threshold() == before
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("compiling kernels (needed once per machine)")
    assert said[-1].startswith("compiled 2 kernels in ")


def test_progress_is_reported_between_the_first_line_and_the_last(processes, capsys, monkeypatch):
    """By a clock that goes on by 4 s whenever it is read, and a line every 5 s at most."""
    clock = iter(range(0, 1000, 4))
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(clock)))
    kernels = [numba.njit(lambda x, n=number: x + n) for number in range(3)]
    with report_compilation():
        for kernel in kernels:
            kernel(1)
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "compiling kernels (needed once per machine) ..."
    # A compilation begins, ends (4 s on), the next begins (8 s), ends (12 s on), ...
    assert said[1:] == [
        "  2 kernels in 8 s",
        "  3 kernels in 12 s",
        "compiled 3 kernels in 12 s; the cache keeps them",
    ]


def test_kernels_within_kernels_count_and_their_time_counts_once(processes, capsys, monkeypatch):
    clock = iter(range(0, 1000, 1))
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(clock)))
    inner = numba.njit(lambda x: x + 1)
    outer = numba.njit(lambda x: inner(x) + 1)
    with report_compilation():
        outer(1)
    assert capsys.readouterr().err.splitlines()[-1].startswith("compiled 2 kernels in 1 s;")


def test_nothing_is_reported_where_nothing_is_compiled(processes, capsys):
    with report_compilation(["a.module"]):
        pass
    assert not processes.started
    assert not capsys.readouterr().err


def test_one_processor_gets_no_help(processes, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    with report_compilation(["a.module"]):
        _compile_two()
    assert not processes.started


def test_the_helper_is_ended_with_a_flight_that_fails(processes):
    before = gc.get_threshold()
    with pytest.raises(ValueError, match="flight"), report_compilation(["a.module"]):
        _compile_two()
        raise ValueError("flight")
    assert processes.ended == 1
    assert gc.get_threshold() == before


def runs(pid: int) -> bool:
    """Tell whether a process is there, and not only its exit status."""
    try:
        return "zombie" not in Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return False


def test_the_process_that_helps_ends_with_the_one_that_began_it():
    helper = (
        "import sys; from lunarsim.safety.compile_kernels import exit_with_parent\n"
        "print(flush=True)\n"
        "end_with(int(sys.argv[1]))\n"
    )
    parent = (
        "import os, subprocess, sys\n"
        f"command = [sys.executable, '-c', {helper!r}, str(os.getpid())]\n"
        "helper = subprocess.Popen(command, stdout=subprocess.PIPE)\n"
        "helper.stdout.readline()\n"
        "print(helper.pid, flush=True)\n"
        "helper.wait()\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE) as process:
        pid = int(process.stdout.readline())
        process.kill()
    ends = time.monotonic() + 10.0
    while runs(pid) and time.monotonic() < ends:
        time.sleep(0.1)
    assert not runs(pid)
