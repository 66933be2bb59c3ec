"""All eyes on one descent: Gaussian DEM, quadtree, shadows, and the fused map, side by side.

Two cameras and a flash LiDAR look at the same ground from 1000 m down; fields of a row differ in
everything that is drawn, and maps are compared field by field. Every flight is kept in the file: an
interrupt leaves one that the next run goes on from.

python scenarios/all_eyes.py --fields 3 --jobs 1 --json out/all_eyes.json --out out
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import click
import eyes_flights
from eyes_figures import draw, show
from eyes_flights import DEAD_BELOW, ROWS, Task, fly
from rich.console import Console

from lunarsim.campaign.files import code_digest
from lunarsim.campaign.pool import outcomes
from lunarsim.console import plain_console, plain_progress
from lunarsim.whole_files import write_text_whole


class Kept:
    """Flights that are done, in a file that is whole after each of them.

    Parameters
    ----------
    path
        Of the file; None: nothing is kept.
    settings
        Of its flights: seed, altitudes and code; a file of others is refused.

    Raises
    ------
    click.BadParameter
        If there is another file, or one of other settings.
    """

    def __init__(self, path: Path | None, settings: dict[str, Any]) -> None:
        self._path, self._settings = path, settings
        self.flights: dict[str, dict[str, Any]] = {}
        if path is None or not path.exists():
            return
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            there, flights = data["settings"], data["flights"]
        except (ValueError, KeyError, TypeError) as error:
            raise click.BadParameter(
                f"{path} is no file of flights ({error!r})", param_hint="--json"
            ) from None
        if there != settings or not isinstance(flights, dict):
            other = [key for key, value in settings.items() if there.get(key) != value]
            raise click.BadParameter(
                f"{path} holds flights of another {' and '.join(other) or 'study'}: delete it, or "
                "name another file", param_hint="--json",
            )  # fmt: skip
        self.flights = flights

    def keep(self, task: Task, flight: dict[str, Any]) -> None:
        """Add a flight, and write the file anew."""
        self.flights[task.key] = flight
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            data = {"settings": self._settings, "flights": self.flights}
            write_text_whole(self._path, json.dumps(data))


def code() -> str:
    """Return a digest of what flights come from: the package and how they are flown."""
    own = Path(eyes_flights.__file__).read_bytes()
    return hashlib.sha256(code_digest().encode() + own).hexdigest()[:16]


def flown(tasks: list[Task], jobs: int, kept: Kept, console: Console) -> list[dict[str, Any]]:
    """Return the flights of all tasks; those that are kept are not flown again."""
    missing = [task for task in tasks if task.key not in kept.flights]
    with plain_progress(console) as progress:
        bar = progress.add_task("flights", total=len(tasks), completed=len(tasks) - len(missing))
        for index, flight in outcomes(fly, missing, jobs):
            kept.keep(missing[index], flight)
            progress.advance(bar)
    return [kept.flights[task.key] for task in tasks]


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=10, show_default=True,
              help="Fields a row.")  # fmt: skip
@click.option("--rows", default="all", show_default=True,
              help="Names of rows, semicolons between them.")  # fmt: skip
@click.option("--altitudes", default="1000,500,200,100", show_default=True,
              help="Where maps are judged, m.")  # fmt: skip
@click.option("--seed", type=int, default=1, show_default=True, help="Root seed.")
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Processes; results do not depend on it.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="File for the counts of every flight; those in it are kept.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure.")  # fmt: skip
def main(
    fields: int,
    rows: str,
    altitudes: str,
    seed: int,
    jobs: int,
    json_file: Path | None,
    out: Path | None,
) -> None:
    """Fly the rows and print what each map is worth."""
    wanted = list(ROWS) if rows == "all" else [name.strip() for name in rows.split(";")]
    unknown = [name for name in wanted if name not in ROWS]
    if unknown:
        raise click.BadParameter(
            f"{unknown[0]!r}: not one of {'; '.join(ROWS)}", param_hint="--rows"
        )
    try:
        levels = tuple(float(a) for a in altitudes.split(","))
    except ValueError:
        levels = ()
    if not (levels and all(50.0 <= a <= 1500.0 for a in levels)):
        raise click.BadParameter(
            f"{altitudes!r}: metres from 50 to 1500, commas between them", param_hint="--altitudes"
        )
    settings = {"seed": seed, "altitudes": list(levels), "code": code()}
    kept = Kept(json_file, settings)
    # Rows of one world and field one after the other: it is built once.
    order = sorted(wanted, key=lambda name: ROWS[name].world)
    tasks = [Task(row, n, seed, levels) for n in range(fields) for row in order]
    console = plain_console(150)
    flights = flown(tasks, jobs, kept, console)
    flights.sort(key=lambda f: wanted.index(f["row"]))
    show(flights, DEAD_BELOW, console)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        draw(flights, out / "all_eyes.png")


if __name__ == "__main__":
    main()
