"""Shared options and tables of the navigation studies."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import click
from rich.table import Table

F = TypeVar("F", bound=Callable[..., Any])


class FaultStudyFlight(Protocol):
    """Interface of the flight results that the table of undeclared failures needs.

    A navigation failure is undeclared if navigation does not declare itself lost.
    """

    @property
    def far(self) -> bool:
        """Whether a navigation error exceeded five standard deviations at the end."""
        ...

    @property
    def lost(self) -> bool:
        """Whether navigation declared itself lost at the end."""
        ...

    @property
    def inflated(self) -> int:
        """Number of `covariance-inflated` events (suspect measurements)."""
        ...

    @property
    def safe(self) -> bool:
        """Whether the landing was safe."""
        ...


def seed_and_jobs(function: F) -> F:
    """Decorate a command with the options `--seed` and `--jobs`."""
    jobs = click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
                        help="Number of parallel processes; it does not change the "
                        "results.")  # fmt: skip
    seed = click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True,
                        help="Seed from which all random numbers derive.")  # fmt: skip
    return seed(jobs(function))


def json_option(function: F) -> F:
    """Decorate a command with the option `--json`, the output file of all flights."""
    return click.option("--json", "out", type=click.Path(path_type=Path, dir_okay=False),
                        help="JSON file for the results of all flights. Default: "
                        "none.")(function)  # fmt: skip


def write_flights(out: Path | None, rows: Iterable[tuple[str, Sequence[FaultStudyFlight]]]) -> None:
    """Write the flight results of a study as JSON for `undeclared_failures.py`.

    `rows` holds the flights of each fault with its name. Nothing is written if `out` is None.
    """
    if out is None:
        return
    keys = ("far", "lost", "inflated", "safe")
    flights = [
        {"row": name, **{key: int(getattr(f, key)) for key in keys}}
        for name, mine in rows for f in mine
    ]  # fmt: skip
    out.write_text(json.dumps(flights, indent=1) + "\n")


def declared_table(
    title: str, first_header: str, rows: Iterable[tuple[str, Sequence[FaultStudyFlight]]]
) -> Table:
    """Return the table of flights with large navigation errors, by fault.

    It counts the flights over 5 sigma, and those of them that navigation did not declare lost.
    `first_header` is the header of the first column; `rows` holds the name and the flights of each
    fault or condition.
    """
    table = Table(title=title)
    for heading in (first_header, "flights", "over 5 sigma\nat the end",
                    "of these, not\ndeclared lost", "declared lost\nat the end",
                    "with suspect\nmeasurements", "safe landings"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == first_header else "right")
    for name, mine in rows:
        table.add_row(
            name, str(len(mine)), str(sum(f.far for f in mine)),
            str(sum(f.far and not f.lost for f in mine)), str(sum(f.lost for f in mine)),
            str(sum(f.inflated > 0 for f in mine)), str(sum(f.safe for f in mine)),
        )  # fmt: skip
    return table
