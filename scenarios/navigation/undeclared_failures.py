"""Sum the undeclared failures and false declarations of the navigation studies.

The input files are those that `faults.py`, `rock_navigation.py` and `prior_map.py` write with
`--json`. Flights whose fault name (`row`) begins with "none" have no fault.

python scenarios/navigation/undeclared_failures.py faults.json rocks.json prior_map.json
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion


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
    "files", type=click.Path(exists=True, dir_okay=False, path_type=Path), nargs=-1, required=True
)
def main(files: tuple[Path, ...]) -> None:
    """Count undeclared failures and false declarations in result FILES of the studies."""
    flights: dict[str, list[dict[str, Any]]] = {
        file.stem: json.loads(file.read_text()) for file in files
    }
    flights["all"] = [f for some in flights.values() for f in some]
    table = Table(
        title="Undeclared failures (over 5 sigma, not declared lost) and false declarations"
    )
    for heading in ("study", "undeclared", "no fault,\ndeclared lost", "safe landings"):
        table.add_column(heading, justify="left" if heading == "study" else "right")
    for name, some in flights.items():
        right = [f for f in some if f["row"].startswith("none")]
        table.add_row(
            name, count_text(sum(f["far"] and not f["lost"] for f in some), len(some)),
            count_text(sum(f["lost"] for f in right), len(right)),
            count_text(sum(f["safe"] for f in some), len(some)),
        )  # fmt: skip
    plain_console(120).print(table)


if __name__ == "__main__":
    main()
