"""What a first flight waits for: kernels are compiled once on a machine, and that is told."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

# Between two lines, s.
_INTERVAL = 5.0


class _Helper:
    """Another process that compiles what is needed late while this one compiles what is first.

    Parameters
    ----------
    command
        A module, to be run as ``python -m``, and its arguments; ``--parent`` and the number of this
        process are added, so that it can end with it.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, if there is a processor for it; what it prints is nobody's concern."""
        if self._command and len(os.sched_getaffinity(0)) > 1:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *self._command, "--parent", str(os.getpid())],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip

    def stop(self) -> None:
        """End it: what it has finished is kept."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


@contextmanager
def compilation_told(beside: Sequence[str] = ()) -> Iterator[None]:
    """Tell on stderr how many kernels have been compiled, while there are any to compile.

    Parameters
    ----------
    beside
        A module, and its arguments, that compiles some of them in another process meanwhile.
    """
    from numba.core import event

    helper = _Helper(beside)

    class Told(event.Listener):  # type: ignore[misc]
        """Counts compilations; those within another count once."""

        def __init__(self) -> None:
            self.count = self.depth = 0
            self.seconds = self.begun = self.last = 0.0

        def on_start(self, event: Any) -> None:
            """Tell that there is something to wait for."""
            self.depth += 1
            if self.depth > 1:
                return
            self.begun = time.perf_counter()
            if not self.count:
                self.last = self.begun
                click.echo("compiling kernels, once on this machine; counted here", err=True)
                helper.start()

        def on_end(self, event: Any) -> None:
            """Tell how far it is."""
            self.depth -= 1
            self.count += 1
            if self.depth:
                return
            now = time.perf_counter()
            self.seconds += now - self.begun
            if now > self.last + _INTERVAL:
                self.last = now
                click.echo(f"  {self.count} kernels in {self.seconds:.0f} s", err=True)

    told = Told()
    # The compiler makes millions of objects that stay: looking for rubbish takes a sixteenth of it.
    before = gc.get_threshold()
    gc.set_threshold(100_000, 50, 1_000)
    try:
        with event.install_listener("numba:compile", told):
            yield
    finally:
        gc.set_threshold(*before)
        helper.stop()
    if told.count:
        click.echo(
            f"compiled {told.count} kernels in {told.seconds:.0f} s; they are kept for next time",
            err=True,
        )
