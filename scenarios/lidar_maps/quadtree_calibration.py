"""How often sites are safe that the quadtree calls so: the fit, and worlds kept out of it.

As `calibration.py` does for the Gaussian DEM: four flashes of each scene of the same matrix make a
quadtree, of which the sites are judged by exact safety.

python scenarios/lidar_maps/quadtree_calibration.py --scenes 240 --jobs 2 --out out/lidar_maps
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click
import numpy as np
from calibration import SITES, Method, options, study
from kept import Judged
from worlds import LANDERS, UPRIGHT, Scene, scenes

from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector, SiteSettings
from lunarsim.onboard.hazards.quadtree.site_probability import (
    HOPELESS,
    RISING,
    bound,
    ceiling,
    evidence_of,
    features,
)
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import exact_safety
from lunarsim.safety.ensemble import MARGIN

FLASHES = 4
# Half side of the landing zone over that of the lander's footprint, as in the paper.
ZONE = 1.35
# The paper's map wants five points on a square metre: farther away there is none.
NEAREST, FARTHEST = 80.0, 420.0


def judge(scene: Scene) -> Judged:
    """Map one scene by a few flashes and judge some of the sites."""
    terrain, grid, lander = scene.terrain(), scene.grid(), LANDERS[scene.lander]
    west, east, _, _ = grid.extent
    level = float(terrain.elevation(np.zeros(2)))
    quadtree = QuadtreeMap((0.0, 0.0, level), east - west, 0.1)
    for n in range(FLASHES):
        nearer = replace(scene, distance=scene.distance * (1.0 - 0.08 * n))
        scan, position = nearer.flash(terrain)
        quadtree.insert(scan.points(position, UPRIGHT))
        noise = float(np.nanmedian(scan.height_sigma(UPRIGHT)))
    footprint = lander.leg_radius + 0.5 * lander.pad_diameter
    settings = replace(
        SiteSettings(), zone=ZONE * footprint, roughness_limit=lander.roughness_limit
    )
    selection = SiteSelector(quadtree, settings, thorough=True, footprint=footprint).update()
    evidence = evidence_of(quadtree, selection, settings.zone, noise, lander, RockExpectation())
    truth = exact_safety(terrain.raster(grid), grid, lander)
    row, col = grid.cell(selection.position[:, :2])
    inside = (row >= 0) & (col >= 0) & (row < grid.rows) & (col < grid.cols)
    row, col = np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)
    sites = np.flatnonzero(evidence.judged & inside & truth.observed[row, col])
    sites = np.sort(scene.rng(4).choice(sites, min(SITES, len(sites)), replace=False))
    where = np.zeros(len(row), bool)
    where[sites] = True
    return Judged(
        scene,
        features(evidence, where).astype(np.float32),
        evidence.in_domain[where],
        ceiling(evidence)[where],
        bound(evidence)[where],
        evidence.slope[where],
        evidence.doomed[where],
        float(evidence.curve.at(lander.roughness_limit)),
        truth.safe[row, col][where],
    )


def drawn(count: int, seed: int) -> list[Scene]:
    """Return scenes that are near enough for the paper's density of points."""
    rng = np.random.default_rng([seed, 98])
    reach = np.exp(rng.uniform(np.log(NEAREST), np.log(FARTHEST), count))
    deck = scenes(count, seed)
    return [replace(s, distance=float(r)) for s, r in zip(deck, reach, strict=True)]


@click.command()
@options(240, "lunarsim/onboard/hazards/quadtree/calibration.json")
def main(**wanted: Any) -> None:
    """Fit the quadtree's probability, and judge it on worlds kept out of the fit."""
    command = "scenarios/lidar_maps/quadtree_calibration.py"
    study(Method(command, judge, drawn, RISING, MARGIN, HOPELESS), **wanted)


if __name__ == "__main__":
    main()
