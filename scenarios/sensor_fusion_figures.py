"""Compute and plot the map metrics of the all-sensor study."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from sensor_fusion_flights import LARGE, MAPS, ROWS, SINGLE

from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import calibration_error
from lunarsim.evaluation.statistics import mean_interval

Counts = dict[str, Any]
Flight = dict[str, Any]

PRECISION = 0.99
# Aims: recall loss of the fused map relative to the best single map, and relative to the remaining
# sensor after a failure; ratio of large-rock area called safe to that of the LiDAR map, at 1000 m.
LESS_THAN_BEST, LESS_THAN_LEFT, OF_LARGE, FROM = 0.01, 0.02, 0.5, "1000"
COLOURS = {
    "dem": "tab:blue", "quadtree": "tab:cyan", "rocks": "tab:orange", "alone": "tab:blue",
    "fused": "black",
}  # fmt: skip


def pooled_recall(evaluated: list[Counts]) -> float:
    """Return the recall of several maps together at precision `PRECISION` (0.99).

    `evaluated` holds the site counts of each map.
    """
    return pooled_curve(evaluated).recall_at(PRECISION)


def pooled_curve(evaluated: list[Counts]) -> PrecisionRecall:
    """Return the precision-recall curve of the summed site counts of several maps."""
    return PrecisionRecall(*(_sum_counts(evaluated, name) for name in ("unsafe", "safe")))


def _sum_counts(evaluated: list[Counts], name: str) -> np.ndarray:
    """Sum one kind of counts (key `name`) over several maps."""
    return np.asarray(np.sum([j[name] for j in evaluated], axis=0))


def map_metrics(evaluated: list[Counts]) -> dict[str, float]:
    """Return the quality metrics of one mapper's maps, pooled over the fields.

    `evaluated` holds the site counts of each field. A hazard counts as missed if its p_safe
    exceeds 0.5.
    """
    curve = pooled_curve(evaluated)
    quality: MapQuality = curve.at_half()
    unsafe = quality.false_safe + quality.rejected
    objects, missed = _sum_counts(evaluated, "objects")
    n, good, squares = _sum_counts(evaluated, "squares")
    base = good / n if n else float("nan")
    spread = base * (1.0 - base)
    return {
        "precision": quality.precision,
        "recall": quality.recall,
        "recall_at_precision": curve.recall_at(PRECISION),
        "missed_hazard": quality.false_safe / unsafe if unsafe else float("nan"),
        "missed_objects": missed / objects if objects else float("nan"),
        "ece": calibration_error(_sum_counts(evaluated, "table")),
        "skill": 1.0 - squares / n / spread if n and spread > 0.0 else float("nan"),
        "claimed": n / max(quality.evaluated, 1),
        "observed": float(np.mean([j["observed"] for j in evaluated])),
    }


def large_rock_fraction(evaluated: list[Counts], recall: float) -> float:
    """Return the fraction of terrain called safe with a large rock underneath.

    Terrain is called safe at the highest threshold of p_safe that reaches `recall`. NaN if none
    does or if `recall` is zero. `evaluated` holds the site counts of each field.
    """
    curve, large = pooled_curve(evaluated), _sum_counts(evaluated, "large")
    found = np.cumsum(curve.safe[::-1])
    called = found + np.cumsum(curve.unsafe[::-1])
    enough = np.flatnonzero(found >= recall * max(found[-1], 1.0))
    if not (recall > 0.0 and len(enough)):
        return float("nan")
    first = int(enough[0])
    return float(np.cumsum(large[::-1])[first] / called[first])


def best_single(flights: list[Flight], altitude: str) -> str:
    """Return the single-mapper map with the highest recall at precision 0.99.

    The flights are pooled; `altitude` is the text of the evaluation altitude (m).
    """
    of = {n: pooled_recall([f["maps"][altitude][n] for f in flights]) for n in SINGLE}
    return max(of, key=lambda name: of[name])


def recall_gains(flights: list[Flight], altitude: str, other_map: str) -> list[float]:
    """Return the recall of the fused map minus that of map `other_map`, per field.

    Recall is at precision 0.99; `altitude` is the text of the evaluation altitude (m).
    """
    pairs = ((f["maps"][altitude]["fused"], f["maps"][altitude][other_map]) for f in flights)
    return [pooled_recall([a]) - pooled_recall([b]) for a, b in pairs]


@dataclass(frozen=True)
class FusedMapComparison:
    """The fused map compared with others at one altitude of one study condition (row).

    Attributes
    ----------
    row, altitude
        Name of the study condition and altitude (m).
    best, gain
        Best single map; recall of the fused map minus that of the best one, per field.
    gain_over_dem_only
        Recall gain over a fused map whose only input is the Gaussian DEM, per field.
    gain_over_remaining
        Recall gain over the map of the remaining sensor, per field; empty if none has failed.
    large_dem, large_fused
        Fraction of the terrain called safe that has a large rock under the lander, for Gaussian DEM
        and fused map at equal recall (that of the Gaussian DEM at p > 0.5).
    """

    row: str
    altitude: str
    best: str
    gain: list[float]
    gain_over_dem_only: list[float]
    gain_over_remaining: list[float]
    large_dem: float
    large_fused: float

    @property
    def unmet_requirements(self) -> list[str]:
        """Names of the study requirements that are not met; empty if all are met."""
        out = []
        if np.mean(self.gain) < -LESS_THAN_BEST:
            out.append(f"worse than {MAPS[self.best]}")
        if self.gain_over_remaining and np.mean(self.gain_over_remaining) < -LESS_THAN_LEFT:
            out.append("worse than the remaining sensor")
        if self.altitude == FROM and self.large_fused > OF_LARGE * self.large_dem:
            out.append("large hazards")
        return out


def comparisons(flights: list[Flight], failure_altitude: float) -> list[FusedMapComparison]:
    """Compare the fused map with the others for each study condition and altitude.

    `failure_altitude` is the altitude (m) below which failed sensors stop.
    """
    out = []
    for row, mine in by_row(flights).items():
        left = ROWS[row].remaining_map if row in ROWS else ""
        for altitude in common_altitudes(mine):
            best = best_single(mine, altitude)
            failed = left and float(altitude) < failure_altitude
            dem, fused = ([f["maps"][altitude][n] for f in mine] for n in ("dem", "fused"))
            recall = pooled_curve(dem).at_half().recall
            out.append(
                FusedMapComparison(
                    row, altitude, best,
                    recall_gains(mine, altitude, best), recall_gains(mine, altitude, "alone"),
                    recall_gains(mine, altitude, left) if failed else [],
                    large_rock_fraction(dem, recall), large_rock_fraction(fused, recall),
                )
            )  # fmt: skip
    return out


def by_row(flights: list[Flight]) -> dict[str, list[Flight]]:
    """Group flights by study condition (row), in their order."""
    rows = dict.fromkeys(f["row"] for f in flights)
    return {row: [f for f in flights if f["row"] == row] for row in rows}


def common_altitudes(flights: list[Flight]) -> list[str]:
    """Return the altitudes at which all flights were evaluated."""
    return [a for a in flights[0]["maps"] if all(a in f["maps"] for f in flights)]


# --- tables and figures -----------------------------------------------------------------------

_COLUMNS = {
    "precision": "precision", "recall": "recall",
    "recall_at_precision": f"recall at {PRECISION}", "missed_hazard": "hazards missed",
    "missed_objects": "objects missed", "ece": "ECE", "skill": "skill", "claimed": "claimed",
    "observed": "observed",
}  # fmt: skip


def show(flights: list[Flight], failure_altitude: float, console: Console) -> None:
    """Print the map metrics and the fused map comparison by condition and altitude.

    `failure_altitude` is the altitude (m) below which failed sensors stop.
    """
    for row, mine in by_row(flights).items():
        caption = f"All fields pooled; per field: mean recall at precision {PRECISION}"
        table = Table(title=f"{row}: {len(mine)} fields", caption=caption)
        table.add_column("altitude (m)", justify="right")
        table.add_column("map")
        for heading in (*_COLUMNS.values(), "per field"):
            table.add_column(heading, justify="right")
        for altitude in common_altitudes(mine):
            for name, words in MAPS.items():
                maps = [one["maps"][altitude][name] for one in mine]
                f, each = map_metrics(maps), np.mean([pooled_recall([one]) for one in maps])
                cells = (f"{f[key]:.3f}" for key in _COLUMNS)
                table.add_row(altitude, words, *cells, f"{each:.3f}")
        console.print(table)
        spent = {n: float(np.median([one["ms"][n] for one in mine])) for n in MAPS}
        words = ", ".join(f"{MAPS[n]} {ms:.0f}" for n, ms in spent.items())
        console.print(f"Computing time per map, median (ms): {words}")
        refused: dict[str, int] = {}
        for flight in mine:
            for why, count in flight["refused"].items():
                refused[why] = refused.get(why, 0) + count
        counts_text = ", ".join(f"{why} {count}" for why, count in sorted(refused.items()))
        console.print(f"Rejected images: {counts_text or 'none'}")
    _show_comparison(comparisons(flights, failure_altitude), console)


def _show_comparison(rows: list[FusedMapComparison], console: Console) -> None:
    """Print how much recall the fused map gains over the other maps."""
    table = Table(
        title=f"Recall of the fused map minus others, at precision {PRECISION}, per field"
    )
    for heading in (
        "row", "altitude (m)", "best single", "minus best single", "minus DEM only",
        "minus remaining sensor",
        f"rocks over {LARGE} m: DEM", "fused", "aims not met",
    ):  # fmt: skip
        table.add_column(heading)
    for c in rows:
        table.add_row(
            c.row, c.altitude, MAPS[c.best],
            mean_interval(c.gain).text(3), mean_interval(c.gain_over_dem_only).text(3),
            mean_interval(c.gain_over_remaining).text(3) if c.gain_over_remaining else "",
            f"{c.large_dem:.4f}", f"{c.large_fused:.4f}", ", ".join(c.unmet_requirements),
        )  # fmt: skip
    console.print(table)
    for words, gains in (
        ("the best single", [c.gain for c in rows]),
        (MAPS["alone"], [c.gain_over_dem_only for c in rows]),
    ):  # fmt: skip
        means = [float(np.mean(gain)) for gain in gains]
        console.print(
            f"Mean over rows and altitudes, fused minus {words}: {np.mean(means):+.3f}; "
            f"minimum {min(means):+.3f}"
        )


def draw(flights: list[Flight], path: Path) -> None:
    """Plot the recall of each map against altitude, one panel per study condition."""
    from matplotlib import pyplot as plt

    rows = by_row(flights)
    wide = min(len(rows) // 2 + 1, 5)  # two rows of panels, with a place for the legend
    high = -(-len(rows) // wide)
    figure, axes = plt.subplots(
        high, wide, figsize=(3.0 * wide + 0.6, 3.2 * high), sharey=True, squeeze=False
    )
    for axis in axes.flat[len(rows) :]:
        axis.set_visible(False)
    for axis, (row, mine) in zip(axes.flat, rows.items(), strict=False):
        altitudes = common_altitudes(mine)
        for name, words in MAPS.items():
            found = [pooled_recall([f["maps"][a][name] for f in mine]) for a in altitudes]
            axis.plot(
                range(len(altitudes)), found, "o--" if name == "alone" else "o-",
                color=COLOURS[name], label=words,
                lw=2.6 if name == "fused" else 1.4, zorder=3 if name == "fused" else 2,
            )  # fmt: skip
        axis.set_xticks(range(len(altitudes)), altitudes)
        axis.set_title(row, fontsize=10)
        axis.set_xlabel("Altitude (m)")
        axis.set_ylim(-0.03, 1.03)
        axis.grid(alpha=0.3)
    for axis in axes[:, 0]:
        axis.set_ylabel("Recall at precision 0.99")
    lines, words = axes.flat[0].get_legend_handles_labels()
    if len(rows) < axes.size:
        axes.flat[len(rows)].set_visible(True)
        axes.flat[len(rows)].axis("off")
        axes.flat[len(rows)].legend(lines, words, fontsize=10, loc="center")
    else:
        axes.flat[-1].legend(lines, words, fontsize=8, loc="best")
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)
