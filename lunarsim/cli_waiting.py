"""What a first flight waits for: kernels are compiled once on a machine, and that is told."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

# Between two lines, s.
_INTERVAL = 5.0


@contextmanager
def compilation_told() -> Iterator[None]:
    """Tell on stderr how many kernels have been compiled, while there are any to compile."""
    from numba.core import event

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
                click.echo("compiling kernels, once on this machine: a minute or two", err=True)

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
    with event.install_listener("numba:compile", told):
        yield
    if told.count:
        click.echo(
            f"compiled {told.count} kernels in {told.seconds:.0f} s; they are kept for next time",
            err=True,
        )
