"""Study the random field prior of the Gaussian DEM.

The study sweeps sigma_f^2 / length_scale, the only hyper-parameter combination that scans can
identify, for Tables 5 and 6 of the Gaussian DEM paper.

python scenarios/gaussian_dem/prior_sweep.py --fields 4 --out out/gaussian_dem
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from computed import negative_log_density, rms, truth_of
from paper import PAPER_5, PAPER_6
from rich.table import Table
from testbed import (
    CONFIGURATIONS,
    DENSITY,
    LANDER,
    MARGIN,
    ScannedDem,
    TestbedField,
    growth,
    map_testbed,
    prior_of_growth,
    testbed,
)

from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.safety import stochastic_safety
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.viz.style import COLOURS, new_figure, save

# sigma_f^2 / length_scale, m; includes the values of both tables.
GROWTHS = np.sort(np.append(np.geomspace(1e-5, 1e-1, 17), growth(MARGIN)))
METRICS = ("rmse", "nlpd", "beyond", "precision slope", "precision roughness", "recall slope",
           "recall roughness")  # fmt: skip


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


def sweep_testbed(case: Case) -> list[dict[str, Any]]:
    """Return the map metrics of one testbed, a row per prior and scan configuration."""
    seed = case.seed + case.number
    own = testbed(seed)
    rows = []
    for g in GROWTHS:
        for n, (distance, angle) in enumerate(CONFIGURATIONS):
            rng = np.random.default_rng([seed, n])
            metrics = map_metrics(own, map_testbed(own, distance, angle, rng, **prior_of_growth(g)))
            rows.append({"growth": g, "distance_m": distance, "angle_deg": angle, **metrics})
    return rows


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


def print_prior_sweep(report: Report) -> None:
    """Print and plot the metrics for each random field prior."""
    shape = (-1, len(GROWTHS), len(CONFIGURATIONS))
    values = {name: report.column(name).reshape(shape).mean(axis=0) for name in METRICS}
    count = len(report.groups("number"))
    rows = count_scans_as_published(values)
    table = Table(
        title=f"Random field for both tables, {count} testbeds: number of the nine rows "
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
    report.print(table)
    print_best_prior(values, rows, report)
    least = GROWTHS[values["nlpd"].argmin(axis=0)]
    report.print("The minimum NLPD is at: " + ", ".join(
        f"{g:.0e} ({r:.0f} m, {a:.0f} deg)"
        for g, (r, a) in zip(least, CONFIGURATIONS, strict=True)
    ))  # fmt: skip
    if report.out is not None:
        draw_prior_sweep(values, report.out / "random_field.png")


def print_best_prior(
    values: dict[str, np.ndarray], scan_counts: dict[str, np.ndarray], report: Report
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
    report.print(table)


def draw_prior_sweep(values: dict[str, np.ndarray], path: Path) -> None:
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
                GROWTHS, values[name][:, n], color=COLOURS[n // 3],
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


study = Study(sweep_testbed, repeats="fields", count=4, seed=0, report=print_prior_sweep)

if __name__ == "__main__":
    run_script(study)
