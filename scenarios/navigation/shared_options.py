"""Shared options and tables of the navigation studies."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import click
from rich.table import Table

F = TypeVar("F", bound=Callable[..., Any])


class DeclaredFlight(Protocol):
    """A flight with a fault."""

    @property
    def far(self) -> bool:
        """Whether an error was too large at the end."""
        ...

    @property
    def lost(self) -> bool:
        """Whether navigation declared itself lost at the end."""
        ...

    @property
    def doubted(self) -> int:
        """Number of `doubted` events."""
        ...

    @property
    def safe(self) -> bool:
        """Whether the landing was safe."""
        ...


def seed_and_jobs(function: F) -> F:
    """Add the options `--seed` and `--jobs`."""
    jobs = click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
                        help="Number of processes; does not change the results.")  # fmt: skip
    seed = click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True,
                        help="Root random seed.")  # fmt: skip
    return seed(jobs(function))


def json_option(function: F) -> F:
    """Add the option `--json`."""
    return click.option("--json", "out", type=click.Path(path_type=Path, dir_okay=False),
                        help="Output file of all flights.")(function)  # fmt: skip


def write_flights(out: Path | None, rows: Iterable[tuple[str, Sequence[DeclaredFlight]]]) -> None:
    """Write the flights of a study, each with its row, for `undeclared.py`."""
    if out is None:
        return
    keys = ("far", "lost", "doubted", "safe")
    flights = [
        {"row": name, **{key: int(getattr(f, key)) for key in keys}}
        for name, mine in rows for f in mine
    ]  # fmt: skip
    out.write_text(json.dumps(flights, indent=1) + "\n")


def declared_table(
    title: str, first: str, rows: Iterable[tuple[str, Sequence[DeclaredFlight]]]
) -> Table:
    """Return a table of flights with large errors and of undeclared ones among them.

    Parameters
    ----------
    title, first
        Title of the table and header of its first column.
    rows
        Name and flights of each row.
    """
    table = Table(title=title)
    for heading in (first, "flights", "over 5 sigma\nat the end", "of these, not\ndeclared lost",
                    "declared lost\nat the end", "with suspect\nmeasurements",
                    "safe landings"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == first else "right")
    for name, mine in rows:
        table.add_row(
            name, str(len(mine)), str(sum(f.far for f in mine)),
            str(sum(f.far and not f.lost for f in mine)), str(sum(f.lost for f in mine)),
            str(sum(f.doubted > 0 for f in mine)), str(sum(f.safe for f in mine)),
        )  # fmt: skip
    return table
