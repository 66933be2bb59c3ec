"""What is kept when drivers and workers are killed or interrupted at any time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from lunarsim.campaign.engines.inline import InlineEngine
from lunarsim.campaign.engines.local import LocalEngine, block_interrupts
from lunarsim.campaign.results import load_results, read_status
from lunarsim.campaign.run import run
from tests.campaign.processes import (
    children,
    command_of,
    fly_alone,
    journalled,
    parts,
    start,
    wait_for,
)
from tests.campaign.surrogate import plan
from tests.conftest import ROOT

pytestmark = pytest.mark.usefixtures("short_parts")


def test_a_flight_flown_again_and_then_killed_is_not_forgotten(tmp_path, whole):
    """Its row is in the journal alone, and its part has still the one that failed."""
    folder = tmp_path / "c"
    run(plan(raises=["1-0", "7-1"]), InlineEngine(), folder)
    came = []

    def die(count: int) -> None:
        came.append(count)
        if len(came) == 2:  # the rows that were there, and the first that was flown again
            raise SystemExit

    with pytest.raises(SystemExit):
        run(plan(), InlineEngine(), folder, retry=True, progress=die)
    found = load_results(folder)
    rows = {row["id"]: row["outcome"] for row in found.table.to_pylist()}
    assert (rows["1-0"], rows["7-1"], len(rows)) == ("flown", "error", 80)
    assert found.timing["id"].equals(found.table["id"])
    (line,) = [json.loads(t) for t in (folder / "journal.jsonl").read_text().splitlines()
               if json.loads(t)[0]["id"] == "1-0"]  # fmt: skip
    assert found.timing.to_pylist()[2] == line[1]
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.state, ran.before, ran.flown) == ("complete", 80, 0)
    rows = {row["id"]: row["outcome"] for row in load_results(folder).table.to_pylist()}
    assert (rows["1-0"], rows["7-1"]) == ("flown", "error")
    assert run(plan(), InlineEngine(), folder, retry=True).flown == 1
    assert parts(folder) == whole


POINTS = [
    ("before", "manifest.json", 1),
    ("after", "manifest.json", 1),
    ("before", "results/part-00001.parquet", 1),
    ("after", "results/part-00001.parquet", 1),
    ("before", "timing/part-00002.parquet", 1),
    ("after", "timing/part-00002.parquet", 1),
    ("before", "journal.jsonl", 2),
    ("after", "journal.jsonl", 2),
    ("before", "manifest.json", 3),
]


@pytest.mark.parametrize("point", POINTS, ids=lambda p: f"{p[0]} {p[1]} {p[2]}")
def test_a_kill_at_a_named_point_loses_nothing(tmp_path, whole, point):
    folder = tmp_path / "c"
    assert fly_alone(folder, die=point, folder=str(tmp_path)) == -signal.SIGKILL
    before = journalled(folder)
    ran = run(plan(), InlineEngine(), folder)
    assert (ran.state, ran.before, ran.flown) == ("complete", before, 80 - before)
    assert ran.notes == ()
    assert parts(folder) == whole
    assert not list(folder.rglob(".*.part"))
    # Nothing is flown again: no flight was in the air, and each was kept before anything else.
    told = tmp_path / "flown.txt"
    flown = told.read_text().split() if told.exists() else []
    assert len(flown) == before


def _killed_at_random(tmp_path: Path, whole: dict[str, bytes], rounds: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for number in range(rounds):
        folder = tmp_path / str(number)
        kills = 0
        while True:
            driver = start(folder, sleep=0.01, folder=str(tmp_path))
            had = journalled(folder)
            target = had + int(rng.integers(5, 60))
            wait_for(lambda: driver.poll() is not None or journalled(folder) >= target)  # noqa: B023
            workers = children(driver.pid)
            if driver.poll() is None and workers and rng.random() < 0.5:
                os.kill(int(rng.choice(workers)), signal.SIGKILL)
                time.sleep(0.05)
            if driver.poll() is None:
                driver.kill()
                kills += 1
            driver.communicate(timeout=60)
            wait_for(lambda: not any("spawn_main" in command_of(w) for w in workers))  # noqa: B023
            assert journalled(folder) >= had
            if driver.returncode == 0:
                break
        assert parts(folder) == whole, f"round {number} after {kills} kills"
        assert load_results(folder).manifest["state"] == "complete"


def test_kills_at_random_times_lose_nothing(tmp_path, whole):
    _killed_at_random(tmp_path, whole, 1, seed=1)


@pytest.mark.slow
def test_many_kills_at_random_times_lose_nothing(tmp_path, whole):
    _killed_at_random(tmp_path, whole, 20, seed=2)


def test_workers_end_with_a_driver_that_is_killed(tmp_path):
    """Also one that hangs in the midst of a flight."""
    driver = start(tmp_path / "c", flights=4, hangs=["0-0"], folder=str(tmp_path))
    workers = wait_for(lambda: children(driver.pid) if journalled(tmp_path / "c") >= 6 else [])
    driver.kill()
    driver.communicate(timeout=60)
    wait_for(lambda: not any("spawn_main" in command_of(w) for w in workers), 2.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_an_interrupt_returns_at_once_and_keeps_what_is_finished(tmp_path, whole, number):
    folder = tmp_path / "c"
    driver = start(folder, hangs=["9-1"], folder=str(tmp_path))
    # All but the flight that hangs; the other worker waits for nothing.
    wait_for(lambda: journalled(folder) >= 60)
    workers = children(driver.pid)
    began = time.monotonic()
    driver.send_signal(number)
    said, _ = driver.communicate(timeout=60)
    assert time.monotonic() - began < 2.0
    assert driver.returncode == 0 and said.startswith("interrupted")
    assert not any("spawn_main" in command_of(w) for w in workers)
    assert load_results(folder).manifest["state"] == "interrupted"
    # Everything that was flown is in Parquet now, and there is nothing that was not flown.
    flown = (tmp_path / "flown.txt").read_text().split()
    kept = pq.read_table(folder / "results")["id"].to_pylist()
    assert set(kept) <= set(flown) and len(flown) - len(kept) <= 1
    assert run(plan(), InlineEngine(), folder).before == len(kept)
    assert parts(folder) == whole


def test_nothing_is_loaded_while_an_interrupt_waits(tmp_path):
    """Pandas took 0.3 s, and seconds on a busy machine: rows are written when all is loaded."""
    code = """
import sys
from pathlib import Path
from lunarsim.campaign.outcomes import FLOWN, Finished
from lunarsim.campaign.store import Store
from tests.campaign.surrogate import plan
opened = Store.open(Path(sys.argv[1]), plan())
before = set(sys.modules)
for i in range(12):
    opened.add(Finished(i, 0, FLOWN, {"safe": True, "x": 0.5, "steps": 1, "name": "n"}))
opened.close("interrupted")
print(sorted(m for m in set(sys.modules) - before if "encodings" not in m))
"""
    command = [sys.executable, "-c", code, str(tmp_path / "c")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_processes_do_not_die_of_an_interrupt_while_they_start():
    """The keyboard sends it to all; the parent hears it once the other has been started."""
    # A shell gives what it starts in the background an interrupt that is ignored.
    code = "import signal, time; signal.signal(signal.SIGINT, signal.default_int_handler);"
    code += "print(flush=True); time.sleep(0.3); print('there')"
    before = signal.pthread_sigmask(signal.SIG_BLOCK, set())
    with block_interrupts():
        other = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, set()) == before
    other.stdout.readline()
    other.send_signal(signal.SIGINT)
    assert other.communicate(timeout=60)[0] == "there\n"
    assert other.returncode == 0


def test_an_interrupt_in_the_caller_keeps_what_is_finished(tmp_path, whole):
    came = []

    def progress(count: int) -> None:
        came.append(count)
        if len(came) == 8:
            raise KeyboardInterrupt

    ran = run(plan(), LocalEngine(2), tmp_path / "c", progress=progress)
    assert (ran.state, ran.flown) == ("interrupted", 8)
    run(plan(), InlineEngine(), tmp_path / "c")
    assert parts(tmp_path / "c") == whole


def test_status_while_it_flies_and_after_a_kill(tmp_path):
    folder = tmp_path / "c"
    driver = start(folder, flights=400, sleep=0.02)
    wait_for(lambda: journalled(folder) >= 10)
    found = read_status(folder)
    assert found.state == "flying" and found.expected_rows == 800
    assert 5.0 < found.rate < 100.0 and found.seconds_left > 5.0
    driver.kill()
    driver.communicate(timeout=60)
    assert read_status(folder).state == "killed"
