"""Sum the undeclared failures and false declarations of the navigation studies.

The input folders are those that `faults.py`, `rock_navigation.py` and `prior_map.py` write with
`--out`. Flights whose fault name begins with "none" have no fault.

python scenarios/navigation/undeclared_failures.py faults rocks prior_map
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from lunarsim.console import plain_console
from lunarsim.studies import Proportion

Row = dict[str, Any]


def declared_table(
    title: str, first_header: str, groups: Iterable[tuple[str, Sequence[Row]]]
) -> Table:
    """Return the table of flights with large navigation errors, by fault.

    It counts the flights over 5 sigma, and those of them that navigation did not declare lost.
    `first_header` is the header of the first column; `groups` holds the name and the rows of each
    fault or condition.
    """
    table = Table(title=title)
    for heading in (first_header, "flights", "over 5 sigma\nat the end",
                    "of these, not\ndeclared lost", "declared lost\nat the end",
                    "with suspect\nmeasurements", "safe landings"):  # fmt: skip
        table.add_column(heading, justify="left" if heading == first_header else "right")
    for name, mine in groups:
        table.add_row(
            name, str(len(mine)), str(sum(f["far"] for f in mine)),
            str(sum(f["far"] and not f["lost"] for f in mine)), str(sum(f["lost"] for f in mine)),
            str(sum(f["inflated"] > 0 for f in mine)), str(sum(f["safe"] for f in mine)),
        )  # fmt: skip
    return table


def count_text(count: int, total: int) -> str:
    """Format "count of total" with the 95 % interval of the fraction.

    The result is "-" if `total` is zero.
    """
    if total == 0:
        return "-"
    low, high = Proportion(count, total).interval
    return f"{count} of {total} [{low:.3f}, {high:.3f}]"


@click.command()
@click.argument(
    "folders", type=click.Path(exists=True, file_okay=False, path_type=Path), nargs=-1,
    required=True,
)  # fmt: skip
def main(folders: tuple[Path, ...]) -> None:
    """Count undeclared failures and false declarations in result FOLDERS of studies."""
    flights: dict[str, list[Row]] = {}
    for folder in folders:
        flights[folder.resolve().name] = json.loads((folder / "results.json").read_text())["rows"]
    flights["all"] = [f for some in flights.values() for f in some]
    table = Table(
        title="Undeclared failures (over 5 sigma, not declared lost) and false declarations"
    )
    for heading in ("study", "undeclared", "no fault,\ndeclared lost", "safe landings"):
        table.add_column(heading, justify="left" if heading == "study" else "right")
    for name, some in flights.items():
        right = [f for f in some if f["fault"].startswith("none")]
        table.add_row(
            name, count_text(sum(f["far"] and not f["lost"] for f in some), len(some)),
            count_text(sum(f["lost"] for f in right), len(right)),
            count_text(sum(f["safe"] for f in some), len(some)),
        )  # fmt: skip
    plain_console(120).print(table)


if __name__ == "__main__":
    main()
