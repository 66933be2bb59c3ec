"""The tables of the Gaussian DEM paper, its figure beside ours.

    python scenarios/gaussian_dem/tables.py --table all --seeds 2 --out out/gaussian_dem

Tomita and Ho, "Real-Time Stochastic Terrain Mapping and Processing for Autonomous Safe Landing".
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from figures import (
    draw_conservativeness,
    draw_panels,
    draw_precision_recall,
    draw_profiles,
    draw_reliability,
    draw_testbed,
    draw_truth,
)
from paper import PAPER_3, PAPER_4, PAPER_5, PAPER_6, PAPER_7
from rich.console import Console
from rich.progress import track
from rich.table import Table
from testbed import (
    CONFIGURATIONS,
    DENSITY,
    LANDER,
    MARGIN,
    POSTING,
    Field,
    crop,
    scan,
    testbed,
    view_grid,
)

from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import calibration_error, reliability
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import conventional_dem, gaussian_dem
from lunarsim.rocks.field import RockField
from lunarsim.safety import (
    alhat_safety,
    bounded_safety,
    conservative_safety,
    exact_safety,
    plane_stochastic_safety,
    stochastic_safety,
)
from lunarsim.world.terrain import Heightfield, Terrain, place_rocks
from lunarsim.world.terrain.dtm import load_dtm

DATA = Path(__file__).parents[1] / "data"
METHODS = ("baseline", "proposed", "planes")  # the last: `plane_stochastic_safety`
KINDS = ("slope", "roughness")


def sample_distance(distance: float, angle_deg: float) -> float:
    """Mean ground sample distance of a configuration (m): the baseline's posting."""
    x, y = table_4_row(distance, angle_deg)[2:4]
    return float(np.sqrt(x * y))


def baseline(points, grid: Grid, posting: float):
    """Conventional DEM at the scan's own posting, and its values at the cells of `grid`."""
    width, height = grid.cols * grid.posting, grid.rows * grid.posting
    centre = (0.5 * (grid.extent[0] + grid.extent[1]), 0.5 * (grid.extent[2] + grid.extent[3]))
    coarse = Grid.centred(centre, width, posting, height)
    row, col = coarse.cell(grid.centres())
    nearest = (np.clip(row, 0, coarse.rows - 1), np.clip(col, 0, coarse.cols - 1))
    return conventional_dem(points, coarse), nearest


def complexity_terrain(c: float, seed: int) -> tuple[np.ndarray, Grid]:
    """Eq. 20: a plane with rocks of 0.2 to 1 m plus c times the measured relief, at 0.1 m."""
    relief = load_dtm(DATA / "hirise_dteec_010228_1490_crop.tif").refined(0.25)
    west, east, south, north = relief.bounds
    grid = Grid.centred((0.0, 0.0), east - west, POSTING, north - south)
    rng = np.random.default_rng(seed)
    area = (east - west) * (north - south)
    diameters = rng.uniform(0.2, 1.0, round(500 * area / 40_000.0))
    plane = Heightfield(relief.grid, np.zeros_like(relief.z))
    rocks = Terrain(plane, place_rocks(plane, diameters, rng)).raster(grid)
    return rocks + np.float32(c) * Terrain(relief, RockField.empty()).raster(grid), grid


def table_3(seeds: int) -> dict[str, Any]:
    """Precision and recall of the conservative test on perfect maps, by terrain complexity."""
    rows, pictures = [], []
    for c, paper in PAPER_3.items():
        ours, through = [], []
        for seed in track(range(seeds), description=f"table 3, c = {c}"):
            z, grid = complexity_terrain(c, seed)
            exact = exact_safety(z, grid, LANDER).safe
            level = conservative_safety(z, grid, LANDER).safe
            planes = bounded_safety(z, grid, LANDER).safe
            ours.append(MapQuality.of(level, exact))
            through.append(MapQuality.of(planes, exact))
            if seed == 0:
                pictures.append((c, z, exact, level, planes, grid))
        rows.append(
            {
                "c": c,
                "precision": [q.precision for q in ours],
                "recall": [q.recall for q in ours],
                "bounded": [q.recall for q in through],
                "paper": paper,
                "false_safe": sum(q.false_safe for q in ours + through),
            }
        )
    return {"rows": rows, "pictures": pictures}


def print_3(result: dict[str, Any], console: Console) -> None:
    table = Table(title="Table 3: conservative test on Eq. 20 terrain (HiRISE crop)")
    headings = ("c", "precision", "paper", "false-safe cells, both tests", "recall", "paper",
                "difference", "recall of bounded_safety")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        r = statistics.mean(row["recall"])
        table.add_row(
            str(row["c"]), f"{min(row['precision']):.4f}", "1.0000", str(row["false_safe"]),
            spread(row["recall"]), f"{row['paper']:.4f}", f"{r - row['paper']:+.4f}",
            spread(row["bounded"]),
        )  # fmt: skip
    console.print(table)


def spread(values: list[float]) -> str:
    """Mean and, with more than one seed, standard deviation."""
    if len(values) < 2:
        return f"{values[0]:.4f}"
    return f"{statistics.mean(values):.4f} ± {statistics.stdev(values):.4f}"


def table_4_row(distance: float, angle_deg: float) -> tuple[float, float, float, float, float]:
    """Coverage and sample distance on a plane in closed form, and the noise."""
    angle, half = np.deg2rad(angle_deg), np.arctan(0.1)
    height = distance * np.cos(angle)
    x = height * (np.tan(angle + half) - np.tan(angle - half))
    return x, 0.2 * distance, x / 256, 0.2 * distance / 256, 100 * 0.05 * distance / 500


def table_4(seeds: int) -> dict[str, Any]:
    """Coverage, ground sample distance and noise of the nine configurations."""
    return {"rows": [table_4_row(r, a) for r, a in CONFIGURATIONS]}


def print_4(result: dict[str, Any], console: Console) -> None:
    table = Table(title="Table 4: scan configurations (ours / paper)")
    headings = ("range m", "angle deg", "coverage x", "coverage y", "GSD x", "GSD y", "3 sigma cm")
    for heading in headings:
        table.add_column(heading, justify="right")
    for (r, a), ours, paper in zip(CONFIGURATIONS, result["rows"], PAPER_4, strict=True):
        cells = [f"{o:.3f} / {p:.3f}" for o, p in zip(ours, paper, strict=True)]
        table.add_row(f"{r:.0f}", f"{a:.0f}", *cells)
    console.print(table)


def density(error: np.ndarray, variance: np.ndarray | float) -> float:
    """Negative log predictive density (Eq. 24)."""
    return float(np.mean(error**2 / (2 * variance) + 0.5 * np.log(2 * np.pi * variance)))


def table_5(seeds: int) -> dict[str, Any]:
    """Error and predictive density of the baseline and the proposed DEM."""
    rows: list[list[list[float]]] = [[[], [], [], []] for _ in CONFIGURATIONS]
    pictures: dict[str, list[Any]] = {"baseline": [], "mean": [], "sigma": []}
    for seed in track(range(seeds), description="table 5"):
        field = testbed(seed)
        for n, (distance, angle) in enumerate(CONFIGURATIONS):
            rng = np.random.default_rng([seed, n])
            points, sigma, shape = scan(field, distance, angle, rng)
            grid = view_grid(distance)
            truth = field.elevation[crop(field, grid)]
            dem = gaussian_dem(points, grid, sigma_eps=sigma, image_shape=shape, **DENSITY)
            coarse, nearest = baseline(points, grid, sample_distance(distance, angle))
            # Inside the samples' hull; cells over occlusions count too, with the prior's variance.
            inside = np.isfinite(dem.mean)
            own = (dem.mean - truth)[inside].astype(float)
            base = (coarse.elevation[nearest] - truth)[inside].astype(float)
            rows[n][0].append(float(np.sqrt(np.mean(base**2))))
            rows[n][1].append(float(np.sqrt(np.mean(own**2))))
            rows[n][2].append(density(base, sigma**2))
            rows[n][3].append(density(own, dem.variance[inside].astype(float)))
            if seed == 0:
                pictures["baseline"].append((coarse.elevation[nearest], grid, points))
                pictures["mean"].append((dem.mean, grid, points))
                pictures["sigma"].append((np.sqrt(dem.variance), grid, points))
    return {"rows": rows, "pictures": pictures}


def print_5(result: dict[str, Any], console: Console) -> None:
    table = Table(
        title="Table 5: DEM quality, ours / paper "
        f"(sigma_f {DENSITY['sigma_f']} m, length scale {DENSITY['length_scale']} m)"
    )
    names = ("RMSE baseline", "RMSE proposed", "NLPD baseline", "NLPD proposed")
    for heading in ("range m", "angle deg", *names, "below paper", "below baseline"):
        table.add_column(heading, justify="right")
    for (r, a), ours, paper in zip(CONFIGURATIONS, result["rows"], PAPER_5, strict=True):
        mean = [statistics.mean(v) for v in ours]
        cells = [f"{spread(v)} / {p:.4f}" for v, p in zip(ours, paper, strict=True)]
        beats_paper = mean[1] < paper[1] and mean[3] < paper[3]
        beats_own = mean[1] < mean[0] and mean[3] < mean[2]
        table.add_row(f"{r:.0f}", f"{a:.0f}", *cells, yes(beats_paper), yes(beats_own))
    console.print(table)


def yes(value: bool) -> str:
    return "yes" if value else "no"


@dataclass(frozen=True)
class Judged:
    """One scan of a testbed: what the methods say, and the truth.

    Attributes
    ----------
    p
        Probability of safety by method and kind, on the grid.
    truth
        By kind, on the grid.
    judged
        Cells that all have an opinion on, and the truth too.
    p_safe
        Of the proposed method, both kinds together.
    grid, points
        The map and the returns.
    """

    p: dict[tuple[str, str], np.ndarray]
    truth: dict[str, np.ndarray]
    judged: np.ndarray
    p_safe: np.ndarray
    grid: Grid
    points: np.ndarray


def judge(field: Field, seed: int, n: int) -> Judged:
    """Scan a testbed in its n-th configuration and judge it by all methods."""
    distance, angle = CONFIGURATIONS[n]
    rng = np.random.default_rng([seed, n])
    points, sigma, shape = scan(field, distance, angle, rng)
    grid = view_grid(distance)
    window = crop(field, grid)
    dem = gaussian_dem(points, grid, sigma_eps=sigma, image_shape=shape, **MARGIN)
    # Cells over occlusions have the prior's variance and so count as unsafe.
    own = stochastic_safety(dem.mean, dem.variance, grid, LANDER)
    coarse, nearest = baseline(points, grid, sample_distance(distance, angle))
    other = alhat_safety(coarse.elevation, coarse.grid, LANDER, sigma=sigma)
    planes = plane_stochastic_safety(dem.mean, dem.variance, grid, LANDER)
    return Judged(
        {
            ("baseline", "slope"): other.p_slope[nearest],
            ("baseline", "roughness"): other.p_roughness[nearest],
            ("proposed", "slope"): own.p_slope,
            ("proposed", "roughness"): own.p_roughness,
            ("planes", "slope"): planes.p_slope,
            ("planes", "roughness"): planes.p_roughness,
        },
        {
            "slope": field.safety.slope[window] < LANDER.slope_limit,
            "roughness": field.safety.roughness[window] < LANDER.roughness_limit,
        },
        own.observed & other.observed[nearest] & field.safety.observed[window],
        own.p_safe,
        grid,
        points,
    )


def table_6(seeds: int) -> dict[str, Any]:
    """Precision and recall of slope and roughness safety, and reliability of p_safe."""
    numbers = range(len(CONFIGURATIONS))
    rows: list[list[list[float]]] = [[[] for _ in range(8)] for _ in numbers]
    pictures: dict[str, list[Any]] = {f"{m} {k}": [] for m in METHODS[:2] for k in KINDS}
    bins = np.zeros((len(CONFIGURATIONS), 20, 3))
    curves: dict[tuple[str, int, str], PrecisionRecall] = {}
    for seed in track(range(seeds), description="table 6"):
        field = testbed(seed)
        for n in numbers:
            one = judge(field, seed, n)
            seen = one.judged
            for (method, kind), p in one.p.items():
                curve = PrecisionRecall.of(p[seen], one.truth[kind][seen])
                key = (kind, n, method)
                curves[key] = curves[key] + curve if key in curves else curve
                if method == "planes":
                    continue
                column = 2 * KINDS.index(kind) + METHODS.index(method)
                quality = MapQuality.of(p[seen] > 0.5, one.truth[kind][seen])
                rows[n][column].append(quality.precision)
                rows[n][4 + column].append(quality.recall)
                if seed == 0:
                    missing = np.where(seen, one.truth[kind] - p, np.nan)
                    pictures[f"{method} {kind}"].append((missing, one.grid, one.points))
            safe = np.logical_and(*one.truth.values())
            bins[n] += reliability(one.p_safe[seen], safe[seen], np.linspace(0.0, 1.0, 21))
    return {
        "rows": rows,
        "pictures": pictures,
        "reliability": bins.tolist(),
        "curves": curves,
        "precision_recall": {
            f"{method} {kind}": [
                [curves[kind, n, method].unsafe.tolist(), curves[kind, n, method].safe.tolist()]
                for n in numbers
            ]
            for method in METHODS
            for kind in KINDS
        },
    }


def print_6(result: dict[str, Any], console: Console) -> None:
    table = Table(
        title="Table 6: safety at p > 0.5, ours / paper "
        f"(sigma_f {MARGIN['sigma_f']} m, length scale {MARGIN['length_scale']} m)"
    )
    headings = ("range m", "angle deg", "P slope base", "P slope prop", "P rough base",
                "P rough prop", "R slope base", "R slope prop", "R rough base", "R rough prop",
                "P at paper", "R at paper", "calibration error")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for n, (r, a) in enumerate(CONFIGURATIONS):
        ours, paper = result["rows"][n], PAPER_6[n]
        mean = [statistics.mean(v) for v in ours]
        cells = [f"{m:.4f} / {p:.4f}" for m, p in zip(mean, paper, strict=True)]
        precise = round(mean[1], 4) >= paper[1] and round(mean[3], 4) >= paper[3]
        complete = round(mean[5], 4) >= paper[5] and round(mean[7], 4) >= paper[7]
        error = calibration_error(np.array(result["reliability"][n]))
        table.add_row(f"{r:.0f}", f"{a:.0f}", *cells, yes(precise), yes(complete), f"{error:.3f}")
    console.print(table)
    table = Table(title="Precision at the recall of the paper's proposed method")
    headings = ("range m", "angle deg", "slope: paper", "baseline", "proposed", "planes",
                "roughness: paper", "baseline", "proposed", "planes")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="right")
    for n, (r, a) in enumerate(CONFIGURATIONS):
        cells = []
        for which, kind in enumerate(KINDS):
            cells.append(f"{PAPER_6[n][1 + 2 * which]:.4f}")
            recall = PAPER_6[n][5 + 2 * which]
            for method in METHODS:
                cells.append(f"{result['curves'][kind, n, method].precision_at(recall):.4f}")
        table.add_row(f"{r:.0f}", f"{a:.0f}", *cells)
    console.print(table)


def timed(call: Callable[[], Any], repeats: int) -> float:
    """Median time of a call (s), warm."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def table_7(seeds: int) -> dict[str, Any]:
    """Run times at four postings: 65,536 points, 100 x 100 m, from 500 m straight above."""
    field = testbed(0, side=20.0)
    points, sigma, shape = scan(field, 500.0, 0.0, np.random.default_rng(0))
    rows = []
    for posting in track(PAPER_7, description="table 7"):
        grid = Grid.centred((0.0, 0.0), 100.0, posting)

        def build(grid: Grid = grid):
            return gaussian_dem(points, grid, sigma_eps=sigma, image_shape=shape, **MARGIN)

        dem = build()
        rows.append(
            {
                "posting": posting,
                "baseline": timed(lambda: alhat_safety(dem.mean, grid, LANDER, sigma=sigma), 3),
                "dem": timed(build, 9),
                "safety": timed(lambda: stochastic_safety(dem.mean, dem.variance, grid, LANDER), 9),
            }
        )
    return {"rows": rows}


def print_7(result: dict[str, Any], console: Console) -> None:
    table = Table(title="Table 7: run time, s (ours / paper); ratios of ours in one run")
    headings = ("posting m", "baseline safety", "proposed DEM", "proposed safety",
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
        "the baseline's safety alone is cheaper than the proposed DEM and safety at "
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
    """Draw the counterparts of the paper's figures that belong to a table."""
    if name == "3":
        draw_conservativeness(result["pictures"], out / "figure_12_conservativeness.png")
    elif name == "5":
        for number, key, label in ((14, "baseline", "elevation (m)"), (15, "mean", "elevation (m)"),
                                   (16, "sigma", "standard deviation (m)")):  # fmt: skip
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
                result["pictures"][key], CONFIGURATIONS, f"{key}: truly safe - p(safe)",
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
                {m: result["curves"][kind, n, m] for m in METHODS}
                for n in range(len(CONFIGURATIONS))
            ]
            paper = [(row[1 + 2 * which], row[5 + 2 * which]) for row in PAPER_6]
            draw_precision_recall(
                curves, CONFIGURATIONS, paper, f"Safety of {kind}", (0.995, 0.85)[which],
                out / f"precision_recall_{kind}.png",
            )  # fmt: skip


@click.command()
@click.option("--table", "which", type=click.Choice([*TABLES, "all"]), default="all",
              show_default=True, help="Which table.")  # fmt: skip
@click.option("--seeds", type=click.IntRange(min=1), default=1, show_default=True,
              help="Fields or terrains a table.")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Write all figures to this file.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figures; left out, none are drawn.")  # fmt: skip
def main(which: str, seeds: int, json_file: Path | None, out: Path | None) -> None:
    """Print the paper's tables with ours beside them."""
    console = Console(width=190)
    gathered = {}
    for name in TABLES if which == "all" else (which,):
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
