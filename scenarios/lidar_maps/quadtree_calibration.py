"""Fit the safety probability of the quadtree and test it on held-out terrains.

The method is that of `calibration.py`: four LiDAR scans of each scene of the same matrix build a
quadtree, and its sites are compared with exact safety.

python scenarios/lidar_maps/quadtree_calibration.py --scenes 240 --jobs 2 --out out/lidar_maps
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click
import numpy as np
from calibration import SITES, CalibrationMethod, options, study
from scene_cache import SceneSites
from worlds import LANDERS, UPRIGHT, LidarScene, sample_matrix

from lunarsim import site_safety
from lunarsim.onboard.calibration.quadtree import QUADTREE
from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector, SiteSettings
from lunarsim.onboard.hazards.quadtree.site_evidence import quadtree_site_evidence
from lunarsim.rocks.population import RockExpectation

FLASHES = 4
# Ratio of the half side of the landing zone to that of the lander footprint, as in the paper.
ZONE = 1.35
# Range limits, m. The map of the paper requires five points per square metre, which limits the
# maximum.
MIN_RANGE, MAX_RANGE = 80.0, 420.0


def evaluate_scene(scene: LidarScene) -> SceneSites:
    """Build a quadtree from LiDAR scans of a scene; evaluate a sample of its sites."""
    terrain, grid, lander = scene.terrain(), scene.grid(), LANDERS[scene.lander]
    west, east, _, _ = grid.extent
    level = float(terrain.elevation(np.zeros(2)))
    quadtree = QuadtreeMap((0.0, 0.0, level), east - west, 0.1)
    for n in range(FLASHES):
        nearer = replace(scene, distance=scene.distance * (1.0 - 0.08 * n))
        scan, position = nearer.simulate_scan(terrain)
        quadtree.insert(scan.points(position, UPRIGHT))
        noise = float(np.nanmedian(scan.height_sigma(UPRIGHT)))
    footprint = lander.leg_radius + 0.5 * lander.pad_diameter
    settings = replace(
        SiteSettings(), zone_half_side=ZONE * footprint, roughness_limit=lander.roughness_limit
    )
    selection = SiteSelector(quadtree, settings, thorough=True, footprint=footprint).update()
    evidence = quadtree_site_evidence(
        quadtree, selection, settings.zone_half_side, noise, lander, RockExpectation()
    )
    xy = selection.position[:, :2]
    sites = np.flatnonzero(evidence.observed & grid.contains(xy))
    sites = np.sort(scene.rng(4).choice(sites, min(SITES, len(sites)), replace=False))
    row, col = grid.cell(xy[sites])
    cells = np.zeros(grid.shape, bool)
    cells[row, col] = True
    safe, known = site_safety(terrain, grid, lander, where=cells)
    sites = sites[known[row, col]]
    where = np.zeros(len(xy), bool)
    where[sites] = True
    return SceneSites.of(scene, evidence, where, safe[row, col][known[row, col]])


def sample_scenes(count: int, seed: int) -> list[LidarScene]:
    """Sample scenes at ranges that give the point density of the quadtree paper."""
    rng = np.random.default_rng([seed, 98])
    reach = np.exp(rng.uniform(np.log(MIN_RANGE), np.log(MAX_RANGE), count))
    deck = sample_matrix(count, seed)
    return [replace(s, distance=float(r)) for s, r in zip(deck, reach, strict=True)]


@click.command()
@options(240, "lunarsim/onboard/calibration/quadtree.json")
def main(**values: Any) -> None:
    """Fit the safety probability of the quadtree; test it on held-out terrains."""
    command = "scenarios/lidar_maps/quadtree_calibration.py"
    study(
        CalibrationMethod(command, evaluate_scene, sample_scenes, QUADTREE),
        **values,
    )


if __name__ == "__main__":
    main()
