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

from lunarsim import (
    Grid,
    Heightfield,
    Terrain,
    exact_safety,
    gaussian_dem,
    load_terrain,
)
from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import reliability
from lunarsim.onboard.hazards.gaussian_dem import conventional_dem
from lunarsim.rocks.field import RockField
from lunarsim.safety import (
    alhat_safety,
    bounded_safety,
    conservative_safety,
    plane_stochastic_safety,
    stochastic_safety,
)
from lunarsim.world.terrain import place_rocks

DATA = Path(__file__).parents[1] / "data"
Rows = list[dict[str, Any]]
SCANS = range(len(CONFIGURATIONS))
METHODS = ("baseline", "proposed", "planes")  # "planes" is `plane_stochastic_safety`
KINDS = ("slope", "roughness")
# Offsets of the baseline grid in cells, east and north. Its samples have the same spacing as its
# cells, so the number of samples per cell depends on the phase of the grid.
PHASES = [(east / 4, north / 4) for east in range(4) for north in range(4)]
HALF_PHASES = [(east / 2, north / 2) for east in range(2) for north in range(2)]


def sample_distance(distance: float, angle_deg: float) -> float:
    """Return the mean ground sample distance of a LiDAR scan, m.

    The scan is taken at a range `distance` (m) and an angle `angle_deg` off nadir (deg). The grid
    of the baseline DEM has this spacing.
    """
    x, y = table_4_row(distance, angle_deg)[2:4]
    return float(np.sqrt(x * y))


def conventional_dem_cells(
    points, grid: Grid, posting: float, phase: tuple[float, float] = (0.0, 0.0)
):
    """Return the conventional DEM of a scan, and its cell at each cell of `grid`.

    `points` (n, 3) are the LiDAR returns, m. The DEM has the grid spacing `posting` (m); `phase`
    shifts its grid east and north by fractions of a cell. The second value holds the row and column
    indices of the DEM cell at each cell of `grid`.
    """
    width, height = grid.cols * grid.posting, grid.rows * grid.posting
    coarse = Grid.centred(grid.centre, width, posting, height).moved(np.multiply(phase, posting))
    row, col = coarse.cell(grid.centres())
    nearest = (np.clip(row, 0, coarse.rows - 1), np.clip(col, 0, coarse.cols - 1))
    return conventional_dem(points, coarse), nearest


def complexity_terrain(c: float, seed: int) -> tuple[np.ndarray, Grid]:
    """Generate terrain by Eq. 20 of the DEM paper; return elevations (m) and grid.

    The terrain is a plane with rocks of 0.2 to 1 m plus `c` times a measured HiRISE relief. The
    grid spacing is 0.1 m.
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


def table_3(seed: int) -> tuple[Rows, list[Any]]:
    """Evaluate the conservative safety test on error-free terrain by complexity.

    The complexity `c` is a factor on the measured relief (Table 3 of the Gaussian DEM paper).
    Returns a row per complexity, and the maps for the figure.
    """
    rows, shown = [], []
    for c, paper in PAPER_3.items():
        z, grid = complexity_terrain(c, seed)
        exact = exact_safety(z, grid, LANDER).safe
        level = conservative_safety(z, grid, LANDER).safe
        planes = bounded_safety(z, grid, LANDER).safe
        own, bounded = MapQuality.of(level, exact), MapQuality.of(planes, exact)
        rows.append({
            "c": c, "precision": own.precision, "recall": own.recall, "bounded": bounded.recall,
            "paper": paper, "false_safe": own.false_safe + bounded.false_safe,
        })  # fmt: skip
        shown.append((c, z, exact, level, planes, grid))
    return rows, shown


def table_4_row(distance: float, angle_deg: float) -> tuple[float, float, float, float, float]:
    """Return coverage, ground sample distance and noise of a LiDAR scan of a plane.

    `distance` is the range (m), `angle_deg` the angle off nadir (deg). Returns one row of Table 4
    of the Gaussian DEM paper in closed form: coverage x, y (m), ground sample distance x, y (m) and
    3 sigma of the range noise (cm).
    """
    angle, half = np.deg2rad(angle_deg), np.arctan(0.1)
    height = distance * np.cos(angle)
    x = height * (np.tan(angle + half) - np.tan(angle - half))
    return x, 0.2 * distance, x / 256, 0.2 * distance / 256, 100 * 0.05 * distance / 500


def table_4(seed: int) -> tuple[Rows, None]:
    """Compute coverage, sample distance and noise of nine LiDAR scans (Table 4).

    `seed` has no effect; the values are closed-form results of `table_4_row`.
    """
    return [{**scan_of(n), "values": table_4_row(*CONFIGURATIONS[n])} for n in SCANS], None


def scan_of(configuration: int) -> dict[str, float]:
    """Return range (m) and angle off nadir (deg) of a scan configuration, for a row."""
    distance, angle = CONFIGURATIONS[configuration]
    return {"distance_m": distance, "angle_deg": angle}


def negative_log_density(error: np.ndarray, variance: np.ndarray | float) -> float:
    """Return the mean negative log predictive density of DEM errors.

    `error` is the elevation error (m) of each cell and `variance` its predicted variance (m^2). Eq.
    24 of the Gaussian DEM paper.
    """
    return float(np.mean(error**2 / (2 * variance) + 0.5 * np.log(2 * np.pi * variance)))


def table_5(seed: int) -> tuple[Rows, dict[str, list[Any]]]:
    """Compute elevation errors of the baseline and proposed DEMs (Table 5).

    The baseline of the Gaussian DEM paper is a conventional DEM; the proposed one is the Gaussian
    DEM. Returns a row per scan configuration: RMSE of the baseline (mean, minimum and maximum over
    the shifts of its grid) and of the proposed DEM (m), and negative log predictive density of
    both. The maps are for the figures.
    """
    rows = []
    shown: dict[str, list[Any]] = {"baseline": [], "mean": [], "sigma": []}
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
            coarse, nearest = conventional_dem_cells(one.points, one.grid, posting, phase)
            error = (coarse.elevation[nearest] - truth)[inside].astype(float)
            rmse.append(rms(error))
            nlpd.append(negative_log_density(error, one.sigma**2))
            if phase == (0.0, 0.0):
                shown["baseline"].append((coarse.elevation[nearest], one.grid, one.points))
        own = (one.dem.mean - truth)[inside].astype(float)
        rows.append({
            **scan_of(n), "rmse_baseline": statistics.mean(rmse), "rmse_proposed": rms(own),
            "nlpd_baseline": statistics.mean(nlpd),
            "nlpd_proposed":
            negative_log_density(own, one.dem.variance[inside].astype(float)),
            "rmse_best_phase": min(rmse), "rmse_worst_phase": max(rmse),
        })  # fmt: skip
        shown["mean"].append((one.dem.mean, one.grid, one.points))
        shown["sigma"].append((np.sqrt(one.dem.variance), one.grid, one.points))
    return rows, shown


def rms(error: np.ndarray) -> float:
    """Return the root mean square of the errors."""
    return float(np.sqrt(np.mean(error**2)))


@dataclass(frozen=True)
class ScanEvaluation:
    """Safety probabilities by all methods for one scan of a testbed, and the truth.

    Attributes
    ----------
    p
        Probability of safety on the grid, by method and kind of hazard ("slope", "roughness"): a
        list of maps, for the baseline one per shift of its grid, else one.
    truth
        True safety on the grid, by kind of hazard.
    evaluated
        Cells for which the truth and all methods have a value.
    p_safe
        Probability that slope and roughness are both safe, by the proposed method.
    scan
        The LiDAR scan and its Gaussian DEM.
    """

    p: dict[tuple[str, str], list[np.ndarray]]
    truth: dict[str, np.ndarray]
    evaluated: np.ndarray
    p_safe: np.ndarray
    scan: ScannedDem


def truth_of(field: TestbedField, scanned: ScannedDem) -> dict[str, np.ndarray]:
    """Return whether true slope and roughness are safe, on the grid of a scan.

    `field` is the simulated testbed and `scanned` a scan of it. Returns a boolean map by kind of
    hazard.
    """
    return {
        "slope": field.safety.slope[scanned.window] < LANDER.slope_limit,
        "roughness": field.safety.roughness[scanned.window] < LANDER.roughness_limit,
    }


def evaluate_scan(field: TestbedField, seed: int, configuration: int) -> ScanEvaluation:
    """Scan a testbed in one configuration; compute its safety by all methods.

    The methods are the conventional DEM, the Gaussian DEM, and support planes on the Gaussian DEM.
    `configuration` is an index of `CONFIGURATIONS`. `seed` and `configuration` together seed the
    scan noise.
    """
    distance, angle = CONFIGURATIONS[configuration]
    scanned = map_testbed(
        field, distance, angle, np.random.default_rng([seed, configuration]), **MARGIN
    )
    # Occluded cells have the prior variance and therefore count as unsafe.
    own = stochastic_safety(scanned.dem.mean, scanned.dem.variance, scanned.grid, LANDER)
    planes = plane_stochastic_safety(scanned.dem.mean, scanned.dem.variance, scanned.grid, LANDER)
    evaluated = own.observed & field.safety.observed[scanned.window]
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
        coarse, nearest = conventional_dem_cells(scanned.points, scanned.grid, posting, phase)
        other = alhat_safety(coarse.elevation, coarse.grid, LANDER, sigma=scanned.sigma)
        evaluated &= other.observed[nearest]
        p["baseline", "slope"].append(other.p_slope[nearest])
        p["baseline", "roughness"].append(other.p_roughness[nearest])
    return ScanEvaluation(p, truth_of(field, scanned), evaluated, own.p_safe, scanned)


def table_6(seed: int) -> tuple[Rows, dict[str, list[Any]]]:
    """Compute precision, recall and calibration of the safety tests (Table 6).

    The methods are the baseline of the Gaussian DEM paper (conventional DEM), the proposed one
    (Gaussian DEM) and support planes. Returns a row per scan configuration: "counts" has the
    numbers of unsafe and of safe cells by probability for each method and kind of hazard, for
    instance "proposed slope", and "at_half" precision and recall at p > 0.5. The counts of the
    baseline are summed over the shifts of its grid. "reliability" is the calibration table of
    p_safe. The maps are for the figures.
    """
    rows = []
    shown: dict[str, list[Any]] = {f"{m} {k}": [] for m in METHODS[:2] for k in KINDS}
    field = testbed(seed)
    for n in SCANS:
        one = evaluate_scan(field, seed, n)
        seen, counts, at_half = one.evaluated, {}, {}
        for (method, kind), maps in one.p.items():
            truth, name = one.truth[kind], f"{method} {kind}"
            pooled = pool_counts([PrecisionRecall.of(p[seen], truth[seen]) for p in maps])
            half = pooled.at_half()
            counts[name] = [pooled.unsafe, pooled.safe]
            at_half[name] = [half.precision, half.recall]
            if method != "planes":
                missing = np.where(seen, truth - maps[0], np.nan)
                shown[name].append((missing, one.scan.grid, one.scan.points))
        safe = np.logical_and(*one.truth.values())
        table = reliability(one.p_safe[seen], safe[seen], np.linspace(0.0, 1.0, 21))
        rows.append({**scan_of(n), "counts": counts, "at_half": at_half, "reliability": table})
    return rows, shown


def pool_counts(counts: list[PrecisionRecall]) -> PrecisionRecall:
    """Add up precision-recall counts of several maps."""
    return reduce(operator.add, counts)


def median_time(call: Callable[[], Any], repeats: int) -> float:
    """Return the median run time of `repeats` calls after one warm-up call, s."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def table_7(seed: int) -> tuple[Rows, None]:
    """Measure run times of DEMs and safety tests at four grid spacings (Table 7).

    The input is a scan of 65,536 points from 500 m over 100 x 100 m. `seed` has no effect. A row
    has the grid spacing (m) and the times (s) of the baseline safety test, the Gaussian DEM and the
    stochastic safety test.
    """
    field = testbed(0, side=20.0)
    points, sigma, shape = scan(field, 500.0, 0.0, np.random.default_rng(0))
    rows = []
    for posting in PAPER_7:
        grid = Grid.centred((0.0, 0.0), 100.0, posting)

        def build(grid: Grid = grid):
            return gaussian_dem(points, grid, sigma_eps=sigma, image_shape=shape, **MARGIN)

        dem = build()
        rows.append({
            "posting": posting,
            "baseline": median_time(lambda: alhat_safety(dem.mean, grid, LANDER, sigma=sigma), 3),
            "dem": median_time(build, 9),
            "safety": median_time(
                lambda: stochastic_safety(dem.mean, dem.variance, grid, LANDER), 9
            ),
        })  # fmt: skip
    return rows, None
