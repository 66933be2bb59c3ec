"""Compute the content of the tables of the Gaussian DEM paper."""

from __future__ import annotations

import operator
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
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
    ScannedDem,
    TestbedField,
    map_testbed,
    scan,
    testbed,
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
from lunarsim.world.terrain.dtm import load_terrain

DATA = Path(__file__).parents[1] / "data"
METHODS = ("baseline", "proposed", "planes")  # "planes" is `plane_stochastic_safety`
KINDS = ("slope", "roughness")
# Offsets of the baseline grid in cells, east and north. Its samples have the same spacing as its
# cells, so the number of samples per cell depends on the phase of the grid.
PHASES = [(east / 4, north / 4) for east in range(4) for north in range(4)]
HALF_PHASES = [(east / 2, north / 2) for east in range(2) for north in range(2)]


def sample_distance(distance: float, angle_deg: float) -> float:
    """Return the mean ground sample distance (baseline posting) of a scan, m."""
    x, y = table_4_row(distance, angle_deg)[2:4]
    return float(np.sqrt(x * y))


def baseline(points, grid: Grid, posting: float, phase: tuple[float, float] = (0.0, 0.0)):
    """Return the conventional DEM at the scan posting and its cells on `grid`.

    `phase` moves its grid east and north by fractions of a cell.
    """
    width, height = grid.cols * grid.posting, grid.rows * grid.posting
    coarse = Grid.centred(grid.centre, width, posting, height).moved(np.multiply(phase, posting))
    row, col = coarse.cell(grid.centres())
    nearest = (np.clip(row, 0, coarse.rows - 1), np.clip(col, 0, coarse.cols - 1))
    return conventional_dem(points, coarse), nearest


def complexity_terrain(c: float, seed: int) -> tuple[np.ndarray, Grid]:
    """Return terrain by Eq. 20: plane, rocks (0.2 to 1 m), c times measured relief.

    The posting is 0.1 m.
    """
    relief = load_terrain(DATA / "hirise_dteec_010228_1490_crop.tif").refined(0.25)
    west, east, south, north = relief.bounds
    grid = Grid.centred((0.0, 0.0), east - west, POSTING, north - south)
    rng = np.random.default_rng(seed)
    area = (east - west) * (north - south)
    diameters = rng.uniform(0.2, 1.0, round(500 * area / 40_000.0))
    plane = Heightfield(relief.grid, np.zeros_like(relief.z))
    rocks = Terrain(plane, place_rocks(plane, diameters, rng)).raster(grid)
    return rocks + np.float32(c) * Terrain(relief, RockField.empty()).raster(grid), grid


def table_3(seeds: int) -> dict[str, Any]:
    """Evaluate the conservative test on perfect maps against terrain complexity."""
    rows, shown = [], []
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
                shown.append((c, z, exact, level, planes, grid))
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
    return {"rows": rows, "pictures": shown}


def table_4_row(distance: float, angle_deg: float) -> tuple[float, float, float, float, float]:
    """Return coverage, sample distance and noise of a scan of a plane in closed form."""
    angle, half = np.deg2rad(angle_deg), np.arctan(0.1)
    height = distance * np.cos(angle)
    x = height * (np.tan(angle + half) - np.tan(angle - half))
    return x, 0.2 * distance, x / 256, 0.2 * distance / 256, 100 * 0.05 * distance / 500


def table_4(seeds: int) -> dict[str, Any]:
    """Return coverage, ground sample distance and noise of the nine configurations."""
    return {"rows": [table_4_row(r, a) for r, a in CONFIGURATIONS]}


def density(error: np.ndarray, variance: np.ndarray | float) -> float:
    """Return the negative log predictive density (Eq. 24)."""
    return float(np.mean(error**2 / (2 * variance) + 0.5 * np.log(2 * np.pi * variance)))


def table_5(seeds: int) -> dict[str, Any]:
    """Return RMSE and predictive density of the baseline and the proposed method.

    ``rows`` holds six lists per configuration,
    with one value per seed: RMSE of the baseline (mean of
    its grid phases), RMSE of the proposed method, density of the baseline, density of the proposed
    method, and the baseline RMSE at its best and worst phase.
    """
    rows: list[list[list[float]]] = [[[] for _ in range(6)] for _ in CONFIGURATIONS]
    shown: dict[str, list[Any]] = {"baseline": [], "mean": [], "sigma": []}
    for seed in track(range(seeds), description="table 5"):
        field = testbed(seed)
        for n, (distance, angle) in enumerate(CONFIGURATIONS):
            one = map_testbed(field, distance, angle, np.random.default_rng([seed, n]), **DENSITY)
            truth = field.elevation[one.window]
            # Cells within the convex hull of the samples, also occluded ones (with the prior
            # variance).
            inside = np.isfinite(one.dem.mean)
            rmse, nlpd = [], []
            posting = sample_distance(distance, angle)
            for phase in PHASES:
                coarse, nearest = baseline(one.points, one.grid, posting, phase)
                error = (coarse.elevation[nearest] - truth)[inside].astype(float)
                rmse.append(rms(error))
                nlpd.append(density(error, one.sigma**2))
                if seed == 0 and phase == (0.0, 0.0):
                    one_shown = (coarse.elevation[nearest], one.grid, one.points)
                    shown["baseline"].append(one_shown)
            own = (one.dem.mean - truth)[inside].astype(float)
            values = (
                statistics.mean(rmse), rms(own), statistics.mean(nlpd),
                density(own, one.dem.variance[inside].astype(float)), min(rmse), max(rmse),
            )  # fmt: skip
            for column, value in zip(rows[n], values, strict=True):
                column.append(value)
            if seed == 0:
                shown["mean"].append((one.dem.mean, one.grid, one.points))
                shown["sigma"].append((np.sqrt(one.dem.variance), one.grid, one.points))
    return {"rows": rows, "pictures": shown}


def rms(error: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(error**2)))


@dataclass(frozen=True)
class ScanEvaluation:
    """One scan of a testbed: the probabilities of all methods, and the truth.

    Attributes
    ----------
    p
        Probability of safety by method and kind, on the grid: a list, for the baseline with one
        entry per phase of its grid.
    truth
        True safety by kind, on the grid.
    evaluated
        Cells for which the truth and all methods have a value.
    p_safe
        Probability of safety of the proposed method, both kinds together.
    scan
        The scan.
    """

    p: dict[tuple[str, str], list[np.ndarray]]
    truth: dict[str, np.ndarray]
    evaluated: np.ndarray
    p_safe: np.ndarray
    scan: ScannedDem


def truth_of(field: TestbedField, one: ScannedDem) -> dict[str, np.ndarray]:
    """Return true slope and roughness safety on the evaluated grid."""
    return {
        "slope": field.safety.slope[one.window] < LANDER.slope_limit,
        "roughness": field.safety.roughness[one.window] < LANDER.roughness_limit,
    }


def judge(field: TestbedField, seed: int, n: int) -> ScanEvaluation:
    """Scan a testbed in its n-th configuration and evaluate all methods."""
    distance, angle = CONFIGURATIONS[n]
    one = map_testbed(field, distance, angle, np.random.default_rng([seed, n]), **MARGIN)
    # Occluded cells have the prior variance and therefore count as unsafe.
    own = stochastic_safety(one.dem.mean, one.dem.variance, one.grid, LANDER)
    planes = plane_stochastic_safety(one.dem.mean, one.dem.variance, one.grid, LANDER)
    evaluated = own.observed & field.safety.observed[one.window]
    p: dict[tuple[str, str], list[np.ndarray]] = {
        ("baseline", "slope"): [],
        ("baseline", "roughness"): [],
        ("proposed", "slope"): [own.p_slope],
        ("proposed", "roughness"): [own.p_roughness],
        ("planes", "slope"): [planes.p_slope],
        ("planes", "roughness"): [planes.p_roughness],
    }
    for phase in HALF_PHASES:
        posting = sample_distance(distance, angle)
        coarse, nearest = baseline(one.points, one.grid, posting, phase)
        other = alhat_safety(coarse.elevation, coarse.grid, LANDER, sigma=one.sigma)
        evaluated &= other.observed[nearest]
        p["baseline", "slope"].append(other.p_slope[nearest])
        p["baseline", "roughness"].append(other.p_roughness[nearest])
    return ScanEvaluation(p, truth_of(field, one), evaluated, own.p_safe, one)


def table_6(seeds: int) -> dict[str, Any]:
    """Return precision and recall of slope and roughness safety, and reliability.

    ``curves`` holds the counts by kind, configuration and method,
    one per seed; all printed values are
    computed from them. The baseline pools the phases of its grid.
    """
    numbers = range(len(CONFIGURATIONS))
    shown: dict[str, list[Any]] = {f"{m} {k}": [] for m in METHODS[:2] for k in KINDS}
    bins = np.zeros((len(CONFIGURATIONS), 20, 3))
    curves: dict[tuple[str, int, str], list[PrecisionRecall]] = {
        (kind, n, method): [] for kind in KINDS for n in numbers for method in METHODS
    }
    for seed in track(range(seeds), description="table 6"):
        field = testbed(seed)
        for n in numbers:
            one = judge(field, seed, n)
            seen = one.evaluated
            for (method, kind), maps in one.p.items():
                truth = one.truth[kind]
                counted = [PrecisionRecall.of(p[seen], truth[seen]) for p in maps]
                curves[kind, n, method].append(pool_counts(counted))
                if seed == 0 and method != "planes":
                    missing = np.where(seen, truth - maps[0], np.nan)
                    one_shown = (missing, one.scan.grid, one.scan.points)
                    shown[f"{method} {kind}"].append(one_shown)
            safe = np.logical_and(*one.truth.values())
            bins[n] += reliability(one.p_safe[seen], safe[seen], np.linspace(0.0, 1.0, 21))
    together = {key: pool_counts(own) for key, own in curves.items()}
    return {
        "pictures": shown,
        "reliability": bins.tolist(),
        "curves": curves,
        "at_half": {
            f"{method} {kind}": [
                [[q.precision, q.recall] for q in (c.at_half() for c in curves[kind, n, method])]
                for n in numbers
            ]
            for method in METHODS
            for kind in KINDS
        },
        "precision_recall": {
            f"{method} {kind}": [
                [together[kind, n, method].unsafe.tolist(), together[kind, n, method].safe.tolist()]
                for n in numbers
            ]
            for method in METHODS
            for kind in KINDS
        },
    }


def pool_counts(counts: list[PrecisionRecall]) -> PrecisionRecall:
    """Add counts."""
    return reduce(operator.add, counts)


def median_time(call: Callable[[], Any], repeats: int) -> float:
    """Return the median time of a call (s) after one warm-up call."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def table_7(seeds: int) -> dict[str, Any]:
    """Return run times at four postings: 65,536 points, 100 x 100 m, from 500 m."""
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
                "baseline": median_time(
                    lambda: alhat_safety(dem.mean, grid, LANDER, sigma=sigma), 3
                ),
                "dem": median_time(build, 9),
                "safety": median_time(
                    lambda: stochastic_safety(dem.mean, dem.variance, grid, LANDER), 9
                ),
            }
        )
    return {"rows": rows}
