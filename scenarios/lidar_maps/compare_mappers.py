"""Compare both LiDAR maps on flights to touchdown over five terrains.

The comparison is between maps, not navigation. Over all terrains except the hazard field (where the
vehicle finds its position on a map), navigation uses the truth plus an error budget
(`navigation-fix`). Flight i over a terrain has the same start and noise with every map.
`safest` lands at the highest map probability, `scoreboard` at the top of the quadtree ranking. One
flight of each index runs all mappers: their maps are compared with exact safety at the first and
the last decision, by stratum of the true terrain, over all terrain that any of them has observed.
Where a map claims a calibrated probability it is evaluated as one; elsewhere its value is a bound.
Intervals are 95 %: Wilson for landings, bootstrap over flights for maps. The table values are also
written to figures.json in the folder of --out.

python scenarios/lidar_maps/compare_mappers.py --flights 100 --jobs 2 --out out/mappers
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from comparison_rows import ROWS
from mapper_flights import MAPPERS, STRATA, WAYS, WORLDS, fly
from rich.table import Table
from scipy.stats import binomtest

from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.reliability import calibration_error
from lunarsim.studies import Case, Proportion, Report, Study, run_script
from lunarsim.viz.style import COLOURS, new_figure, save

RESAMPLES = 1000
Flights = list[dict[str, Any]]
Figures = dict[str, dict[str, Any]]


def fly_mappers(case: Case) -> dict[str, Any]:
    """Simulate the flights over one terrain, one with each map and policy."""
    return fly(case["world"], case.number, case.seed)


def metric_interval(
    counts: np.ndarray, metric: Callable[[np.ndarray], np.ndarray]
) -> tuple[float, float, float]:
    """Return a metric of summed counts with bootstrap interval: value, low, high.

    `counts` (n, ...) holds one entry per flight; `metric` computes the metric of each entry along
    the first axis of an array of counts.
    """
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(counts), (RESAMPLES, len(counts)))
    weights = np.stack([np.bincount(d, minlength=len(counts)) for d in drawn]).astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        value = float(metric(counts.sum(axis=0)[None])[0])
        spread = metric(np.tensordot(weights, counts, 1))
    spread = spread[np.isfinite(spread)]
    if not spread.size:
        return value, float("nan"), float("nan")
    low, high = np.percentile(spread, [2.5, 97.5])
    return value, float(low), float(high)


def precision(counts: np.ndarray) -> np.ndarray:
    """Return the fraction of cells called safe that are safe, from counts (..., 4).

    The counts are true safe, false safe, missed and rejected cells.
    """
    return counts[..., 0] / (counts[..., 0] + counts[..., 1])


def recall(counts: np.ndarray) -> np.ndarray:
    """Return the fraction of safe cells that are called safe, from counts (..., 4).

    The counts are true safe, false safe, missed and rejected cells.
    """
    return counts[..., 0] / (counts[..., 0] + counts[..., 2])


def skill_of(calibrated: np.ndarray) -> float:
    """Return the Brier skill of cells with a calibrated probability.

    `calibrated` holds their number, the number of safe ones and the sum of squared errors. NaN if
    all cells are safe or all are unsafe.
    """
    n, safe, squares = calibrated
    base = safe / max(n, 1.0)
    return float(1.0 - squares / (n * base * (1.0 - base))) if 0 < base < 1 else float("nan")


def landing_metrics(flights: Flights) -> Figures:
    """Return landing metrics by map and policy.

    Each combination is compared flight by flight with the first one.
    """
    first = [f["landings"][next(iter(WAYS))]["safe"] for f in flights]
    out = {}
    for way in WAYS:
        mine = [f["landings"][way] for f in flights]
        safe = [row["safe"] for row in mine]
        landed = Proportion(sum(safe), len(safe))
        won = sum(a and not b for a, b in zip(safe, first, strict=True))
        lost = sum(b and not a for a, b in zip(safe, first, strict=True))
        out[way] = {
            "flights": len(mine), "landed": landed.count, "interval": landed.interval,
            "won": won, "lost": lost,
            "p_value": float(binomtest(won, won + lost).pvalue) if won + lost else 1.0,
            "divert_median_m": float(np.median([row["divert_m"] for row in mine])),
            "propellant_median_kg": float(np.median([row["propellant_kg"] for row in mine])),
        }  # fmt: skip
    return out


def quality_metrics(flights: Flights, mapper: str, moment: str) -> dict[str, Any]:
    """Return quality metrics of a mapper's maps at one decision; empty without maps.

    `moment` is the decision, "first" or "last".
    """
    evaluated = [e for f in flights if (e := f["maps"][mapper][moment]) is not None]
    if not evaluated:
        return {}
    counts = np.array([e["counts"] for e in evaluated], dtype=np.float64)
    claims = np.sum([e["claimed"] for e in evaluated], axis=0)
    return {
        "precision": metric_interval(counts.sum(axis=1), precision),
        "recall": metric_interval(counts.sum(axis=1), recall),
        "claimed": float(claims[:, 0].sum() / max(counts.sum(), 1.0)),
        "ece": calibration_error(np.sum([e["table"] for e in evaluated], axis=0)),
        "skill": skill_of(claims.sum(axis=0)),
        "strata": {
            name: {
                "cells": float(counts[:, k].sum()),
                "safe": MapQuality(*counts[:, k].sum(axis=0).astype(int)).safe_share,
                "precision": metric_interval(counts[:, k], precision),
                "recall": metric_interval(counts[:, k], recall),
                "skill": skill_of(claims[k]),
            }
            for k, name in enumerate(STRATA)
        },
    }


def map_metrics(flights: Flights) -> Figures:
    """Return map quality, computing time and memory by mapper."""
    out = {}
    for mapper in MAPPERS:
        mine = [f["maps"][mapper] for f in flights]
        out[mapper] = {
            "first": quality_metrics(flights, mapper, "first"),
            "last": quality_metrics(flights, mapper, "last"),
            "seconds": float(np.mean([m["seconds"] for m in mine])),
            "megabytes": float(np.max([m["megabytes"] for m in mine])),
        }
    return out


HEADINGS = {
    "landings": (2, ("world", "map and policy", "flights", "safe landings",
                     "against the first:\nbetter, worse (p)", "divert\nmedian (m)",
                     "propellant\nmedian (kg)")),
    "maps": (3, ("world", "map", "decision", "precision", "recall", "claimed\n(fraction)",
                 "ECE of\nclaimed", "its Brier\nskill", "mapper time\n(s per flight)",
                 "memory\n(MB)")),
    "strata": (3, ("world", "stratum", "map", "safe\n(fraction)", "precision", "recall",
                   "Brier skill\nof claimed")),
}  # fmt: skip
TITLES = {
    "landings": "Landings",
    "maps": "Maps at the first and the last decision (safe: p > 0.5)",
    "strata": "Maps at the last decision by stratum of the true terrain",
}


def table_of(name: str, worlds: dict[str, Figures]) -> Table:
    """Return a table of the comparison: "landings", "maps" or "strata".

    `worlds` holds the results by name of the terrain.
    """
    table = Table(title=TITLES[name])
    left, headings = HEADINGS[name]
    for n, heading in enumerate(headings):
        table.add_column(heading, justify="left" if n < left else "right", no_wrap=n < left)
    for world, figures in worlds.items():
        for n, row in enumerate(ROWS[name](figures)):
            table.add_row(world if n == 0 else "", *row)
        table.add_section()
    return table


def draw(worlds: dict[str, Figures], path: Path) -> None:
    """Plot safe landings by map and policy, and precision and recall of the last maps.

    `worlds` holds the results by name of the terrain; `path` is the output file.
    """
    figure = new_figure(12.0, 5.0)
    panels = figure.subplots(1, 3, sharey=True)
    colours = dict(zip(WAYS, COLOURS, strict=False))
    for way, colour in colours.items():
        rows = [figures["landings"][way] for figures in worlds.values()]
        values = [(f["landed"] / f["flights"], *f["interval"]) for f in rows]
        _plot_intervals(panels[0], values, list(WAYS).index(way), len(WAYS), colour, way)
    for n, (mapper, name) in enumerate(MAPPERS.items()):
        last = [figures["maps"][mapper]["last"] for figures in worlds.values()]
        for panel, key in zip(panels[1:], ("precision", "recall"), strict=True):
            values = [q[key] if q else (np.nan,) * 3 for q in last]
            _plot_intervals(panel, values, n, len(MAPPERS), colours[name], name)
    for panel, label in zip(
        panels,
        ("Safe landings", "Precision of the last map", "Recall of the last map"),
        strict=True,
    ):
        panel.set_xlabel(f"{label} (95 % interval)")
        panel.set_yticks(np.arange(len(worlds)), list(worlds))
        panel.set_ylim(len(worlds) - 0.5, -0.5)
        panel.grid(axis="x", alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save(figure, path)


def _plot_intervals(
    panel: Any, values: Any, series: int, series_count: int, color: str, label: str
) -> None:
    """Plot values with intervals (k, 3) as points with error bars in one row each.

    The rows of the series number `series` of `series_count` are shifted to prevent overlap.
    """
    v = np.array(values, dtype=np.float64)
    y = np.arange(len(v)) + 0.18 * (series - 0.5 * (series_count - 1))
    spread = np.maximum(np.stack((v[:, 0] - v[:, 1], v[:, 2] - v[:, 0])), 0.0)
    panel.errorbar(
        v[:, 0], y, xerr=spread, fmt="o", color=color, capsize=3, markersize=5, label=label
    )


def print_comparison(report: Report) -> None:
    """Print landings and map quality by terrain; write and plot them."""
    worlds = {
        world: {"landings": landing_metrics(flights), "maps": map_metrics(flights)}
        for (world,), flights in report.groups("world").items()
    }
    for name in ROWS:
        report.print(table_of(name, worlds))
    if report.out is not None:
        text = json.dumps(worlds, indent=1)
        (report.out / "figures.json").write_text(text, encoding="utf-8")
        draw(worlds, report.out / "mappers.png")


study = Study(
    fly_mappers,
    repeats="flights",
    count=10,
    minimum=2,
    factors={"world": list(WORLDS)},
    factor_help={"world": "Terrain to fly over."},
    report=print_comparison,
)

if __name__ == "__main__":
    run_script(study)
