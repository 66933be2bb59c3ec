"""What the tables of the Gaussian DEM paper hold, computed here."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from paper import PAPER_3, PAPER_7
from rich.progress import track
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
from lunarsim.evaluation.reliability import reliability
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
    coarse = Grid.centred(grid.centre, width, posting, height)
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


def table_4_row(distance: float, angle_deg: float) -> tuple[float, float, float, float, float]:
    """Coverage and sample distance on a plane in closed form, and the noise."""
    angle, half = np.deg2rad(angle_deg), np.arctan(0.1)
    height = distance * np.cos(angle)
    x = height * (np.tan(angle + half) - np.tan(angle - half))
    return x, 0.2 * distance, x / 256, 0.2 * distance / 256, 100 * 0.05 * distance / 500


def table_4(seeds: int) -> dict[str, Any]:
    """Coverage, ground sample distance and noise of the nine configurations."""
    return {"rows": [table_4_row(r, a) for r, a in CONFIGURATIONS]}


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
