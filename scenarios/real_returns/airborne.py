"""Both LiDAR maps on real returns: part of an airborne cloud is mapped, the rest judges.

    python scenarios/real_returns/airborne.py --splits 4 --out out/real_returns

Heights: one random half of the ground returns is mapped at 0.25 m, the other half tells the error.
Safety: a lander is scaled so that the mapped returns are as far apart, over its footprint, as those
of one scan from 1000 m; the exact test on the surface through the returns held back judges p_safe.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
from figures import draw
from judging import Heights, Verdicts, judge_heights, judge_safety, scores, strata_of
from returns import SLOPE_LIMIT_DEG, STRATA, Cloud, load
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lunarsim.console import plain_console
from lunarsim.evaluation.statistics import mean_interval

SHARES = (0.5, 0.1)  # of the returns that are mapped where safety is judged


def pooled(maps: list[Heights]) -> Heights:
    """Return the errors of all splits together."""
    names = ("error", "sigma", "stratum", "xy")
    return Heights(*(np.concatenate([getattr(m, name) for m in maps]) for name in names))


def together(verdicts: list[Verdicts]) -> Verdicts:
    """Return the sites of all splits together, with the means of the shares."""
    first = verdicts[0]
    means = (
        float(np.mean([getattr(v, name) for v in verdicts]))
        for name in ("agreement", "dense_share", "held_share")
    )
    return Verdicts(
        {m: np.concatenate([v.p[m] for v in verdicts]) for m in first.p},
        np.concatenate([v.safe for v in verdicts]),
        np.concatenate([v.stratum for v in verdicts]),
        *means,
        first.scale,
        first.pictures,
    )


def show_heights(results: list[dict[str, Heights]], title: str, console: Console) -> dict[str, Any]:
    """Print errors by map and stratum; return them."""
    table = Table(title=f"Height at the returns held back, {len(results)} splits, {title}")
    for heading in ("map", "slope", "returns", "bias m", "RMSE m", "normalised square (1)",
                    "beyond 2 sigma (0.046)", "beyond 3 sigma (0.003)"):  # fmt: skip
        table.add_column(heading, justify="right")
    kept: dict[str, Any] = {}
    for name in results[0]:
        every = pooled([r[name] for r in results])
        own = [r[name].figures() for r in results]
        rows = [("all", every.figures())]
        rows += [(label, every.figures(k)) for k, label in enumerate(STRATA)]
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


def show_safety(verdicts: Verdicts, share: float, console: Console) -> dict[str, Any]:
    """Print how well p_safe does; return it."""
    console.print(
        f"{share:.2f} of the returns mapped; lander {verdicts.scale:.2f} times as large, limit "
        f"{SLOPE_LIMIT_DEG:.0f} deg. The exact verdicts on mapped returns and on those held back "
        f"agree at {verdicts.agreement:.3f} of the sites; safe on all returns "
        f"{verdicts.dense_share:.3f}, on those held back {verdicts.held_share:.3f}"
    )
    table = Table(title=f"p_safe against the verdict of the returns held back, {share:.2f} mapped")
    for heading in ("map", "slope", "sites", "share safe", "mean p", "ECE", "Brier skill",
                    "precision, p > 0.5", "recall", "share safe, p > 0.95"):  # fmt: skip
        table.add_column(heading, justify="right")
    kept: dict[str, Any] = {}
    for name in verdicts.p:
        rows = [("all", scores(verdicts.p[name], verdicts.safe))]
        rows += list(zip(STRATA, strata_of(verdicts, name), strict=True))
        kept[name] = dict(rows)
        for label, s in rows:
            table.add_row(
                name if label == "all" else "", label, f"{s['n']}",
                *(f"{s[k]:.3f}" for k in ("share", "mean_p", "ece", "skill", "precision", "recall",
                                          "above")),
            )  # fmt: skip
    console.print(table)
    return kept


def study(cloud: Cloud, splits: int, title: str, console: Console) -> tuple[dict[str, Any], Any]:
    """Judge heights and safety on some random splits; return all figures and what is drawn."""
    heights = [
        judge_heights(cloud, seed) for seed in track(range(splits), description=f"heights, {title}")
    ]
    kept: dict[str, Any] = {"heights": show_heights(heights, title, console), "safety": {}}
    safety = {}
    for share in SHARES:
        name = f"safety, {share:.2f} mapped, {title}"
        runs = [judge_safety(cloud, share, seed) for seed in track(range(splits), description=name)]
        safety[share] = together(runs)
        kept["safety"][str(share)] = show_safety(safety[share], share, console)
    return kept, (heights[0], {name: pooled([h[name] for h in heights]) for name in heights[0]},
                  safety)  # fmt: skip


@click.command()
@click.option("--splits", type=click.IntRange(min=1), default=4, show_default=True,
              help="Random splits of the returns.")  # fmt: skip
@click.option("--quick", is_flag=True,
              help="Only what lies within 24 m of the middle, and ground alone.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write all figures to this file.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure.")  # fmt: skip
def main(splits: int, quick: bool, json_file: Path | None, out: Path | None) -> None:
    """Map real returns with both LiDAR mappers and judge by returns held back."""
    console = plain_console(170)
    limit = 24.0 if quick else None
    kept, drawn = study(load(limit=limit), splits, "ground returns", console)
    result = {"ground": kept}
    if not quick:
        every = [judge_heights(load(ground_only=False), seed) for seed in range(splits)]
        result["every class"] = show_heights(every, "returns of every class", console)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(result, indent=1), encoding="utf-8")
    if out is not None:
        draw(*drawn, out / "airborne.png")


if __name__ == "__main__":
    main()
