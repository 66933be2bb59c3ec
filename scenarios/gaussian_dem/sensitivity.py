"""Study the prior of the Gaussian DEM, and hazards missed from 1000 m.

    python scenarios/gaussian_dem/sensitivity.py --study field --seeds 4 --out out/gaussian_dem
    python scenarios/gaussian_dem/sensitivity.py --study misses --seeds 8

The tables are those of the Gaussian DEM paper. `field` sweeps sigma_f^2 / length_scale, the only
hyper-parameter combination that scans can identify, for both tables. `misses` changes one
property of the scans from 1000 m at a time.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
from computed import negative_log_density, rms, truth_of
from paper import PAPER_5, PAPER_6
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree
from testbed import (
    CONFIGURATIONS,
    DENSITY,
    LANDER,
    MARGIN,
    ScannedDem,
    TestbedField,
    map_testbed,
    testbed,
)

from lunarsim.campaign.pool import collect_results
from lunarsim.console import plain_console
from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.statistics import mean_interval
from lunarsim.safety import stochastic_safety
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.viz.style import COLOURS, new_figure, save

LENGTH = 30.0  # m; only the ratio sigma_f^2 / length_scale has an effect
# sigma_f^2 / length_scale, m; includes the values of both tables.
GROWTHS = np.sort(np.append(np.geomspace(1e-5, 1e-1, 17), MARGIN["sigma_f"] ** 2 / LENGTH))
METRICS = ("rmse", "nlpd", "beyond", "precision slope", "precision roughness", "recall slope",
           "recall roughness")  # fmt: skip


def growth(setting: dict[str, float]) -> float:
    """Return sigma_f^2 / length_scale, m, of a random field prior.

    It is the rate at which the height variance grows with distance.
    `setting` holds `sigma_f` and `length_scale` (m).
    """
    return setting["sigma_f"] ** 2 / setting["length_scale"]


# --- the random field ---------------------------------------------------------------------


def map_metrics(field: TestbedField, scanned: ScannedDem) -> dict[str, float]:
    """Return errors, precision and recall of one Gaussian DEM (keys: `METRICS`).

    `field` is the simulated testbed and `scanned` a scan of it. The metrics are those of Tables 5
    and 6 of the Gaussian DEM paper; "nlpd" is the negative log predictive density and "beyond" the
    fraction of errors above 3 sigma.
    """
    inside = np.isfinite(scanned.dem.mean)
    error = (scanned.dem.mean - field.elevation[scanned.window])[inside].astype(float)
    variance = scanned.dem.variance[inside].astype(float)
    safety = stochastic_safety(scanned.dem.mean, scanned.dem.variance, scanned.grid, LANDER)
    seen = safety.observed & field.safety.observed[scanned.window]
    truth = truth_of(field, scanned)
    slope = MapQuality.of(safety.p_slope[seen] > 0.5, truth["slope"][seen])
    roughness = MapQuality.of(safety.p_roughness[seen] > 0.5, truth["roughness"][seen])
    beyond = float((np.abs(error) > 3.0 * np.sqrt(variance)).mean())
    nlpd = negative_log_density(error, variance)
    values = (rms(error), nlpd, beyond, slope.precision, roughness.precision, slope.recall,
              roughness.recall)  # fmt: skip
    return dict(zip(METRICS, values, strict=True))


def sweep_testbed(seed: int) -> list[list[list[float]]]:
    """Return the map metrics of one testbed by prior, scan configuration and metric.

    The result has the order of `GROWTHS`, `CONFIGURATIONS` and `METRICS`.
    """
    own = testbed(seed)
    out = []
    for g in GROWTHS:
        rows = []
        for n, (distance, angle) in enumerate(CONFIGURATIONS):
            rng = np.random.default_rng([seed, n])
            setting = {"sigma_f": float(np.sqrt(g * LENGTH)), "length_scale": LENGTH}
            rows.append(
                list(map_metrics(own, map_testbed(own, distance, angle, rng, **setting)).values())
            )
        out.append(rows)
    return out


def count_scans_as_published(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Count for each prior the scans whose metric is at least as good as in the paper.

    `values` holds each metric (priors of `GROWTHS`, 9 scan configurations) by name. The counts
    (0 to 9) are by metric and prior.
    """
    five, six = np.array(PAPER_5), np.array(PAPER_6)
    rounded = {name: np.round(v, 4) for name, v in values.items()}
    return {
        "RMSE": (rounded["rmse"] <= five[:, 1]).sum(axis=1),
        "NLPD": (rounded["nlpd"] <= five[:, 3]).sum(axis=1),
        "precision slope": (rounded["precision slope"] >= six[:, 1]).sum(axis=1),
        "precision roughness": (rounded["precision roughness"] >= six[:, 3]).sum(axis=1),
        "recall slope": (rounded["recall slope"] >= six[:, 5]).sum(axis=1),
        "recall roughness": (rounded["recall roughness"] >= six[:, 7]).sum(axis=1),
    }


def show_prior_sweep(results: list[Any], console: Console) -> dict[str, Any]:
    """Print the metrics for each random field prior; return their means.

    `results` are the values of `sweep_testbed`, one per testbed. Returns the means (prior, scan
    configuration) by name of the metric.
    """
    mean = np.mean(np.array(results, dtype=float), axis=0)
    values = {name: mean[:, :, i] for i, name in enumerate(METRICS)}
    rows = count_scans_as_published(values)
    table = Table(
        title=f"Random field for both tables, {len(results)} testbeds: number of the nine rows "
        "at the value of the paper or better"
    )
    for heading in ("sigma_f^2 /\nlength (m)", *(name.replace(" ", "\n") for name in rows),
                    "mean\nNLPD", "beyond 3 sigma,\nmax fraction", "precision of\nroughness, min",
                    "recall of\nroughness, mean"):  # fmt: skip
        table.add_column(heading, justify="right")
    for i, g in enumerate(GROWTHS):
        least = values["precision roughness"][i].min()
        table.add_row(
            f"{g:.1e}", *(str(n[i]) for n in rows.values()), f"{values['nlpd'][i].mean():.3f}",
            f"{values['beyond'][i].max():.4f}", "-" if np.isnan(least) else f"{least:.4f}",
            f"{values['recall roughness'][i].mean():.4f}",
        )  # fmt: skip
    console.print(table)
    show_best_prior(values, rows, console)
    least = GROWTHS[values["nlpd"].argmin(axis=0)]
    console.print("The minimum NLPD is at: " + ", ".join(
        f"{g:.0e} ({r:.0f} m, {a:.0f} deg)"
        for g, (r, a) in zip(least, CONFIGURATIONS, strict=True)
    ))  # fmt: skip
    return {name: v.tolist() for name, v in values.items()}


def show_best_prior(
    values: dict[str, np.ndarray], scan_counts: dict[str, np.ndarray], console: Console
) -> None:
    """Print the priors of Tables 5 and 6 beside the one that serves both tables best.

    It has the largest sigma_f^2 / length_scale among those with the maximum number of scans that
    reach the negative log predictive density (NLPD) of the paper or a lower one. `values` are
    metrics (prior, configuration) by name; `scan_counts` the result of `count_scans_as_published`.
    """
    most = np.flatnonzero(scan_counts["NLPD"] == scan_counts["NLPD"].max())
    own = {"Table 5": growth(DENSITY), "both": GROWTHS[most[-1]], "Table 6": growth(MARGIN)}
    table = Table(
        title="sigma_f^2 / length: " + ", ".join(f"{n} {g:.1e} m" for n, g in own.items())
    )
    names = {"NLPD": "nlpd", "precision of roughness": "precision roughness",
             "recall of roughness": "recall roughness"}  # fmt: skip
    for heading in (
        "range\n(m)",
        "angle\n(deg)",
        *(f"{n}: paper\n{', '.join(own)}" for n in names),
    ):
        table.add_column(heading, justify="right")
    index = [int(np.abs(np.log(GROWTHS / g)).argmin()) for g in own.values()]
    for n, (distance, angle) in enumerate(CONFIGURATIONS):
        paper = (PAPER_5[n][3], PAPER_6[n][3], PAPER_6[n][7])
        cells = [
            f"{p:.4f}: " + ", ".join(f"{values[name][i, n]:.4f}" for i in index)
            for p, name in zip(paper, names.values(), strict=True)
        ]
        table.add_row(f"{distance:.0f}", f"{angle:.0f}", *cells)
    console.print(table)


def draw_prior_sweep(values: dict[str, Any], path: Path) -> None:
    """Plot error, density, precision and recall against sigma_f^2 / length_scale.

    `values` are metrics (prior, configuration) by name; `path` is the output file.
    """
    figure = new_figure(9.6, 7.2)
    panels = figure.subplots(2, 2, sharex=True)
    names = ("rmse", "nlpd", "precision roughness", "recall roughness")
    labels = ("RMSE (m)", "NLPD", "Precision of roughness, p > 0.5",
              "Recall of roughness, p > 0.5")  # fmt: skip
    for panel, name, label in zip(panels.ravel(), names, labels, strict=True):
        for n, (distance, angle) in enumerate(CONFIGURATIONS):
            panel.plot(
                GROWTHS, np.array(values[name])[:, n], color=COLOURS[n // 3],
                ls=("-", "--", ":")[n % 3], label=f"{distance:.0f} m, {angle:.0f} deg",
            )  # fmt: skip
        for setting, text in ((DENSITY, "Table 5"), (MARGIN, "Table 6")):
            panel.axvline(growth(setting), color="#999999", lw=1)
            panel.annotate(
                text, (growth(setting), 1.0), (2, -3), xycoords=panel.get_xaxis_transform(),
                textcoords="offset points", fontsize=7, va="top", rotation=90,
            )  # fmt: skip
        panel.set_xscale("log")
        panel.set_ylabel(label)
        panel.grid(alpha=0.3)
    for panel in panels[1]:
        panel.set_xlabel("sigma_f^2 / length scale (m)")
    handles, texts = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, texts, loc="outside lower center", ncols=5)
    save(figure, path)


# --- missed hazards from 1000 m -----------------------------------------------------------


@dataclass(frozen=True)
class ScanVariant:
    """One changed property of the testbed scans from 1000 m.

    `testbed_changes` and `lidar_changes` are changed arguments of `testbed` and `FlashLidar`;
    `growth` is sigma_f^2 / length_scale of the prior, m; `assumed_sigma` is the standard deviation
    of a return that the DEM assumes, m (None: the true one).
    """

    name: str
    testbed_changes: dict[str, Any] = field(default_factory=dict)
    lidar_changes: dict[str, Any] = field(default_factory=dict)
    growth: float = growth(MARGIN)
    assumed_sigma: float | None = (
        None  # assumed standard deviation of a return, m; None: the true one
    )


VARIANTS = (
    ScanVariant("as in Table 6"),
    ScanVariant("no noise", lidar_changes={"noise_ratio": 0.0}),
    ScanVariant(
        "no noise, its sigma stated", lidar_changes={"noise_ratio": 0.0}, assumed_sigma=0.1 / 3.0
    ),
    ScanVariant("half the spacing", lidar_changes={"rows": 512, "cols": 512}),
    ScanVariant("twice the spacing", lidar_changes={"rows": 128, "cols": 128}),
    ScanVariant("1.5 x sigma_f^2 / length", growth=1.5 * growth(MARGIN)),
    ScanVariant("rocks of 0.8 m", testbed_changes={"diameter": 0.8}),
    ScanVariant("rocks of 1.5 m", testbed_changes={"diameter": 1.5}),
    ScanVariant("250 rocks", testbed_changes={"rocks": 250}),
    ScanVariant("1000 rocks", testbed_changes={"rocks": 1000}),
)


@dataclass(frozen=True)
class MissedSites:
    """Unsafe sites of one map, with or without a high LiDAR return nearby.

    Attributes
    ----------
    quality
        Precision and recall of the map over all sites.
    seen, unseen
        Unsafe sites with and without a LiDAR return above the roughness limit nearby: number of
        them called safe, and total number.
    """

    quality: MapQuality
    seen: tuple[int, int]
    unseen: tuple[int, int]


def count_missed_sites(task: tuple[int, int]) -> list[MissedSites]:
    """Count unsafe sites called safe in one testbed, for each of three scan angles.

    `task` is the index of the scan variant in `VARIANTS` and the seed of the testbed.
    """
    index, seed = task
    variant = VARIANTS[index]
    own = testbed(seed, **variant.testbed_changes)
    out = []
    for n, (distance, angle) in enumerate(CONFIGURATIONS[-3:]):
        rng = np.random.default_rng([seed, n])
        setting = {"sigma_f": float(np.sqrt(variant.growth * LENGTH)), "length_scale": LENGTH}
        lidar = FlashLidar(**variant.lidar_changes)
        one = map_testbed(
            own, distance, angle, rng, lidar=lidar, assumed_sigma=variant.assumed_sigma, **setting
        )
        safety = stochastic_safety(one.dem.mean, one.dem.variance, one.grid, LANDER)
        use = safety.observed & own.safety.observed[one.window]
        called = safety.p_roughness[use] > 0.5
        safe = truth_of(own, one)["roughness"][use]
        # The plane of the testbed is at height 0: a return above the limit comes from a rock.
        high = one.points[one.points[:, 2] > LANDER.roughness_limit, :2]
        away, _ = cKDTree(high).query(one.grid.centres()[use][~safe])
        shown = away < LANDER.leg_radius
        wrong = called[~safe]
        out.append(
            MissedSites(
                MapQuality.of(called, safe),
                (int(wrong[shown].sum()), int(shown.sum())),
                (int(wrong[~shown].sum()), int((~shown).sum())),
            )
        )
    return out


def fraction(part: int, total: int) -> float:
    """Return `part / total`; NaN if `total` is zero."""
    return float(part / total) if total else float("nan")


def show_misses(results: list[list[MissedSites]], seeds: int, console: Console) -> list[Any]:
    """Print the missed hazards of each scan variant and angle over all testbeds.

    `results` are the values of `count_missed_sites` for all variants and `seeds` testbeds each.
    Returns the printed table as a list of dictionaries.
    """
    table = Table(
        title=f"Roughness safety from 1000 m at p > 0.5, {seeds} testbeds, 95 % intervals"
    )
    for heading in ("angle\n(deg)", "scans", "truly unsafe\n(fraction)", "precision", "recall",
                    "unsafe sites\ncalled safe", "of these, without a\nreturn above the limit",
                    "called safe, with a\nreturn above the limit",
                    "called safe, without\nsuch a return"):  # fmt: skip
        table.add_column(heading, justify="right")
    rows = []
    for n, (_, angle) in enumerate(CONFIGURATIONS[-3:]):
        for index, variant in enumerate(VARIANTS):
            own = [results[index * seeds + s][n] for s in range(seeds)]
            precision = mean_interval([m.quality.precision for m in own])
            recall = mean_interval([m.quality.recall for m in own])
            unsafe = float(np.mean([1.0 - m.quality.safe_share for m in own]))
            seen, unseen = (
                np.sum([getattr(m, k) for m in own], axis=0) for k in ("seen", "unseen")
            )
            wrong, all_unsafe = seen[0] + unseen[0], seen[1] + unseen[1]
            row = {
                "unsafe": unsafe, "precision": precision.mean, "recall": recall.mean,
                "called_safe": fraction(wrong, all_unsafe),
                "unseen_of_called": fraction(unseen[0], wrong),
                "seen_called_safe": fraction(*seen), "unseen_called_safe": fraction(*unseen),
            }  # fmt: skip
            rows.append({"angle": angle, "scans": variant.name} | row)
            table.add_row(
                f"{angle:.0f}" if index == 0 else "", variant.name, f"{unsafe:.3f}",
                precision.text(), recall.text(),
                *("-" if np.isnan(v) else f"{v:.4f}" for v in list(row.values())[3:]),
            )  # fmt: skip
    console.print(table)
    return rows


@click.command()
@click.option("--study", type=click.Choice(["field", "misses", "all"]), default="all",
              show_default=True,
              help="Study to run: field (prior of the terrain), misses (hazards missed from 1000 "
              "m) or all.")  # fmt: skip
@click.option("--seeds", type=click.IntRange(min=1), default=4, show_default=True,
              help="Number of simulated test fields, with one random seed each.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of parallel processes; it does not change the results.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for all results. Default: none.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure. Default: no figure.")  # fmt: skip
def main(study: str, seeds: int, jobs: int, json_file: Path | None, out: Path | None) -> None:
    """Study the prior (`field`) and hazards missed from 1000 m (`misses`)."""
    console = plain_console(190)
    kept: dict[str, Any] = {}
    if study in {"field", "all"}:
        results = collect_results(sweep_testbed, range(seeds), jobs, console, "testbeds")
        kept["field"] = show_prior_sweep(results, console) | {"growth": GROWTHS.tolist()}
        if out is not None:
            draw_prior_sweep(kept["field"], out / "random_field.png")
    if study in {"misses", "all"}:
        tasks = [(v, s) for v in range(len(VARIANTS)) for s in range(seeds)]
        results = collect_results(count_missed_sites, tasks, jobs, console, "variants and testbeds")
        if len(results) < len(tasks):
            raise click.Abort
        kept["misses"] = show_misses(results, seeds, console)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(kept, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
