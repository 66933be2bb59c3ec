"""Test both LiDAR maps on an airborne point cloud: map a part, test on the rest.

Heights: a random half of the terrain returns is mapped at 0.25 m; the other half gives the error.
Safety: a lander is scaled so that its footprint contains as many mapped returns as in one scan from
1000 m. The exact test on the surface through the held-out returns is the reference for p_safe.

python scenarios/real_returns/airborne.py --splits 4 --out out/real_returns
"""

from __future__ import annotations

from dataclasses import astuple, replace
from typing import Any

import click
import numpy as np
from figures import LEVELS, MAPPED_CELLS, draw
from held_out_comparison import (
    compare_heights,
    compare_safety,
    height_metrics,
    safety_counts,
    safety_metrics,
)
from returns import SLOPE_LIMIT_DEG, STRATA, AirborneCloud, load
from rich.table import Table

from lunarsim.evaluation.statistics import mean_interval
from lunarsim.studies import Case, Report, Study, pack_array, run_script

SHARES = (0.5, 0.1)  # fractions of the returns that are mapped in the safety test


def measure_split(case: Case) -> list[dict[str, Any]]:
    """Test mapped heights and p_safe on one random split of the cloud.

    The rows have statistics of the height errors, or counts of p_safe, by map and slope class.
    """
    seed = case.seed + case.number
    cloud = load(limit=24.0 if case["quick"] else None)
    rows = height_rows("terrain returns", cloud, seed)
    for share in SHARES:
        rows += safety_rows(cloud, share, seed)
    if not case["quick"]:
        rows += height_rows("returns of every class", load(ground_only=False), seed)
    return rows


def height_rows(returns: str, cloud: AirborneCloud, seed: int) -> list[dict[str, Any]]:
    """Return statistics of the height errors by map and slope class; `returns` names the cloud.

    Rows of all slopes have the fraction of errors beyond each multiple of sigma in `LEVELS`; that
    of the map in flight has positions (m) and errors divided by sigma as compressed text.
    """
    rows = []
    for name, errors in compare_heights(cloud, seed).items():
        own = {"test": "heights", "returns": returns, "map": name}
        ratio = np.abs(errors.error) / errors.sigma
        beyond = 1.0 - np.searchsorted(np.sort(ratio), LEVELS) / ratio.size
        rows.append({**own, "slope": "all", **errors.statistics(), "beyond": beyond})
        if name == "as flights do":
            rows[-1] |= {"xy": pack_array(errors.xy), "ratio": pack_array(ratio)}
        rows += [{**own, "slope": s, **errors.statistics(k)} for k, s in enumerate(STRATA)]
    return rows


def safety_rows(cloud: AirborneCloud, share: float, seed: int) -> list[dict[str, Any]]:
    """Return counts of p_safe by map and slope class, with a fraction of the returns mapped.

    Rows of all slopes also have the scale of the lander, the agreement of the exact safety on
    mapped and held-out returns, and the safe fractions. One map has its classes as raster.
    """
    found = compare_safety(cloud, share, seed)
    fractions = {
        "scale": found.scale, "agreement": found.agreement, "dense_share": found.dense_share,
        "held_share": found.held_share,
    }  # fmt: skip
    truth, rasters, _, grid = found.maps
    rows = []
    for name, p in found.p.items():
        own = {"test": "safety", "mapped": share, "map": name}
        rows.append({**own, "slope": "all", **fractions, **safety_counts(p, found.safe)})
        if name == MAPPED_CELLS:
            classes = 2.0 * (truth == 1.0) + (rasters[name] > 0.5)
            rows[-1]["classes"] = pack_array(np.where(np.isnan(truth), np.nan, classes))
            rows[-1]["grid"] = astuple(grid)
        for k, slope in enumerate(STRATA):
            use = found.stratum == k
            rows.append({**own, "slope": slope, **safety_counts(p[use], found.safe[use])})
    return rows


def print_tests(report: Report) -> None:
    """Print height errors and quality of p_safe by map and slope class, over all splits."""
    heights = replace(report, rows=[row for row in report.rows if row["test"] == "heights"])
    for (returns,), rows in heights.groups("returns").items():
        print_heights(replace(report, rows=rows), returns)
    safety = replace(report, rows=[row for row in report.rows if row["test"] == "safety"])
    for (share,), rows in safety.groups("mapped").items():
        print_safety(replace(report, rows=rows), share)
    if report.out is not None:
        draw(report, report.out / "airborne.png")


def print_heights(report: Report, returns: str) -> None:
    """Print the height errors by map and slope class; the rows are those of some returns."""
    table = Table(title=f"Height error at the held-out returns, {returns}")
    for heading in ("map", "slope", "returns", "bias (m)", "RMSE (m)", "NEES (ideal 1)",
                    "beyond 2 sigma (ideal 0.046)", "beyond 3 sigma (ideal 0.003)"):  # fmt: skip
        table.add_column(heading, justify="right")
    for (name, slope), rows in report.groups("map", "slope").items():
        f = height_metrics(rows)
        nees = f"{f['nees']:.2f}"
        if slope == "all" and len(rows) > 1:
            nees = mean_interval([row["nees"] for row in rows]).text(2)
        table.add_row(
            name if slope == "all" else "", slope, f"{f['n']}", f"{f['bias']:+.4f}",
            f"{f['rmse']:.4f}", nees, f"{f['beyond2']:.4f}", f"{f['beyond3']:.4f}",
        )  # fmt: skip
    report.print(table)


def print_safety(report: Report, share: float) -> None:
    """Print the quality of p_safe by map and slope class, with a fraction of returns mapped."""
    scale, agreement, dense, held = (
        float(np.nanmean(report.column(name)))
        for name in ("scale", "agreement", "dense_share", "held_share")
    )
    report.print(
        f"Fraction {share:.2f} of the returns mapped; lander scale {scale:.2f}, slope limit "
        f"{SLOPE_LIMIT_DEG:.0f} deg. The exact safety on mapped and on held-out returns agrees at "
        f"{agreement:.3f} of the sites; safe fraction on all returns {dense:.3f}, on held-out "
        f"returns {held:.3f}"
    )
    table = Table(title=f"p_safe and the exact safety on held-out returns, {share:.2f} mapped")
    for heading in ("map", "slope", "sites", "safe (fraction)", "mean p", "ECE", "Brier skill",
                    "precision, p > 0.5", "recall", "safe fraction at p > 0.95"):  # fmt: skip
        table.add_column(heading, justify="right")
    for (name, slope), rows in report.groups("map", "slope").items():
        count, *values = safety_metrics(rows).values()
        table.add_row(
            name if slope == "all" else "", slope, f"{count}", *(f"{v:.3f}" for v in values)
        )
    report.print(table)


study = Study(
    measure_split,
    repeats="splits",
    count=4,
    seed=0,
    options=(
        click.Option(
            ["--quick"], is_flag=True, default=False,
            help="Use only terrain returns within 24 m of the centre, for a shorter run.",
        ),
    ),
    report=print_tests,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
