"""A failure of external software ends the flight with a named outcome and leaves nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import lunarsim
from lunarsim import InputError
from lunarsim.interface import allow_programs
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.interface.software import EXAMPLES, FAULTY, build_folder, compiler, library, small


@pytest.fixture(autouse=True)
def allowed(monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_PROGRAMS", "")


def children() -> set[int]:
    """Return the processes whose parent is this one, and folders of connections."""
    out = subprocess.run(
        ["ps", "--ppid", str(os.getpid()), "-o", "pid=,comm="], check=True, capture_output=True,
        text=True,
    ).stdout  # fmt: skip
    return {int(line.split()[0]) for line in out.splitlines() if "ps" not in line.split()[1:]}


def left_over(process: int | None = None) -> set[str]:
    """Return the folders of connections of a process, by default this one."""
    names = f"lunarsim-{os.getpid() if process is None else process}-*"
    return {path.name for path in Path("/dev/shm").glob(names)}


def program(fault: str, **settings: object) -> Scenario:
    allow_programs(FAULTY)
    return small(
        guidance={"kind": "process", "path": str(FAULTY), "arguments": [fault], **settings}
    )


def with_library(fault: str, **settings: object) -> Scenario:
    path = library("faulty_software.c")
    allow_programs(path)
    return small(
        guidance={"kind": "library", "path": str(path), "configuration": fault, **settings}
    )


def fly_to_failure(scenario: Scenario, time: float = 4.0) -> dict[str, object]:
    """Fly a scenario that must fail; return the event of the failure."""
    before, folders = children(), left_over()
    flight = Simulation(scenario, 1, "no-divert").run()
    assert flight.outcome.failure_causes == ("software-failed",)
    assert not flight.outcome.safe
    (event,) = [e for e in flight.events if e["name"] == "software-failed"]
    assert event["role"] == "guidance"
    # The first 20 calls were good.
    assert event["time"] == pytest.approx(time, abs=1e-9)
    assert f"{event['role']}: {event['reason']}: {event['detail']}" in str(flight)
    assert children() <= before
    assert left_over() <= folders
    return event


@pytest.mark.parametrize(
    ("fault", "reason", "detail"),
    [
        ("die", "died", "exit code 3"),
        ("kill", "died", "SIGKILL"),
        ("close", "protocol", "closed the connection"),
        ("nan", "invalid-output", "nan"),
        ("size", "protocol", "must have 3 elements, but has 4"),
        ("empty", "protocol", "no guidance_output"),
        ("other-role", "protocol", "no guidance_output"),
        ("error", "error", "no solution"),
        ("garbage", "protocol", "not readable"),
        ("long", "protocol", "too long"),
    ],
)
def test_failure_of_a_program_ends_the_flight_with_its_reason(fault, reason, detail):
    event = fly_to_failure(program(fault))
    assert event["reason"] == reason
    assert detail in event["detail"]


def test_second_answer_to_a_call_is_not_the_answer_to_the_next_one():
    event = fly_to_failure(program("twice"), time=4.2)
    assert event["reason"] == "protocol"
    assert "before its request" in event["detail"]


@pytest.mark.parametrize("fault", ["hang", "late", "half"])
def test_program_that_answers_too_late_ends_the_flight(fault):
    start = time.monotonic()
    event = fly_to_failure(program(fault, deadline_s=0.5))
    assert event["reason"] == "timeout"
    assert time.monotonic() - start < 20.0


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        ("version", "must have interface version 1, not 2"),
        ("token", "LUNARSIM_TOKEN"),
        ("init", "exit code 4"),
        ("no-connection", "did not connect in time"),
    ],
)
def test_program_that_does_not_start_is_an_input_error(fault, problem):
    before, folders = children(), left_over()
    with pytest.raises(InputError, match=problem) as caught:
        Simulation(program(fault, start_time_s=3.0 if fault != "no-connection" else 0.5), 1)
    assert caught.value.field == "guidance.path"
    assert children() <= before
    assert left_over() <= folders


@pytest.mark.parametrize(
    ("fault", "reason", "detail"),
    [
        ("crash", "died", "SIGSEGV"),
        ("abort", "died", "SIGABRT"),
        ("exit", "died", "exit code 3"),
        ("error", "error", "lunarsim_guidance_step returned 5"),
        ("nan", "invalid-output", "nan"),
        ("silent", "invalid-output", "nan"),
    ],
)
def test_failure_of_an_isolated_library_ends_the_flight_with_its_reason(fault, reason, detail):
    event = fly_to_failure(with_library(fault))
    assert event["reason"] == reason
    assert detail in event["detail"]


def test_library_that_hangs_ends_the_flight():
    assert fly_to_failure(with_library("hang", deadline_s=0.5))["reason"] == "timeout"


def test_library_in_this_process_reports_errors_as_well():
    event = fly_to_failure(with_library("error", isolated=False))
    assert event["reason"] == "error"
    for fault in ("nan", "silent"):
        assert fly_to_failure(with_library(fault, isolated=False))["reason"] == "invalid-output"


def test_failure_at_the_first_call_ends_the_flight_at_its_start(tmp_path):
    flight = Simulation(with_library("crash at once"), 1, "no-divert").run()
    assert flight.outcome.failure_causes == ("software-failed",)
    assert flight.duration == 0.0
    again = lunarsim.Flight.load(flight.save(tmp_path / "flight"))
    assert again.outcome.failure_causes == flight.outcome.failure_causes


@pytest.mark.parametrize("isolated", [True, False])
def test_library_is_started_and_closed_once_per_flight(isolated, tmp_path):
    notes = tmp_path / "notes"
    scenario = with_library(f"close {notes}", isolated=isolated)
    Simulation(scenario.changed(simulation={"max_time_s": 1.0}), 1, "no-divert").run()
    assert notes.read_text() == "closed\n"
    simulation = Simulation(scenario, 1, "no-divert")
    simulation.step()
    simulation.close()
    simulation.close()
    assert notes.read_text() == "closed\n" * 2


def test_program_lives_on_after_the_thread_that_began_the_flight():
    made = []
    thread = threading.Thread(target=lambda: made.append(Simulation(program(""), 1, "no-divert")))
    thread.start()
    thread.join()
    time.sleep(0.2)
    for _ in range(5):
        made[0].step()
    assert not made[0].done
    made[0].close()


def test_failure_after_touchdown_keeps_the_landing():
    path = library("late_failure.c")
    allow_programs(path)
    scenario = Scenario.load(EXAMPLES / "golombek_fixes.toml").changed(
        computer={"kind": "library", "path": str(path), "isolated": False},
        start={"position_m": [-60.0, 0.0, 92.0], "velocity_m_s": [6.0, 0.0, -5.0]},
    )
    flight = Simulation(scenario, 1, "safest").run()
    assert flight.outcome.touchdown is not None
    assert [e["name"] for e in flight.events if e["name"] == "software-failed"]
    assert "software-failed" not in flight.outcome.failure_causes


@pytest.mark.parametrize("isolated", [True, False])
def test_unsuitable_library_is_an_input_error(isolated, tmp_path):
    def error(path: Path, **settings: object) -> str:
        allow_programs(path)
        given = {"kind": "library", "path": str(path), "isolated": isolated, **settings}
        with pytest.raises(InputError) as caught:
            Simulation(small(guidance=given), 1)
        assert caught.value.field.startswith("guidance.")
        return str(caught.value)

    text = tmp_path / "text.so"
    text.write_text("not a library")
    assert "must be a shared library" in error(text)
    assert "returned 7" in error(library("faulty_software.c"), configuration="init")
    assert "lunarsim_guidance_init" in error(library("nearest_safe.cpp"))
    old = build_folder() / "old.so"
    source = Path(__file__).with_name("faulty_software.c")
    header = Path(lunarsim.__file__).parent / "interface"
    subprocess.run(
        [compiler("gcc"), "-shared", "-fPIC", "-DVERSION=99", f"-I{header}", source, "-o", old],
        check=True,
    )
    assert "must have interface version 1, but has version 99" in error(old)


def test_nothing_is_left_if_lunarsim_is_killed(tmp_path):
    """A program that hangs ends when lunarsim is killed."""
    script = tmp_path / "fly.py"
    script.write_text(
        "import lunarsim\n"
        "from tests.interface.test_failures import children, program\n"
        "from lunarsim.simulation import Simulation\n"
        "simulation = Simulation(program('hang', deadline_s=600), 1)\n"
        "print(*children(), flush=True)\n"
        "simulation.run()\n"
    )
    root = Path(lunarsim.__file__).parent.parent
    child = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, cwd=root,
        env=os.environ | {"PYTHONPATH": f"{root}:{root / 'envs'}"},
    )  # fmt: skip
    pid = int(child.stdout.readline())
    child.kill()
    child.wait()
    deadline = time.monotonic() + 5.0
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not Path(f"/proc/{pid}").exists()
    assert left_over(child.pid) == set()
