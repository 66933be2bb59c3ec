"""Compare information-seeking descents with the direct and the modified descent.

The three paths are flown over the same rock fields (paired). The study reports what the map knows
about the terrain at 50 m, which sites are still reachable, the landing outcome and the propellant.
It uses the set-up of the shadow EKF paper with camera, LiDAR, or both. With --sobol it samples Sun,
slope and rock cover by a Sobol sequence, one field per point. Finished flights are saved, so an
interrupted study resumes from the file.

python scenarios/information_seeking.py --fields 20 --jobs 2 --json out/seeking.json
python scenarios/information_seeking.py --sobol 60 --jobs 2 --json out/seeking_sobol.json
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest, wilcoxon
from seeking_flights import ALTITUDES, PATHS, SENSORS, SeekingFlightTask, fly, sample_conditions

from lunarsim import InputError
from lunarsim.campaign.flight_store import Flight, FlightStore
from lunarsim.campaign.pool import iterate_results
from lunarsim.console import plain_console, plain_progress
from lunarsim.evaluation.statistics import mean_interval

LAST = f"{ALTITUDES[-1]:g}"

# Metrics of a flight in the tables.
FIGURES: dict[str, Callable[[Flight], float]] = {
    "clear cells classified as clear": lambda f: f["levels"][LAST].get("clear", np.nan),
    "safe sites known": lambda f: _fraction_of_safe_area(f, LAST, "known_m2"),
    "known and reachable": lambda f: _fraction_of_safe_area(f, LAST, "known_in_reach_m2"),
    "safe sites known at 100 m": lambda f: _fraction_of_safe_area(f, "100", "known_m2"),
    "recall at precision 0.99": lambda f: f["levels"][LAST].get("recall_at_099", np.nan),
    "unsafe sites called safe": lambda f: (
        f["levels"][LAST]["unsafe_called_safe"] / max(f["levels"][LAST]["unsafe"], 1)
    ),
    "safe landings": lambda f: float(f["safe"]),
    "propellant (kg)": lambda f: f["propellant"],
    "duration (s)": lambda f: f["duration"],
}


def _fraction_of_safe_area(flight: Flight, altitude: str, name: str) -> float:
    """Return an area of a flight's map divided by its safe area; NaN if that is zero.

    `altitude` is that of the map (text, m), `name` the key of the area, e.g. "known_m2".
    """
    of = flight["levels"][altitude]
    return float(of[name] / of["safe_m2"]) if of["safe_m2"] > 0.0 else float("nan")


def unfinished(tasks: Sequence[SeekingFlightTask], flights: dict[str, Flight]) -> list[str]:
    """Return the keys of flights that ended before the last map (at 50 m).

    These flights are not compared. `flights` holds the stored results by key.
    """
    return [t.key for t in tasks if t.key in flights and LAST not in flights[t.key]["levels"]]


def complete_fields(
    tasks: Sequence[SeekingFlightTask], flights: dict[str, Flight]
) -> list[dict[str, Flight]]:
    """Group flights by field; keep fields in which all paths reached the last map.

    The last map is that at 50 m. `flights` holds the stored results by key. Returns one dictionary
    per field: flights by path.
    """
    rows: dict[int, dict[str, Flight]] = {}
    for task in tasks:
        done = flights.get(task.key)
        if done is not None and LAST in done["levels"]:
            rows.setdefault(task.field, {})[task.path] = done
    return [row for row in rows.values() if len(row) == len(PATHS)]


def compare_paths(rows: list[dict[str, Flight]]) -> dict[str, dict[str, str]]:
    """Format the mean of each metric for each path, and the paired differences.

    Returns texts with 95 % intervals by metric and path. `rows` holds the flights by path, one
    dictionary per field.
    """
    out: dict[str, dict[str, str]] = {}
    for name, of in FIGURES.items():
        values = {path: np.array([of(row[path]) for row in rows]) for path in PATHS}
        if not np.isfinite(values["seeking"]).any():
            continue
        digits = 2 if "(" in name else 3
        line = {path: mean_interval(v).text(digits) for path, v in values.items()}
        for other in ("nominal", "modified"):
            line[f"seeking - {other}"] = mean_interval(values["seeking"] - values[other]).text(
                digits
            )
        out[name] = line
    return out


def show(title: str, rows: list[dict[str, Flight]], console: Console) -> None:
    """Print the comparison of the three paths for one set of sensors.

    `title` names the sensors; `rows` holds the flights by path, one dictionary per field.
    """
    if not rows:
        return
    table = Table(title=f"{title}: {len(rows)} fields, maps at 50 m (mean, 95 % interval)")
    headings = ("", *PATHS, "seeking - nominal", "seeking - modified")
    for heading in headings:
        table.add_column(heading, justify="left" if not heading else "right")
    for name, line in compare_paths(rows).items():
        table.add_row(name, *line.values())
    console.print(table)
    lost = {p: sum(not row[p]["landed"] for row in rows) for p in PATHS}
    hazards = {p: _missed_hazards_text(row[p] for row in rows) for p in PATHS}
    console.print(
        f"Flights without touchdown: {lost}; hazards classified completely as clear: {hazards}"
    )
    for other in ("nominal", "modified"):
        console.print(paired_test_text(rows, other))
    back = sum(row["seeking"]["fallbacks"] for row in rows)
    console.print(f"Fallbacks of the guidance because no admissible path was found: {back}")


def paired_test_text(rows: list[dict[str, Flight]], other_path: str) -> str:
    """Test whether the seeking path is better than another path; return a text.

    The guidance law `information-seeking` flies the seeking path. The tests are paired by field
    (sign test and Wilcoxon test). `rows` holds the flights by path, one dictionary per field.
    """
    of = FIGURES["clear cells classified as clear"]
    if "clear" not in rows[0]["seeking"]["levels"][LAST]:
        of = FIGURES["recall at precision 0.99"]
    more = np.array([of(row["seeking"]) - of(row[other_path]) for row in rows])
    more = more[np.isfinite(more)]
    ahead, apart = int((more > 0.0).sum()), int((more != 0.0).sum())
    if apart == 0:
        return f"equal to {other_path} in all fields"
    won = mean_interval(more)
    word = "significantly positive" if won.mean - won.half > 0.0 else "not significantly positive"
    return (
        f"better than {other_path} in {ahead} of {len(more)} fields, median {np.median(more):+.3f} "
        f"(sign test: p = {binomtest(ahead, apart).pvalue:.2g}, Wilcoxon test: "
        f"p = {wilcoxon(more).pvalue:.2g}); mean difference {word}"
    )


def _missed_hazards_text(flights: Any) -> str:
    """Format the number of hazards on which all map cells are clear: "count of total"."""
    counts = [(f["levels"][LAST].get("hazards_clear", 0), f["levels"][LAST].get("hazards", 0))
              for f in flights]  # fmt: skip
    return f"{sum(c for c, _ in counts)} of {sum(n for _, n in counts)}"


def show_losses(rows: list[dict[str, Flight]], console: Console) -> None:
    """Print Sun and terrain of the fields in which the seeking path is worse.

    The guidance law `information-seeking` flies the seeking path; the metric is the fraction of
    clear cells classified as clear. `rows` holds the flights by path, one dictionary per field.
    """
    of = FIGURES["clear cells classified as clear"]
    for other in ("nominal", "modified"):
        worse = [row for row in rows if of(row["seeking"]) < of(row[other])]
        console.print(f"Worse than {other} in {len(worse)} of {len(rows)} fields:")
        for row in sorted(worse, key=lambda r: of(r["seeking"]) - of(r[other])):
            g = row["seeking"]["ground"]
            console.print(
                f"  Sun azimuth {g['azimuth']:.0f} deg, elevation {g['elevation']:.0f} deg, slope"
                f" {g['slope']:.1f} deg, cover {100 * g['cover']:.0f} %: {of(row['seeking']):.3f}"
                f" against {of(row[other]):.3f}"
            )


@click.command()
@click.option("--fields", type=click.IntRange(min=1), default=20, show_default=True,
              help="Number of random rock fields in the set-up of the shadow EKF "
              "paper.")  # fmt: skip
@click.option("--sobol", "points", type=click.IntRange(min=0, max=4096), default=0,
              help="Number of Sobol points (combinations of Sun, terrain slope and rock cover) to "
              "fly instead of rock fields; 0: none.")  # fmt: skip
@click.option("--sensors", type=click.Choice((*SENSORS, "all")), default="all", show_default=True,
              help="Sensors that observe the terrain; with --sobol, only the camera is "
              "possible.")  # fmt: skip
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for the flights; if it exists, its flights are not repeated. "
              "Default: none.")  # fmt: skip
@click.option("--figure", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Image file for the figure of safe sites against altitude. Default: no "
              "figure.")  # fmt: skip
def main(
    fields: int, points: int, sensors: str, seed: int, jobs: int, json_file: Path | None,
    figure: Path | None,
) -> None:  # fmt: skip
    """Fly the three paths over the same fields and compare their maps."""
    console = plain_console(150)
    if points and sensors not in {"all", "camera"}:
        raise click.BadParameter("must be 'camera' or 'all' with --sobol", param_hint="--sensors")
    try:
        results = FlightStore(json_file, {"seed": seed, "sobol": points > 0})
    except InputError as error:
        raise click.BadParameter(str(error), param_hint="--json") from None
    if results.outdated_count:
        console.print(
            f"{results.outdated_count} flights of {json_file} were computed with different code"
        )
    if points:
        everything = [
            SeekingFlightTask(p, k, seed, "camera", g)
            for k, g in enumerate(sample_conditions(points, seed))
            for p in PATHS
        ]
    else:
        wanted = SENSORS if sensors == "all" else (sensors,)
        everything = [
            SeekingFlightTask(p, k, seed, s) for k in range(fields) for s in wanted for p in PATHS
        ]
    tasks = [t for t in everything if t.key not in results.flights]
    with plain_progress(console) as progress:
        bar = progress.add_task("flights", total=len(tasks))
        try:
            for index, result in iterate_results(fly, tasks, jobs):
                results.keep(tasks[index].key, result)
                progress.advance(bar)
        except KeyboardInterrupt:
            console.print("Interrupted. The finished flights are saved.")
    for name in SENSORS:
        mine = [t for t in everything if t.sensors == name]
        rows = complete_fields(mine, results.flights)
        show(name, rows, console)
        if short := unfinished(mine, results.flights):
            console.print(
                f"Fields omitted because a flight did not reach {LAST} m: {', '.join(short)}"
            )
        if points and rows:
            show_losses(rows, console)
        if figure is not None and rows:
            from seeking_figure import draw

            draw(rows, figure.with_stem(f"{figure.stem}_{name}"))


if __name__ == "__main__":
    main()
