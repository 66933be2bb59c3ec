"""Measure what the Gaussian DEM claims with wide LiDAR beams and with lost returns.

One scan from vertically above observes fractal relief with rocks of the Golombek distribution. The
mapper knows the divergence of the beam. A cell is claimed as safe if `p_safe` exceeds 0.95 in the
calibrated domain. Truth is the exact safety on terrain sampled every 0.05 m.

python scenarios/lidar_maps/beam_width.py --worlds 6
python scenarios/lidar_maps/beam_width.py --worlds 3 --loss 0.3
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click
import numpy as np
from rich.table import Table
from worlds import scan_from_above

from lunarsim import Grid, Heightfield, Terrain, site_safety
from lunarsim.api import HazardMap, Lander
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.population import RockExpectation
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.studies import Case, Report, Study, run_script
from lunarsim.world.terrain import fractal_relief, place_rocks

# RMS slope of the relief, deg, and rock cover of each world; they repeat.
WORLDS = ((0.0, 0.05), (1.0, 0.07), (2.0, 0.02), (3.0, 0.05), (4.0, 0.03), (5.0, 0.05))
DISTANCES = (100.0, 200.0, 300.0, 500.0)
DIVERGENCES_MRAD = (0.0, 0.2, 0.4, 0.8, 1.5, 3.0)
SIDE, REACH = 40.0, 3.2
GRID = Grid.centred((0.0, 0.0), SIDE, 0.2)
LANDER = Lander()


def make_terrain(number: int, seed: int) -> Terrain:
    """Generate the world with a number: relief of 70 x 70 m with ellipsoid rocks."""
    slope, cover = WORLDS[number % len(WORLDS)]
    rng, grid = np.random.default_rng([seed, number]), Grid.centred((0.0, 0.0), 70.0, 0.25)
    relief = Heightfield(grid, np.zeros(grid.shape, np.float32))
    if slope:
        relief = fractal_relief(grid, rng, hurst=0.85, rms_slope=np.deg2rad(slope))
    diameters = sample_diameters(70.0**2, cover, 0.1, 2.0, rng)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("ellipsoid")))


def map_of(
    terrain: Terrain, cover: float, distance: float, mrad: float, loss: float, seed: Any
) -> HazardMap:
    """Return the hazard map of one scan.

    `distance` is in m, `mrad` the divergence, and `loss` the fraction of returns that are lost.
    """
    # From 100 m, the field of view is doubled, so that it covers the map.
    wide = 2 if distance < 200.0 else 1
    lidar = FlashLidar(256 * wide, 256 * wide, 0.1 * wide, divergence=mrad * 1e-3)
    rng = np.random.default_rng(seed)
    scan, pose = scan_from_above(terrain, lidar, distance, rng)
    lost = rng.random(scan.range.size) < loss
    rocks, ratio = replace(RockExpectation(), cover=cover), lidar.calibration().beam_ratio
    mapper = GaussianDemMapper(GRID, LANDER, rocks=rocks, beam_ratio=ratio)
    mapper.update(replace(scan, range=np.where(lost, np.nan, scan.range)), pose)
    return mapper.hazard_map()


def measure(case: Case) -> list[dict[str, Any]]:
    """Return the numbers of safe, observed and claimed cells of one world."""
    terrain = make_terrain(case.number, case.seed)
    safe, _ = site_safety(terrain, GRID, LANDER)
    inside = np.abs(GRID.x) < 0.5 * SIDE - REACH
    where, rows = np.outer(inside, inside), []
    cover = WORLDS[case.number % len(WORLDS)][1]
    divergences = DIVERGENCES_MRAD if case["loss"] == 0.0 else (0.0,)
    for distance in DISTANCES:
        for mrad in divergences:
            seed = [case.seed, case.number, int(distance)]
            found = map_of(terrain, cover, distance, mrad, case["loss"], seed)
            claim = (found.p_safe > 0.95) & found.in_domain & where
            rows.append({
                "distance": distance, "divergence": mrad, "cells": int(where.sum()),
                "observed": int((found.observed & where).sum()), "safe": int((safe & where).sum()),
                "claimed": int(claim.sum()), "correct": int((claim & safe).sum()),
            })  # fmt: skip
    return rows


def print_claims(report: Report) -> None:
    """Print claims, their precision and recall for each distance and divergence."""
    table = Table(title="Claims of the Gaussian DEM, by range and divergence")
    for heading in (
        "Range (m)", "Divergence (mrad)", "Observed, fraction", "Claimed safe, fraction",
        "Precision, all worlds", "Precision, minimum", "Recall", "Claimed unsafe cells",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for (distance, mrad), rows in report.groups("distance", "divergence").items():
        names = ("cells", "observed", "safe", "claimed", "correct")
        cells, observed, safe, claimed, correct = (sum(row[n] for row in rows) for n in names)
        each = [row["correct"] / row["claimed"] for row in rows if row["claimed"]]
        precision = f"{correct / claimed:.4f}" if claimed else "-"
        table.add_row(
            f"{distance:g}", f"{mrad:g}", f"{observed / cells:.3f}", f"{claimed / cells:.3f}",
            precision, f"{min(each):.4f}" if each else "-", f"{correct / safe:.3f}",
            str(claimed - correct),
        )  # fmt: skip
    report.print(table)


study = Study(
    measure,
    repeats="worlds",
    count=6,
    report=print_claims,
    options=(
        click.Option(
            ["--loss"], type=click.FloatRange(0.0, 1.0, max_open=True), default=0.0,
            show_default=True, help="Fraction of the returns that are lost; above 0: line beam.",
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    run_script(study)
