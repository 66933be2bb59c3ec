"""Compare p_safe of the Gaussian DEM with the posterior probability that the scan allows.

Worlds are drawn from the prior that the reference knows: fractal relief and hemispherical rocks.
One scan from vertically above observes each world. At random sites, the table has p_safe of the
map, the reference (`lunarsim.studies.posterior_safety`) and the exact safety. A site is claimed
as safe if its probability exceeds 0.95, on the map also in the calibrated domain.

python scenarios/lidar_maps/reference_posterior.py --worlds 30 --jobs 2
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.table import Table
from worlds import UPRIGHT, scan_from_above

from lunarsim import Grid, Terrain, site_safety
from lunarsim.api import Lander
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.rocks.population import RockExpectation
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.studies import Case, PatchPrior, Report, Study, posterior_safety, run_script
from lunarsim.world.terrain import fractal_relief, place_rocks

# RMS slopes of the relief, deg, and rock covers; each world draws one of each.
SLOPES_DEG, COVERS = (0.5, 1.0, 2.0, 3.0, 4.0), (0.01, 0.02, 0.03, 0.05, 0.07)
DISTANCES = (100.0, 200.0, 350.0, 500.0)
SIDE = 40.0
SITES = 5
EDGE_M = 3.5  # distance of sites from the edge of the map
MAX_DIAMETER_M = 2.0
CLAIM_P = 0.95
LANDER = Lander()


def draw_world(case: Case) -> tuple[PatchPrior, Terrain]:
    """Draw the prior of a world, and its terrain of 70 x 70 m."""
    rng = np.random.default_rng([case.seed, case.number])
    prior = PatchPrior(
        cover=float(rng.choice(COVERS)), max_diameter=MAX_DIAMETER_M,
        rms_slope=float(np.deg2rad(rng.choice(SLOPES_DEG))), terrain_size=70.0,
    )  # fmt: skip
    grid = Grid.centred((0.0, 0.0), prior.terrain_size, prior.posting)
    relief = fractal_relief(grid, rng, hurst=prior.hurst, rms_slope=prior.rms_slope)
    area = prior.terrain_size**2
    diameters = sample_diameters(area, prior.cover, prior.min_diameter, prior.max_diameter, rng)
    return prior, Terrain(relief, place_rocks(relief, diameters, rng))


def measure(case: Case) -> list[dict[str, Any]]:
    """Return one row for each distance and random site of one world."""
    prior, terrain = draw_world(case)
    expected, rows = RockExpectation(cover=prior.cover), []
    for distance in DISTANCES:
        rng = np.random.default_rng([case.seed, case.number, int(distance)])
        lidar = FlashLidar(256, 256, max(0.1, 0.5 * SIDE / distance))
        scan, pose = scan_from_above(terrain, lidar, distance, rng)
        mapper = GaussianDemMapper(Grid.centred((0.0, 0.0), SIDE, 0.2), LANDER, rocks=expected)
        mapper.update(scan, pose)
        hazards = mapper.hazard_map()
        points, sigma = scan.points(pose.position, UPRIGHT), scan.height_sigma(UPRIGHT)
        grid = hazards.grid
        inner = np.nonzero((np.abs(grid.centres()) < 0.5 * SIDE - EDGE_M).all(axis=-1).ravel())[0]
        for cell in rng.choice(inner, SITES, replace=False):
            i, j = divmod(int(cell), grid.cols)
            x, y = grid.centre_of(i, j)
            here = points - [x, y, 0.0]
            found = posterior_safety(here, sigma, prior, LANDER, rng)
            site = Grid(x, y, grid.posting, 1, 1)
            rows.append({
                "distance": distance, "reference": found.p_safe,
                "samples": found.effective_samples, "map": float(hazards.p_safe[i, j]),
                "in_domain": bool(hazards.in_domain[i, j]),
                "safe": bool(site_safety(terrain, site, LANDER)[0][0, 0]),
            })  # fmt: skip
    return rows


def print_comparison(report: Report) -> None:
    """Print errors and claims of the reference and the map by distance, and the reliability."""
    table = Table(title=f"Probabilities of random sites; claims exceed {CLAIM_P:g}")
    for heading in (
        "Range (m)", "Source", "Sites", "Mean probability", "Safe, fraction", "Brier score",
        "Claimed, fraction", "Precision of claims", "Recall of claims",
    ):  # fmt: skip
        table.add_column(heading, justify="left" if heading == "Source" else "right")
    groups = [(f"{d:g}", rows) for (d,), rows in report.groups("distance").items()]
    for name, rows in (*groups, ("all", report.rows)):
        safe = np.array([row["safe"] for row in rows])
        for source in ("reference", "map"):
            p = np.array([row[source] for row in rows])
            claim = p > CLAIM_P
            if source == "map":
                claim &= [row["in_domain"] for row in rows]
            table.add_row(
                name, source, str(len(rows)), f"{p.mean():.3f}", f"{safe.mean():.3f}",
                f"{np.mean((p - safe) ** 2):.4f}", f"{claim.mean():.3f}",
                f"{safe[claim].mean():.4f}" if claim.any() else "-",
                f"{claim[safe].mean():.3f}" if safe.any() else "-",
            )  # fmt: skip
    report.print(table)
    table = Table(title="Reliability of the reference, all ranges")
    for heading in ("Probability", "Sites", "Mean probability", "Safe, fraction"):
        table.add_column(heading, justify="right")
    p = np.array([row["reference"] for row in report.rows])
    safe = np.array([row["safe"] for row in report.rows])
    for low, high in ((0.0, 0.05), (0.05, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.0)):
        inside = (p >= low) & ((p < high) | (high == 1.0))
        if inside.any():
            table.add_row(
                f"{low:g} to {high:g}", str(inside.sum()), f"{p[inside].mean():.3f}",
                f"{safe[inside].mean():.3f}",
            )  # fmt: skip
    report.print(table)
    samples = [row["samples"] for row in report.rows if np.isfinite(row["samples"])]
    if samples:
        report.print(
            f"Effective samples of sites with safe and unsafe patches: median "
            f"{np.median(samples):.0f} of 200, minimum {min(samples):.0f}."
        )


study = Study(measure, repeats="worlds", count=30, report=print_comparison)

if __name__ == "__main__":
    run_script(study)
