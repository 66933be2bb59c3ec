"""How long a campaign takes to end after Ctrl-C, on a machine that has other things to do."""

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

# Interrupts, processes that keep cores busy meanwhile, and the latest that an interrupt comes after
# the first flight, s.
_ROUNDS, _BUSY, _LATEST = 20, 3, 3.0
_SPEC = 'scenario = "{}"\nflights = 200\n[factors]\npolicy = ["no-divert", "safest"]\n'


def interrupts() -> None:
    """Time from Ctrl-C to the end of `lunarsim campaign run`, two jobs, beside busy processes."""
    rng = random.Random(1)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(_BUSY)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            took = sorted(_took(Path(folder), i, rng.uniform(0.0, _LATEST)) for i in range(_ROUNDS))
    finally:
        for process in busy:
            process.kill()
    print(
        f"  {_ROUNDS} interrupts of flights of hirise beside {_BUSY} busy processes "
        f"({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}): median "
        f"{took[_ROUNDS // 2]:.2f} s, longest {took[-1]:.2f} s: "
        + ", ".join(f"{seconds:.2f}" for seconds in took)
    )


def _took(folder: Path, number: int, later: float) -> float:
    """Return how long a campaign took to end that is interrupted in the midst of its flights, s."""
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
            raise RuntimeError(f"the campaign ended by itself with code {running.returncode}")
        time.sleep(0.05)
    time.sleep(later)
    began = time.perf_counter()
    os.killpg(running.pid, signal.SIGINT)  # as the keyboard does
    running.wait()
    return time.perf_counter() - began
