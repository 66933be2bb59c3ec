"""Compare information-seeking descents with the direct and the modified descent.

The three paths are flown over the same rock fields (paired). The study reports what the map knows
about the terrain at 50 m, which sites are still reachable, the landing outcome and the propellant.
It uses the set-up of the shadow EKF paper with camera, LiDAR, or both. With --sobol, Sun, slope and
rock cover of each field are a point of a Sobol sequence.

python scenarios/information_seeking.py --fields 20 --jobs 2 --out out/seeking
python scenarios/information_seeking.py --sobol --sensors camera --fields 60 --out out/seeking_sobol
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click
import numpy as np
from rich.table import Table
from scipy.stats import binomtest, wilcoxon
from seeking_figure import draw
from seeking_flights import ALTITUDES, PATHS, SENSORS, SunAndTerrain, fly, sample_conditions

from lunarsim import flight_seed
from lunarsim.evaluation.statistics import mean_interval
from lunarsim.studies import Case, Report, Study, run_script

Flight = dict[str, Any]
LAST = f"{ALTITUDES[-1]:g}"

# Metrics of a flight in the tables.
FIGURES: dict[str, Callable[[Flight], float]] = {
    "clear cells classified as clear": lambda f: f["levels"][LAST].get("clear", np.nan),
    "safe sites known": lambda f: _fraction_of_safe_area(f, LAST, "known_m2"),
    "safe sites known and reachable": lambda f: _fraction_of_safe_area(
        f, LAST, "known_in_reach_m2"
    ),
    "safe sites known at 100 m": lambda f: _fraction_of_safe_area(f, "100", "known_m2"),
    "recall at precision 0.99": lambda f: f["levels"][LAST].get("recall_at_099", np.nan),
    "unsafe sites classified as safe": lambda f: (
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


def fly_paths(case: Case) -> list[Flight]:
    """Simulate the three paths over one field; one row per path."""
    conditions = SunAndTerrain()
    if case["sobol"]:
        # The sequence of more points begins with the same points.
        conditions = sample_conditions(case.number + 1, case.seed)[-1]
    return [
        fly(path, case["sensors"], conditions, flight_seed(case.seed, case.number))
        for path in PATHS
    ]


def complete_fields(rows: list[Flight]) -> list[dict[str, Flight]]:
    """Group flights by field; keep fields in which all paths reached the last map, at 50 m.

    Returns one dictionary per field: flights by path.
    """
    fields: dict[int, dict[str, Flight]] = {}
    for row in rows:
        if LAST in row["levels"]:
            fields.setdefault(row["number"], {})[row["path"]] = row
    return [field for field in fields.values() if len(field) == len(PATHS)]


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


def show(title: str, rows: list[dict[str, Flight]], report: Report) -> None:
    """Print the comparison of the three paths for one set of sensors.

    `title` names the sensors; `rows` holds the flights by path, one dictionary per field.
    """
    table = Table(title=f"{title}: {len(rows)} fields, maps at 50 m (mean, 95 % interval)")
    headings = ("", *PATHS, "seeking - nominal", "seeking - modified")
    for heading in headings:
        table.add_column(heading, justify="left" if not heading else "right")
    for name, line in compare_paths(rows).items():
        table.add_row(name, *line.values())
    report.print(table)
    lost = {p: sum(not row[p]["landed"] for row in rows) for p in PATHS}
    hazards = {p: _missed_hazards_text(row[p] for row in rows) for p in PATHS}
    report.print(
        f"Flights without touchdown: {lost}; hazards classified completely as clear: {hazards}"
    )
    for other in ("nominal", "modified"):
        report.print(paired_test_text(rows, other))
    back = sum(row["seeking"]["fallbacks"] for row in rows)
    report.print(f"Fallbacks of the guidance because no admissible path was found: {back}")


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


def show_losses(rows: list[dict[str, Flight]], report: Report) -> None:
    """Print Sun and terrain of the fields in which the seeking path is worse.

    The guidance law `information-seeking` flies the seeking path; the metric is the fraction of
    clear cells classified as clear. `rows` holds the flights by path, one dictionary per field.
    """
    of = FIGURES["clear cells classified as clear"]
    for other in ("nominal", "modified"):
        worse = [row for row in rows if of(row["seeking"]) < of(row[other])]
        report.print(f"Worse than {other} in {len(worse)} of {len(rows)} fields:")
        for row in sorted(worse, key=lambda r: of(r["seeking"]) - of(r[other])):
            g = row["seeking"]["ground"]
            report.print(
                f"  Sun azimuth {g['azimuth']:.0f} deg, elevation {g['elevation']:.0f} deg, slope"
                f" {g['slope']:.1f} deg, cover {100 * g['cover']:.0f} %: {of(row['seeking']):.3f}"
                f" against {of(row[other]):.3f}"
            )


def print_paths(report: Report) -> None:
    """Print and plot the comparison of the three paths for each set of sensors."""
    for (sensors,), flights in report.groups("sensors").items():
        rows = complete_fields(flights)
        short = [f"{f['number']} / {f['path']}" for f in flights if LAST not in f["levels"]]
        if rows:
            show(sensors, rows, report)
        if short:
            report.print(
                f"Fields omitted because a flight did not reach {LAST} m: {', '.join(short)}"
            )
        if rows and report.options["sobol"]:
            show_losses(rows, report)
        if rows and report.out is not None:
            draw(rows, report.out / f"known_in_reach_{sensors}.png")


study = Study(
    fly_paths,
    repeats="fields",
    count=20,
    factors={"sensors": SENSORS},
    factor_help={"sensors": "Sensors that observe the terrain."},
    options=(
        click.Option(
            ["--sobol"], is_flag=True, default=False,
            help="Sample Sun, terrain slope and rock cover of each field by a Sobol sequence.",
        ),
    ),
    report=print_paths,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
