"""Test both LiDAR maps on an airborne point cloud: map a part, test on the rest.

    python scenarios/real_returns/airborne.py --splits 4 --out out/real_returns

Heights: a random half of the terrain returns is mapped at 0.25 m; the other half gives the error.
Safety: a lander is scaled so that its footprint contains as many mapped returns as in one scan from
1000 m. The exact test on the surface through the held-out returns is the reference for p_safe.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
from figures import draw
from held_out_comparison import (
    HeightErrors,
    SafetyComparison,
    compare_heights,
    compare_safety,
    metrics_by_slope,
    safety_metrics,
)
from returns import SLOPE_LIMIT_DEG, STRATA, AirborneCloud, load
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import mean_interval

SHARES = (0.5, 0.1)  # fractions of the returns that are mapped in the safety test


def pool_heights(maps: list[HeightErrors]) -> HeightErrors:
    """Concatenate the height errors of several random splits of the returns."""
    names = ("error", "sigma", "stratum", "xy")
    return HeightErrors(*(np.concatenate([getattr(m, name) for m in maps]) for name in names))


def pool_safety(comparisons: list[SafetyComparison]) -> SafetyComparison:
    """Combine the safety comparisons of several random splits.

    The sites are concatenated; the fractions are averaged.
    """
    first = comparisons[0]
    means = (
        float(np.mean([getattr(v, name) for v in comparisons]))
        for name in ("agreement", "dense_share", "held_share")
    )
    return SafetyComparison(
        {m: np.concatenate([v.p[m] for v in comparisons]) for m in first.p},
        np.concatenate([v.safe for v in comparisons]),
        np.concatenate([v.stratum for v in comparisons]),
        *means,
        first.scale,
        first.maps,
    )


def show_heights(
    results: list[dict[str, HeightErrors]], title: str, console: Console
) -> dict[str, Any]:
    """Print the height errors of each map by slope class; return the printed values.

    `results` holds the errors by map name, one dictionary per random split.
    """
    table = Table(title=f"Height error at the held-out returns, {len(results)} splits, {title}")
    for heading in ("map", "slope", "returns", "bias (m)", "RMSE (m)", "NEES (ideal 1)",
                    "beyond 2 sigma (ideal 0.046)", "beyond 3 sigma (ideal 0.003)"):  # fmt: skip
        table.add_column(heading, justify="right")
    kept: dict[str, Any] = {}
    for name in results[0]:
        every = pool_heights([r[name] for r in results])
        own = [r[name].statistics() for r in results]
        rows = [("all", every.statistics())]
        rows += [(label, every.statistics(k)) for k, label in enumerate(STRATA)]
        kept[name] = dict(rows) | {"by split": own}
        for label, f in rows:
            nees = f"{f['nees']:.2f}"
            if label == "all" and len(own) > 1:
                nees = mean_interval([o["nees"] for o in own]).text(2)
            table.add_row(
                name if label == "all" else "", label, f"{f['n']}", f"{f['bias']:+.4f}",
                f"{f['rmse']:.4f}", nees, f"{f['beyond2']:.4f}", f"{f['beyond3']:.4f}",
            )  # fmt: skip
    console.print(table)
    return kept


def show_safety(
    comparison: SafetyComparison, mapped_fraction: float, console: Console
) -> dict[str, Any]:
    """Print the quality metrics of p_safe by map and slope class; return them.

    `mapped_fraction` is the fraction of the returns in the maps.
    """
    console.print(
        f"Fraction {mapped_fraction:.2f} of the returns mapped; "
        f"lander scale {comparison.scale:.2f}, slope "
        f"limit "
        f"{SLOPE_LIMIT_DEG:.0f} deg. The exact safety on mapped and on held-out returns "
        f"agrees at {comparison.agreement:.3f} of the sites; safe fraction on all returns "
        f"{comparison.dense_share:.3f}, on held-out returns {comparison.held_share:.3f}"
    )
    table = Table(
        title=f"p_safe compared with the exact safety on held-out returns, "
        f"{mapped_fraction:.2f} mapped"
    )
    for heading in ("map", "slope", "sites", "safe (fraction)", "mean p", "ECE", "Brier skill",
                    "precision, p > 0.5", "recall", "safe fraction at p > 0.95"):  # fmt: skip
        table.add_column(heading, justify="right")
    kept: dict[str, Any] = {}
    for name in comparison.p:
        rows = [("all", safety_metrics(comparison.p[name], comparison.safe))]
        rows += list(zip(STRATA, metrics_by_slope(comparison, name), strict=True))
        kept[name] = dict(rows)
        for label, s in rows:
            table.add_row(
                name if label == "all" else "", label, f"{s['n']}",
                *(f"{s[k]:.3f}" for k in ("share", "mean_p", "ece", "skill", "precision", "recall",
                                          "above")),
            )  # fmt: skip
    console.print(table)
    return kept


def study(
    cloud: AirborneCloud, splits: int, title: str, console: Console
) -> tuple[dict[str, Any], Any]:
    """Test mapped heights and p_safe on random splits of an airborne LiDAR cloud.

    Returns the metrics for JSON and the data for the figure. `title` names the returns in the
    tables.
    """
    heights = [
        compare_heights(cloud, seed)
        for seed in track(range(splits), description=f"heights, {title}")
    ]
    kept: dict[str, Any] = {"heights": show_heights(heights, title, console), "safety": {}}
    safety = {}
    for share in SHARES:
        name = f"safety, {share:.2f} mapped, {title}"
        runs = [
            compare_safety(cloud, share, seed) for seed in track(range(splits), description=name)
        ]
        safety[share] = pool_safety(runs)
        kept["safety"][str(share)] = show_safety(safety[share], share, console)
    return kept, (heights[0],
    {name: pool_heights([h[name] for h in heights]) for name in heights[0]},
                  safety)  # fmt: skip


@click.command()
@click.option("--splits", type=click.IntRange(min=1), default=4, show_default=True,
              help="Number of random splits of the LiDAR returns into mapped and held-out "
              "returns.")  # fmt: skip
@click.option("--quick", is_flag=True,
              help="Use only terrain returns within 24 m of the centre, for a shorter "
              "run.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for all results. Default: none.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure. Default: no figure.")  # fmt: skip
def main(splits: int, quick: bool, json_file: Path | None, out: Path | None) -> None:
    """Map measured LiDAR returns with both mappers; test on held-out returns."""
    console = plain_console(170)
    limit = 24.0 if quick else None
    kept, drawn = study(load(limit=limit), splits, "ground returns", console)
    result = {"ground": kept}
    if not quick:
        every = [compare_heights(load(ground_only=False), seed) for seed in range(splits)]
        result["every class"] = show_heights(every, "returns of every class", console)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(result, indent=1), encoding="utf-8")
    if out is not None:
        draw(*drawn, out / "airborne.png")


if __name__ == "__main__":
    main()
