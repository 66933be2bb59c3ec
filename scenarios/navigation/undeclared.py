"""How many flights of several studies ended far off and nobody said so; how many were called lost.

Reads what `faults.py`, `rocks.py` and `prior_map.py` write with `--json`. Nothing is wrong in the
flights of rows whose names begin with "none".

python scenarios/navigation/undeclared.py faults.json rocks.json prior_map.json
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import Proportion


def shown(count: int, of: int) -> str:
    """Return a count with the 95 % interval of its share."""
    if of == 0:
        return "-"
    low, high = Proportion(count, of).interval
    return f"{count} of {of} [{low:.3f}, {high:.3f}]"


@click.command()
@click.argument(
    "files", type=click.Path(exists=True, dir_okay=False, path_type=Path), nargs=-1, required=True
)
def main(files: tuple[Path, ...]) -> None:
    """Add up flights with something wrong, and flights without."""
    flights: dict[str, list[dict[str, Any]]] = {
        file.stem: json.loads(file.read_text()) for file in files
    }
    flights["all"] = [f for some in flights.values() for f in some]
    table = Table(title="Over 5 sigma and not called lost; called lost with nothing wrong")
    for heading in ("study", "undeclared", "nothing wrong,\ncalled lost", "landed safe"):
        table.add_column(heading, justify="left" if heading == "study" else "right")
    for name, some in flights.items():
        right = [f for f in some if f["row"].startswith("none")]
        table.add_row(
            name, shown(sum(f["far"] and not f["lost"] for f in some), len(some)),
            shown(sum(f["lost"] for f in right), len(right)),
            shown(sum(f["safe"] for f in some), len(some)),
        )  # fmt: skip
    plain_console(120).print(table)


if __name__ == "__main__":
    main()
