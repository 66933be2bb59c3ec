"""Reproduce the tables of the Gaussian DEM paper next to the published values.

    python scenarios/gaussian_dem/tables.py --table all --seeds 20 --out out/gaussian_dem

Tomita and Ho, "Real-Time Stochastic Terrain Mapping and Processing for Autonomous Safe Landing".
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
from computed import (
    HALF_PHASES,
    KINDS,
    METHODS,
    PHASES,
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
from rich.console import Console
from rich.table import Table
from testbed import (
    CONFIGURATIONS,
    DENSITY,
    LANDER,
    MARGIN,
    testbed,
)

from lunarsim.console import plain_console
from lunarsim.evaluation.reliability import calibration_error
from lunarsim.evaluation.statistics import mean_interval


def print_3(result: dict[str, Any], console: Console) -> None:
    """Print computed and published recall of the conservative safety test (Table 3).

    `result` is the value of `computed.table_3`.
    """
    table = Table(title="Table 3: conservative test on Eq. 20 terrain (HiRISE crop)")
    headings = ("c", "precision", "paper", "false-safe cells, both tests", "recall", "paper",
                "difference", "recall of bounded_safety")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        r = statistics.mean(row["recall"])
        table.add_row(
            str(row["c"]), f"{min(row['precision']):.4f}", "1.0000", str(row["false_safe"]),
            mean_text(row["recall"]), f"{row['paper']:.4f}", f"{r - row['paper']:+.4f}",
            mean_text(row["bounded"]),
        )  # fmt: skip
    console.print(table)


def mean_text(values: list[float]) -> str:
    """Format a mean; for several values, with half the width of its 95 % interval."""
    if len(values) < 2:
        return f"{values[0]:.4f}"
    return mean_interval(values).text()


def print_4(result: dict[str, Any], console: Console) -> None:
    """Print computed and published coverage and resolution of the scans (Table 4).

    `result` is the value of `computed.table_4`.
    """
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
    for (r, a), ours, paper in zip(CONFIGURATIONS, result["rows"], PAPER_4, strict=True):
        cells = [f"{o:.3f} / {p:.3f}" for o, p in zip(ours, paper, strict=True)]
        table.add_row(f"{r:.0f}", f"{a:.0f}", *cells)
    console.print(table)


def print_5(result: dict[str, Any], console: Console) -> None:
    """Print computed and published elevation errors of both DEMs (Table 5).

    `result` is the value of `computed.table_5`.
    """
    seeds = len(result["rows"][0][0])
    table = Table(
        title=f"Table 5: DEM quality, ours / paper, {seeds} fields, 95 % intervals "
        f"(sigma_f {DENSITY['sigma_f']} m, length scale {DENSITY['length_scale']} m; "
        f"baseline: mean of {len(PHASES)} phases of its grid)"
    )
    names = ("RMSE baseline (m)", "at best, worst phase (m)", "RMSE proposed (m)", "NLPD baseline",
             "NLPD proposed", "better than paper",
             "better than baseline at best phase")  # fmt: skip
    for heading in ("range (m)", "angle (deg)", *names):
        table.add_column(heading, justify="right")
    for (r, a), ours, paper in zip(CONFIGURATIONS, result["rows"], PAPER_5, strict=True):
        mean = [statistics.mean(v) for v in ours]
        base, own, nlpd_base, nlpd_own = (
            f"{mean_text(v)} / {p:.4f}" for v, p in zip(ours[:4], paper, strict=True)
        )
        phases = f"{mean[4]:.4f}, {mean[5]:.4f}"
        beats_paper = mean[1] < paper[1] and mean[3] < paper[3]
        beats_own = mean[1] < mean[4] and mean[3] < mean[2]
        table.add_row(
            f"{r:.0f}", f"{a:.0f}", base, phases, own, nlpd_base, nlpd_own,
            yes_or_no(beats_paper), yes_or_no(beats_own),
        )  # fmt: skip
    console.print(table)


def yes_or_no(value: bool) -> str:
    """Return "yes" if `value` is true, else "no"."""
    return "yes" if value else "no"


def print_6(result: dict[str, Any], console: Console) -> None:
    """Print computed and published precision and recall of the safety tests (Table 6).

    `result` is the value of `computed.table_6`.
    """
    seeds = len(result["curves"]["slope", 0, "proposed"])
    for which, name in enumerate(("precision", "recall")):
        table = Table(
            title=f"Table 6: {name} of safety at p > 0.5, ours / paper, {seeds} fields, 95 % "
            f"intervals (sigma_f {MARGIN['sigma_f']} m, length scale {MARGIN['length_scale']} m; "
            f"baseline: {len(HALF_PHASES)} phases of its grid)"
        )
        headings = [f"{kind} {method}" for kind in KINDS for method in METHODS[:2]]
        for heading in ("range (m)", "angle (deg)", *headings, "paper reached"):
            table.add_column(heading, justify="right")
        for n, (r, a) in enumerate(CONFIGURATIONS):
            cells, reached = [], True
            for column, heading in enumerate(headings):
                kind, method = heading.split()
                ours = [q[which] for q in result["at_half"][f"{method} {kind}"][n]]
                paper = PAPER_6[n][4 * which + column]
                cells.append(f"{mean_text(ours)} / {paper:.4f}")
                if method == "proposed":
                    reached &= round(statistics.mean(ours), 4) >= paper
            table.add_row(f"{r:.0f}", f"{a:.0f}", *cells, yes_or_no(reached))
        console.print(table)
    print_at_recall(result, console)


def print_at_recall(result: dict[str, Any], console: Console) -> None:
    """Print precision at the recall of the paper, and the calibration error of p_safe.

    `result` is the value of `computed.table_6`.
    """
    table = Table(title="Precision at the recall of the paper's proposed method")
    headings = ("range (m)", "angle (deg)", "slope: paper", "baseline", "proposed", "planes",
                "roughness: paper", "baseline", "proposed", "planes",
                "calibration error of p_safe")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for n, (r, a) in enumerate(CONFIGURATIONS):
        cells = []
        for which, kind in enumerate(KINDS):
            cells.append(f"{PAPER_6[n][1 + 2 * which]:.4f}")
            recall = PAPER_6[n][5 + 2 * which]
            for method in METHODS:
                own = [c.precision_at(recall) for c in result["curves"][kind, n, method]]
                cells.append(mean_text(own))
        error = calibration_error(np.array(result["reliability"][n]))
        table.add_row(f"{r:.0f}", f"{a:.0f}", *cells, f"{error:.3f}")
    console.print(table)


def print_7(result: dict[str, Any], console: Console) -> None:
    """Print computed and published run times of DEMs and safety tests (Table 7).

    `result` is the value of `computed.table_7`.
    """
    table = Table(title="Table 7: run time (s), ours / paper; ratios of our times")
    headings = ("posting (m)", "baseline safety", "proposed DEM", "proposed safety",
                "baseline / proposed safety", "baseline / (DEM + safety)")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        paper = PAPER_7[row["posting"]]
        table.add_row(
            str(row["posting"]), f"{row['baseline']:.4f} / {paper[0]:.4f}",
            f"{row['dem']:.4f} / {paper[1]:.4f}", f"{row['safety']:.4f} / {paper[2]:.4f}",
            f"{row['baseline'] / row['safety']:.1f}",
            f"{row['baseline'] / (row['dem'] + row['safety']):.1f}",
        )  # fmt: skip
    console.print(table)
    ours = [row["dem"] + row["safety"] for row in result["rows"]]
    cheap = [r["posting"] for r, o in zip(result["rows"], ours, strict=True) if r["baseline"] < o]
    console.print(
        "The baseline safety test is faster than the proposed DEM and safety test together at "
        + (", ".join(f"{p} m" for p in cheap) or "no posting")
    )
    x = -np.log([row["posting"] for row in result["rows"]])
    for name in ("baseline", "dem", "safety"):
        exponent = np.polyfit(x, np.log([row[name] for row in result["rows"]]), 1)[0]
        console.print(f"{name}: grows as (1 / posting)^{exponent:.1f}")


TABLES: dict[str, tuple[Callable[[int], dict[str, Any]], Callable[[dict[str, Any], Console], None]]]
TABLES = {
    "3": (table_3, print_3),
    "4": (table_4, print_4),
    "5": (table_5, print_5),
    "6": (table_6, print_6),
    "7": (table_7, print_7),
}


def draw(name: str, result: dict[str, Any], out: Path) -> None:
    """Plot the figures of the Gaussian DEM paper that belong to a table.

    `name` is the number of the table ("3" to "7"), `result` its computed content and `out` the
    output folder.
    """
    if name == "3":
        draw_conservativeness(result["pictures"], out / "figure_12_conservativeness.png")
    elif name == "5":
        for number, key, label in ((14, "baseline", "Elevation (m)"), (15, "mean", "Elevation (m)"),
                                   (16, "sigma", "Standard deviation (m)")):  # fmt: skip
            draw_panels(
                result["pictures"][key], CONFIGURATIONS, label, out / f"figure_{number}.png"
            )
        field = testbed(0)
        draw_testbed(field, CONFIGURATIONS, out / "figure_13.png")
        draw_profiles(result["pictures"], field, CONFIGURATIONS, out / "figure_17.png")
    elif name == "6":
        for number, key in ((19, "baseline roughness"), (20, "proposed roughness"),
                            (22, "baseline slope"), (23, "proposed slope")):  # fmt: skip
            draw_panels(
                result["pictures"][key], CONFIGURATIONS, f"{key}: truth minus p(safe)",
                out / f"figure_{number}.png", diverging=True,
            )  # fmt: skip
        draw_reliability(np.array(result["reliability"]), CONFIGURATIONS, out / "reliability.png")
        field = testbed(0)
        draw_truth(field, field.safety.roughness, LANDER.roughness_limit, "roughness (m)",
                   out / "figure_18.png")  # fmt: skip
        draw_truth(field, np.rad2deg(field.safety.slope), np.rad2deg(LANDER.slope_limit),
                   "slope (deg)", out / "figure_21.png")  # fmt: skip
        for which, kind in enumerate(KINDS):
            curves = [
                {m: pool_counts(result["curves"][kind, n, m]) for m in METHODS}
                for n in range(len(CONFIGURATIONS))
            ]
            paper = [
                [(row[2 * which + m], row[4 + 2 * which + m]) for m in range(2)] for row in PAPER_6
            ]
            draw_precision_recall(
                curves, CONFIGURATIONS, paper, f"Safety of {kind}", (0.985, 0.75)[which],
                out / f"precision_recall_{kind}.png",
            )  # fmt: skip


@click.command()
@click.option("--table", "number", type=click.Choice([*TABLES, "all"]), default="all",
              show_default=True,
              help="Number of the table in the Gaussian DEM paper to compute, or all.")  # fmt: skip
@click.option("--seeds", type=click.IntRange(min=1), default=1, show_default=True,
              help="Number of simulated terrains for each table, with one random seed "
              "each.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for all results. Default: none.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figures. Default: no figures.")  # fmt: skip
def main(number: str, seeds: int, json_file: Path | None, out: Path | None) -> None:
    """Print computed and published values of the tables of the Gaussian DEM paper."""
    console = plain_console(190)
    gathered = {}
    for name in TABLES if number == "all" else (number,):
        compute, show = TABLES[name]
        result = compute(seeds)
        show(result, console)
        if out is not None:
            draw(name, result, out)
        gathered[name] = {k: v for k, v in result.items() if k not in {"pictures", "curves"}}
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(gathered, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
