"""Reproduce the tables of the Gaussian DEM paper next to the published values.

Tomita and Ho, "Real-Time Stochastic Terrain Mapping and Processing for Autonomous Safe Landing".
The figures are those of the first field.

python scenarios/gaussian_dem/tables.py --table 3 --fields 2
python scenarios/gaussian_dem/tables.py --fields 20 --figures --out out/gaussian_dem
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from computed import (
    HALF_PHASES,
    KINDS,
    METHODS,
    PHASES,
    Rows,
    pool_counts,
    table_3,
    table_4,
    table_5,
    table_6,
    table_7,
)
from figures import (
    draw_conservativeness,
    draw_panels,
    draw_precision_recall,
    draw_profiles,
    draw_reliability,
    draw_testbed,
    draw_truth,
)
from paper import PAPER_4, PAPER_5, PAPER_6, PAPER_7
from rich.table import Table
from testbed import (
    CONFIGURATIONS,
    DENSITY,
    LANDER,
    MARGIN,
    testbed,
)

from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import calibration_error
from lunarsim.evaluation.statistics import mean_interval
from lunarsim.studies import Case, Report, Study, run_script

TABLES = {"3": table_3, "4": table_4, "5": table_5, "6": table_6, "7": table_7}
SAME_FOR_ALL_FIELDS = ("4", "7")


def compute(case: Case) -> Rows:
    """Compute the rows of one table for one field."""
    if case["table"] in SAME_FOR_ALL_FIELDS and case.number > 0:
        return []
    return TABLES[case["table"]](case.seed + case.number)[0]


def print_3(report: Report) -> None:
    """Print computed and published recall of the conservative safety test (Table 3)."""
    table = Table(title="Table 3: conservative test on Eq. 20 terrain (HiRISE crop)")
    headings = ("c", "precision", "paper", "false-safe cells, both tests", "recall", "paper",
                "difference", "recall of bounded_safety")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for (c,), rows in report.groups("c").items():
        precision, recall, bounded, false_safe = (
            report.column(name, rows) for name in ("precision", "recall", "bounded", "false_safe")
        )
        paper = rows[0]["paper"]
        table.add_row(
            str(c), f"{precision.min():.4f}", "1.0000", f"{false_safe.sum():.0f}",
            mean_text(recall), f"{paper:.4f}", f"{recall.mean() - paper:+.4f}", mean_text(bounded),
        )  # fmt: skip
    report.print(table)


def mean_text(values: Any) -> str:
    """Format a mean; for several values, with half the width of its 95 % interval."""
    if len(values) < 2:
        return f"{values[0]:.4f}"
    return mean_interval(values).text()


def print_4(report: Report) -> None:
    """Print computed and published coverage and resolution of the scans (Table 4)."""
    table = Table(title="Table 4: scan configurations (ours / paper)")
    headings = (
        "range (m)",
        "angle (deg)",
        "coverage x (m)",
        "coverage y (m)",
        "GSD x (m)",
        "GSD y (m)",
        "3 sigma (cm)",
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    for row, paper in zip(report.rows, PAPER_4, strict=True):
        cells = [f"{o:.3f} / {p:.3f}" for o, p in zip(row["values"], paper, strict=True)]
        table.add_row(f"{row['distance_m']:.0f}", f"{row['angle_deg']:.0f}", *cells)
    report.print(table)


def print_5(report: Report) -> None:
    """Print computed and published elevation errors of both DEMs (Table 5)."""
    fields = len(report.groups("number"))
    table = Table(
        title=f"Table 5: DEM quality, ours / paper, {fields} fields, 95 % intervals "
        f"(sigma_f {DENSITY['sigma_f']} m, length scale {DENSITY['length_scale']} m; "
        f"baseline: mean of {len(PHASES)} phases of its grid)"
    )
    names = ("RMSE baseline (m)", "at best, worst phase (m)", "RMSE proposed (m)", "NLPD baseline",
             "NLPD proposed", "better than paper",
             "better than baseline at best phase")  # fmt: skip
    for heading in ("range (m)", "angle (deg)", *names):
        table.add_column(heading, justify="right")
    scans = report.groups("distance_m", "angle_deg")
    for ((r, a), rows), paper in zip(scans.items(), PAPER_5, strict=True):
        base, own, nlpd_base, nlpd_own, best, worst = (
            report.column(name, rows)
            for name in ("rmse_baseline", "rmse_proposed", "nlpd_baseline", "nlpd_proposed",
                         "rmse_best_phase", "rmse_worst_phase")
        )  # fmt: skip
        texts = [
            f"{mean_text(v)} / {p:.4f}"
            for v, p in zip((base, own, nlpd_base, nlpd_own), paper, strict=True)
        ]
        beats_paper = own.mean() < paper[1] and nlpd_own.mean() < paper[3]
        beats_own = own.mean() < best.mean() and nlpd_own.mean() < nlpd_base.mean()
        table.add_row(
            f"{r:.0f}", f"{a:.0f}", texts[0], f"{best.mean():.4f}, {worst.mean():.4f}", *texts[1:],
            yes_or_no(beats_paper), yes_or_no(beats_own),
        )  # fmt: skip
    report.print(table)


def yes_or_no(value: bool) -> str:
    """Return "yes" if `value` is true, else "no"."""
    return "yes" if value else "no"


def print_6(report: Report) -> None:
    """Print computed and published precision and recall of the safety tests (Table 6)."""
    fields = len(report.groups("number"))
    scans = report.groups("distance_m", "angle_deg")
    for which, name in enumerate(("precision", "recall")):
        table = Table(
            title=f"Table 6: {name} of safety at p > 0.5, ours / paper, {fields} fields, 95 % "
            f"intervals (sigma_f {MARGIN['sigma_f']} m, length scale {MARGIN['length_scale']} m; "
            f"baseline: {len(HALF_PHASES)} phases of its grid)"
        )
        headings = [f"{kind} {method}" for kind in KINDS for method in METHODS[:2]]
        for heading in ("range (m)", "angle (deg)", *headings, "paper reached"):
            table.add_column(heading, justify="right")
        for n, ((r, a), rows) in enumerate(scans.items()):
            cells, reached = [], True
            for column, heading in enumerate(headings):
                kind, method = heading.split()
                ours = np.array([row["at_half"][f"{method} {kind}"][which] for row in rows])
                paper = PAPER_6[n][4 * which + column]
                cells.append(f"{mean_text(ours)} / {paper:.4f}")
                if method == "proposed":
                    reached &= round(float(ours.mean()), 4) >= paper
            table.add_row(f"{r:.0f}", f"{a:.0f}", *cells, yes_or_no(reached))
        report.print(table)
    print_at_recall(report)


def counts_of(rows: Rows, name: str) -> list[PrecisionRecall]:
    """Return the counts of a method and kind of hazard in rows of Table 6."""
    return [PrecisionRecall(*(np.array(n) for n in row["counts"][name])) for row in rows]


def print_at_recall(report: Report) -> None:
    """Print precision at the recall of the paper, and the calibration error of p_safe."""
    table = Table(title="Precision at the recall of the paper's proposed method")
    headings = ("range (m)", "angle (deg)", "slope: paper", "baseline", "proposed", "planes",
                "roughness: paper", "baseline", "proposed", "planes",
                "calibration error of p_safe")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for n, ((r, a), rows) in enumerate(report.groups("distance_m", "angle_deg").items()):
        cells = []
        for which, kind in enumerate(KINDS):
            cells.append(f"{PAPER_6[n][1 + 2 * which]:.4f}")
            recall = PAPER_6[n][5 + 2 * which]
            for method in METHODS:
                own = [c.precision_at(recall) for c in counts_of(rows, f"{method} {kind}")]
                cells.append(mean_text(own))
        error = calibration_error(np.sum([row["reliability"] for row in rows], axis=0))
        table.add_row(f"{r:.0f}", f"{a:.0f}", *cells, f"{error:.3f}")
    report.print(table)


def print_7(report: Report) -> None:
    """Print computed and published run times of DEMs and safety tests (Table 7)."""
    table = Table(title="Table 7: run time (s), ours / paper; ratios of our times")
    headings = ("posting (m)", "baseline safety", "proposed DEM", "proposed safety",
                "baseline / proposed safety", "baseline / (DEM + safety)")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for row in report.rows:
        paper = PAPER_7[row["posting"]]
        table.add_row(
            str(row["posting"]), f"{row['baseline']:.4f} / {paper[0]:.4f}",
            f"{row['dem']:.4f} / {paper[1]:.4f}", f"{row['safety']:.4f} / {paper[2]:.4f}",
            f"{row['baseline'] / row['safety']:.1f}",
            f"{row['baseline'] / (row['dem'] + row['safety']):.1f}",
        )  # fmt: skip
    report.print(table)
    ours = [row["dem"] + row["safety"] for row in report.rows]
    cheap = [r["posting"] for r, o in zip(report.rows, ours, strict=True) if r["baseline"] < o]
    report.print(
        "The baseline safety test is faster than the proposed DEM and safety test together at "
        + (", ".join(f"{p} m" for p in cheap) or "no posting")
    )
    x = -np.log([row["posting"] for row in report.rows])
    for name in ("baseline", "dem", "safety"):
        exponent = np.polyfit(x, np.log([row[name] for row in report.rows]), 1)[0]
        report.print(f"{name}: grows as (1 / posting)^{exponent:.1f}")


PRINT = {"3": print_3, "4": print_4, "5": print_5, "6": print_6, "7": print_7}


def print_tables(report: Report) -> None:
    """Print each table; with --figures and --out, plot the figures that belong to it."""
    for (name,), rows in report.groups("table").items():
        part = replace(report, rows=rows)
        PRINT[name](part)
        if report.options["figures"] and report.out is not None:
            draw(name, part, TABLES[name](report.seed)[1], report.out)


def draw(name: str, report: Report, shown: Any, out: Path) -> None:
    """Plot the figures of the Gaussian DEM paper that belong to a table.

    `name` is the number of the table ("3" to "7"), `shown` the maps of its first field and `out`
    the output folder.
    """
    if name == "3":
        draw_conservativeness(shown, out / "figure_12_conservativeness.png")
    elif name == "5":
        for number, key, label in ((14, "baseline", "Elevation (m)"), (15, "mean", "Elevation (m)"),
                                   (16, "sigma", "Standard deviation (m)")):  # fmt: skip
            draw_panels(shown[key], CONFIGURATIONS, label, out / f"figure_{number}.png")
        field = testbed(report.seed)
        draw_testbed(field, CONFIGURATIONS, out / "figure_13.png")
        draw_profiles(shown, field, CONFIGURATIONS, out / "figure_17.png")
    elif name == "6":
        draw_6(report, shown, out)


def draw_6(report: Report, shown: Any, out: Path) -> None:
    """Plot the figures of Table 6; the parameters are those of `draw`."""
    scans = list(report.groups("distance_m", "angle_deg").values())
    for number, key in ((19, "baseline roughness"), (20, "proposed roughness"),
                        (22, "baseline slope"), (23, "proposed slope")):  # fmt: skip
        draw_panels(
            shown[key], CONFIGURATIONS, f"{key}: truth minus p(safe)",
            out / f"figure_{number}.png", diverging=True,
        )  # fmt: skip
    bins = np.array([np.sum([row["reliability"] for row in rows], axis=0) for rows in scans])
    draw_reliability(bins, CONFIGURATIONS, out / "reliability.png")
    field = testbed(report.seed)
    draw_truth(field, field.safety.roughness, LANDER.roughness_limit, "roughness (m)",
               out / "figure_18.png")  # fmt: skip
    draw_truth(field, np.rad2deg(field.safety.slope), np.rad2deg(LANDER.slope_limit),
               "slope (deg)", out / "figure_21.png")  # fmt: skip
    for which, kind in enumerate(KINDS):
        curves = [{m: pool_counts(counts_of(rows, f"{m} {kind}")) for m in METHODS}
                  for rows in scans]  # fmt: skip
        paper = [
            [(row[2 * which + m], row[4 + 2 * which + m]) for m in range(2)] for row in PAPER_6
        ]
        draw_precision_recall(
            curves, CONFIGURATIONS, paper, f"Safety of {kind}", (0.985, 0.75)[which],
            out / f"precision_recall_{kind}.png",
        )  # fmt: skip


study = Study(
    compute,
    repeats="fields",
    count=1,
    seed=0,
    factors={"table": list(TABLES)},
    factor_help={"table": "Number of a table in the Gaussian DEM paper."},
    options=(
        click.Option(
            ["--figures"], is_flag=True, default=False,
            help="Plot the figures of the paper into the folder of --out.",
        ),
    ),
    report=print_tables,
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
