"""Compare the Gaussian DEM, quadtree, shadow and fused maps on the same descents.

Two cameras and a flash LiDAR observe the same terrain from an altitude of 1000 m downwards. Each
field has its own terrain, rocks and noise, and the maps are compared field by field. Every finished
flight is saved in the JSON file, so an interrupted study resumes from it.

python scenarios/sensor_fusion.py --fields 3 --jobs 1 --json out/all_sensors.json --out out
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import click
import sensor_fusion_flights
from rich.console import Console
from sensor_fusion_figures import draw, show
from sensor_fusion_flights import DEAD_BELOW, ROWS, FusionFlightTask, fly

from lunarsim.atomic_files import atomic_write_text
from lunarsim.campaign.files import code_digest
from lunarsim.campaign.pool import iterate_results
from lunarsim.console import plain_console, plain_progress


class FusionFlightStore:
    """Store of finished flights; its file is written atomically after each flight.

    Parameters
    ----------
    path
        File of the flights. None: nothing is saved.
    settings
        Seed, altitudes and code digest. A file with other settings is rejected.

    Raises
    ------
    click.BadParameter
        If the file is not a file of flights or has other settings.
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
                f"{path} is not a file of flights ({error!r})", param_hint="--json"
            ) from None
        if there != settings or not isinstance(flights, dict):
            other = [key for key, value in settings.items() if there.get(key) != value]
            raise click.BadParameter(
                f"{path} contains flights with another {' and '.join(other) or 'study'}. Delete "
                "this file or name another one.", param_hint="--json",
            )  # fmt: skip
        self.flights = flights

    def add(self, task: FusionFlightTask, flight: dict[str, Any]) -> None:
        """Add the results of one flight and rewrite the file."""
        self.flights[task.key] = flight
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            data = {"settings": self._settings, "flights": self.flights}
            atomic_write_text(self._path, json.dumps(data))


def study_digest() -> str:
    """Return a digest of the source code of lunarsim and of this study."""
    own = Path(sensor_fusion_flights.__file__).read_bytes()
    return hashlib.sha256(code_digest().encode() + own).hexdigest()[:16]


def fly_missing(
    tasks: list[FusionFlightTask], jobs: int, store: FusionFlightStore, console: Console
) -> list[dict[str, Any]]:
    """Return the results of all flights; simulate only those that are not stored.

    `jobs` is the number of processes; new flights are added to `store`.
    """
    missing = [task for task in tasks if task.key not in store.flights]
    with plain_progress(console) as progress:
        bar = progress.add_task("flights", total=len(tasks), completed=len(tasks) - len(missing))
        for index, flight in iterate_results(fly, missing, jobs):
            store.add(missing[index], flight)
            progress.advance(bar)
    return [store.flights[task.key] for task in tasks]


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=10, show_default=True,
              help="Number of simulated rock fields for each study condition (row of the results "
              "table).")  # fmt: skip
@click.option("--rows", default="all", show_default=True,
              help="Names of the study conditions (rows of the results table) to fly, separated by "
              "semicolons, or all.")  # fmt: skip
@click.option("--altitudes", default="1000,500,200,100", show_default=True,
              help="Altitudes at which the maps are evaluated (m), separated by "
              "commas.")  # fmt: skip
@click.option(
    "--seed",
    type=int,
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for the flights; if it exists, its flights are not repeated. "
              "Default: none.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure. Default: no figure.")  # fmt: skip
def main(
    fields: int,
    rows: str,
    altitudes: str,
    seed: int,
    jobs: int,
    json_file: Path | None,
    out: Path | None,
) -> None:
    """Fly all study conditions (rows) and print the quality of each hazard map."""
    wanted = list(ROWS) if rows == "all" else [name.strip() for name in rows.split(";")]
    unknown = [name for name in wanted if name not in ROWS]
    if unknown:
        raise click.BadParameter(
            f"must be one of {'; '.join(ROWS)}, got {unknown[0]!r}", param_hint="--rows"
        )
    try:
        levels = tuple(float(a) for a in altitudes.split(","))
    except ValueError:
        levels = ()
    if not (levels and all(50.0 <= a <= 1500.0 for a in levels)):
        raise click.BadParameter(
            f"must be numbers from 50 to 1500 (m), separated by commas, got {altitudes!r}",
            param_hint="--altitudes",
        )
    settings = {"seed": seed, "altitudes": list(levels), "code": study_digest()}
    kept = FusionFlightStore(json_file, settings)
    # Rows that share a world and field run consecutively: the cached world is built once.
    order = sorted(wanted, key=lambda name: ROWS[name].world)
    tasks = [FusionFlightTask(row, n, seed, levels) for n in range(fields) for row in order]
    console = plain_console(150)
    flights = fly_missing(tasks, jobs, kept, console)
    flights.sort(key=lambda f: wanted.index(f["row"]))
    show(flights, DEAD_BELOW, console)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        draw(flights, out / "all_sensors.png")


if __name__ == "__main__":
    main()
