"""Measure how fast a campaign ends after Ctrl-C on a busy machine."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench_parts.common import ROOT

# Number of interrupts, number of busy processes, maximum delay of an interrupt after the first
# flight, s.
_ROUNDS, _BUSY, _MAX_DELAY_S = 20, 3, 3.0
_SPEC = 'scenario = "{}"\nflights = 200\n[factors]\npolicy = ["no-divert", "safest"]\n'


def interrupts() -> None:
    """Time how fast a campaign ends after Ctrl-C on a busy machine."""
    rng = random.Random(1)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(_BUSY)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            took = sorted(
                _time_to_end(Path(folder), i, rng.uniform(0.0, _MAX_DELAY_S))
                for i in range(_ROUNDS)
            )
    finally:
        for process in busy:
            process.kill()
    print(
        f"  {_ROUNDS} interrupts of hirise flights with {_BUSY} busy processes "
        f"({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}): median "
        f"{took[_ROUNDS // 2]:.2f} s, maximum {took[-1]:.2f} s: "
        + ", ".join(f"{seconds:.2f}" for seconds in took)
    )


def _time_to_end(folder: Path, number: int, delay: float) -> float:
    """Return the time that a campaign takes to end after an interrupt, s.

    `number` names the campaign; the interrupt comes `delay` s after its first journal entry.
    """
    spec, out = folder / "spec.toml", folder / str(number)
    spec.write_text(_SPEC.format(ROOT / "scenarios" / "hirise.toml"), encoding="utf-8")
    words = ["campaign", "run", spec, "--out", out, "--jobs", "2", "--cache", folder / "cache"]
    running = subprocess.Popen(
        [sys.executable, "-m", "lunarsim.cli", *map(str, words)], start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    journal = out / "journal.jsonl"
    while not (journal.exists() and journal.stat().st_size):
        if running.poll() is not None:
            raise RuntimeError(
                f"the campaign must run until the interrupt, but ended with code "
                f"{running.returncode}"
            )
        time.sleep(0.05)
    time.sleep(delay)
    began = time.perf_counter()
    os.killpg(running.pid, signal.SIGINT)  # as the terminal does
    running.wait()
    return time.perf_counter() - began
