"""Measure the time of a first flight without compiled kernels."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# Runs the command line and prints the processor time of its process and of its child processes.
_RUN = """
import atexit, resource, sys

def print_times():
    own, beside = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print("time", own.ru_utime + own.ru_stime, beside.ru_utime + beside.ru_stime)

atexit.register(print_times)
from lunarsim.__main__ import main

main()
"""


def _run(*words: str, cores: int | None = None) -> tuple[float, float, float]:
    """Run `lunarsim` with arguments and no compiled kernels, on some cores.

    Returns processor time of the command and of its helper process, and wall-clock time, s.
    """
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(folder) / "kernels")}
        some = sorted(os.sched_getaffinity(0))[:cores]
        start_s = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-c", _RUN, *words], env=environment, check=True, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=folder,
            preexec_fn=lambda: os.sched_setaffinity(0, some),
        )  # fmt: skip
        wall = time.perf_counter() - start_s
    own, beside = map(float, done.stdout.splitlines()[-1].split()[1:])
    return own, beside, wall


def cold_start() -> None:
    """Time the first commands on a machine without compiled kernels."""
    for label, words, cores in (
        ("lunarsim --help", ("--help",), None),
        ("fly hirise", ("fly", "hirise"), None),
        ("fly hirise, one core", ("fly", "hirise"), 1),
        ("fly hirise --out", ("fly", "hirise", "--out", "out"), None),
    ):
        own, beside, wall = _run(*words, cores=cores)
        print(
            f"  {label}: {own:.2f} s of processor time, {beside:.2f} s in a helper process, "
            f"{wall:.1f} s wall-clock time"
        )
