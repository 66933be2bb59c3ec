"""Report the progress of kernel compilation, which happens once per machine."""

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

# Time between two progress lines, s.
_REPORT_INTERVAL_S = 5.0


class _CompilerProcess:
    """Second process that compiles kernels which the flight needs later.

    Its `command` is a module for ``python -m`` and arguments. The option ``--parent`` with the ID
    of this process is appended, so that the second process ends together with this one.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the process, with its output discarded, if there is a second processor."""
        if self._command and len(os.sched_getaffinity(0)) > 1:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *self._command, "--parent", str(os.getpid())],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip

    def stop(self) -> None:
        """End the process; kernels that it has finished stay in the cache."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()


@contextmanager
def report_compilation(helper_command: Sequence[str] = ()) -> Iterator[None]:
    """Print the progress of kernel compilation on stderr while a `with` block runs.

    The text is the number of compiled kernels; nothing is printed if none is compiled.

    Parameters
    ----------
    helper_command
        Name and arguments of a module, run in a second process, that compiles some of the kernels
        at the same time; empty: no second process.
    """
    from numba.core import event  # noqa: PLC0415  (Numba loads slowly)

    helper = _CompilerProcess(helper_command)

    class CompileListener(event.Listener):  # type: ignore[misc]
        """Count compilations; a nested compilation's time is part of the outer one's."""

        def __init__(self) -> None:
            self.count = self.depth = 0
            self.seconds = self.begun = self.last = 0.0

        def on_start(self, event: Any) -> None:
            """Note the start of a compilation; at the first one, print and start the helper.

            The helper is the second process, and the printed text is a message to the user.
            """
            self.depth += 1
            if self.depth > 1:
                return
            self.begun = time.perf_counter()
            if not self.count:
                self.last = self.begun
                click.echo("compiling kernels (needed once per machine) ...", err=True)
                helper.start()

        def on_end(self, event: Any) -> None:
            """Count a finished compilation; print the progress if enough time has passed."""
            self.depth -= 1
            self.count += 1
            if self.depth:
                return
            now = time.perf_counter()
            self.seconds += now - self.begun
            if now > self.last + _REPORT_INTERVAL_S:
                self.last = now
                click.echo(f"  {self.count} kernels in {self.seconds:.0f} s", err=True)

    compilations = CompileListener()
    # The compiler creates millions of permanent objects: garbage collection would cost 6 % of time.
    before = gc.get_threshold()
    gc.set_threshold(100_000, 50, 1_000)
    try:
        with event.install_listener("numba:compile", compilations):
            yield
    finally:
        gc.set_threshold(*before)
        helper.stop()
    if compilations.count:
        click.echo(
            f"compiled {compilations.count} kernels in {compilations.seconds:.0f} s; "
            "the cache keeps them",
            err=True,
        )
