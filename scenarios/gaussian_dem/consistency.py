"""Check the variance of the Gaussian DEM on descents over several terrains (NEES).

Four scans from decreasing altitudes observe fractal terrain with ellipsoid boulders. After each
scan, the ratio of the squared elevation error to the predicted variance (normalised estimation
error squared, NEES) is averaged over the observed cells of three groups: cells that contain
LiDAR samples, cells between samples, and cells that the map shows as rocks. A rock stands 0.12 m,
or four times the noise of the first scan, above the terrain without rocks. A NEES of 1 is
consistent; a larger value is overconfident, a smaller value is conservative.

python scenarios/gaussian_dem/consistency.py --descents 4 --jobs 2
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import click
import numpy as np
from rich.table import Table

from lunarsim import Grid, Terrain
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.gaussian import MIN_MEASURED_WEIGHT
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.world.terrain import fractal_relief, place_rocks

STRATA = ("measured", "interpolated", "on rocks")
# Sample spacing and standard deviation of each scan, m.
DESCENT = ((0.8, 0.03), (0.6, 0.025), (0.45, 0.02), (0.3, 0.012))
# Minimum height above the terrain without rocks at which a cell counts as rock, m.
MIN_ROCK_HEIGHT = 0.12
GRID = Grid.centred((0.0, 0.0), 24.0, 0.2)


@dataclass(frozen=True)
class DemTerrainParams:
    """Parameters of one kind of fractal test terrain with boulders.

    `slope` is the RMS slope (deg), `hurst` the Hurst exponent, `diameters` the range of boulder
    diameters (m) and `rocks` the number of boulders.
    """

    slope: float = 5.0
    hurst: float = 0.85
    diameters: tuple[float, float] = (0.4, 1.2)
    rocks: int = 60


WORLDS = {
    "5 deg, boulders of 0.4 to 1.2 m": DemTerrainParams(),
    "1 deg": DemTerrainParams(slope=1.0),
    "12 deg": DemTerrainParams(slope=12.0),
    "Hurst exponent 0.6": DemTerrainParams(hurst=0.6),
    "Hurst exponent 0.95": DemTerrainParams(hurst=0.95),
    "3 deg, 300 boulders of 0.3 to 0.6 m": DemTerrainParams(3.0, 0.85, (0.3, 0.6), 300),
    "3 deg, 30 boulders of 1 to 2 m": DemTerrainParams(3.0, 0.85, (1.0, 2.0), 30),
    "6 deg, no boulders": DemTerrainParams(slope=6.0, rocks=0),
}


def make_terrain(params: DemTerrainParams, rng: np.random.Generator) -> Terrain:
    """Generate fractal terrain of 60 x 60 m with ellipsoid boulders."""
    grid = Grid.centred((0.0, 0.0), 60.0, 0.25)
    relief = fractal_relief(grid, rng, hurst=params.hurst, rms_slope=np.deg2rad(params.slope))
    diameters = rng.uniform(*params.diameters, params.rocks)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("ellipsoid")))


def scan(terrain: Terrain, spacing: float, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Return noisy elevation samples (n, 3) of a terrain from nadir, m.

    `spacing` is the sample spacing and `sigma` the standard deviation of the noise, m.
    """
    line = np.arange(-15.9, 16.0, spacing)
    x, y = np.meshgrid(line, line)
    xy = np.column_stack((x.ravel(), y.ravel())) + 0.5 * spacing * rng.uniform(-0.5, 0.5, 2)
    return np.column_stack((xy, terrain.elevation(xy) + sigma * rng.standard_normal(len(xy))))


def nees_of_descent(case: Case) -> dict[str, Any]:
    """Return the sums of the DEM's NEES over one descent, and the numbers of cells.

    NEES is the squared elevation error over the predicted variance. Both lists have one value per
    group of cells in `STRATA`: measured, interpolated, on rocks.
    """
    name, times = case["world"], case["noise"]
    rng = np.random.default_rng([case.seed, case.number, list(WORLDS).index(name)])
    terrain = make_terrain(WORLDS[name], rng)
    truth = terrain.raster(GRID)
    bare = Terrain(terrain.relief, RockField.empty()).raster(GRID)
    pool, total = SamplePool(GRID), np.zeros((len(STRATA), 2))
    for spacing, usual in DESCENT:
        sigma = times * usual
        pool.add(scan(terrain, spacing, sigma, rng), sigma, spacing)
        dem = pooled_dem(pool)
        square = (dem.mean - truth) ** 2 / dem.variance
        # A lower limit would select cells by their noise.
        shown = max(MIN_ROCK_HEIGHT, 4.0 * times * DESCENT[0][1])
        rock, measured = dem.mean - bare > shown, pool.splat[..., 0] > MIN_MEASURED_WEIGHT
        for n, where in enumerate((measured & ~rock, ~measured & ~rock, rock)):
            own = square[dem.observed & where]
            total[n] += own.sum(), own.size
    return {"nees_sum": total[:, 0], "cells": total[:, 1]}


def print_nees(report: Report) -> None:
    """Print the NEES of measured, interpolated and rock cells for each terrain."""
    groups = report.groups("world")
    most = max(map(len, groups.values()))
    table = Table(title=f"NEES over {most} descents of {len(DESCENT)} scans (number of cells)")
    for heading in ("world", *STRATA):
        table.add_column(heading, justify="left" if heading == "world" else "right")
    for (name,), rows in groups.items():
        sums, counts = (np.sum([row[k] for row in rows], axis=0) for k in ("nees_sum", "cells"))
        cells = zip(sums, counts, strict=True)
        table.add_row(name, *(f"{s / c:.2f} ({c:.0f})" if c else "-" for s, c in cells))
    report.print(table)


study = Study(
    nees_of_descent,
    repeats="descents",
    count=4,
    factors={"world": list(WORLDS)},
    factor_help={"world": "Kind of terrain."},
    report=print_nees,
    options=(
        click.Option(
            ["--noise"], type=click.FloatRange(min=0.0, min_open=True), default=1.0,
            show_default=True,
            help="Factor by which the noise of the LiDAR samples is multiplied.",
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
