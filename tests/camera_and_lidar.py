"""What two eyes know of made ground, all of whose sites are alike or as the arrays say."""

from __future__ import annotations

import numpy as np

from lunarsim.grid import Grid
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.hazards.fusion.elevation_samples import ElevationSamples
from lunarsim.onboard.hazards.fusion.flat_terrain import (
    apply_ceiling,
    flat_terrain_probability,
    no_undetected_rock_probability,
)
from lunarsim.onboard.hazards.fusion.priors import FusionPriors
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.map_evidence import RockEvidence, RockTracks, TerrainEvidence
from lunarsim.rocks.population import RockExpectation
from tests.map_evidence import LANDER, SIDE, evidence, rocky

GRID = Grid(0.0, 0.0, 0.5, SIDE, SIDE)
TERMS = FusionPriors(LANDER, RockExpectation())
DIAMETERS = np.array([0.5, 0.8])
FOOTPRINT = LANDER.leg_radius + 0.5 * LANDER.pad_diameter


def relief(bump=None, **said) -> TerrainEvidence:
    """Return a calibrated map; `bump` is elevations (rows, cols) to be added to level ground."""
    judged = evidence(**said)
    p, known = calibrated_safety(judged)
    z = np.zeros(GRID.shape, np.float32) if bump is None else bump.astype(np.float32)
    return TerrainEvidence(HazardMap(GRID, p, judged.observed, z, in_domain=known), judged)


def level_map(judged, prior, none_missed=0.0) -> np.ndarray:
    """Return the probability of level ground without a tracked rock (rows, cols)."""
    unseen = no_undetected_rock_probability(judged, none_missed)
    return apply_ceiling(judged, flat_terrain_probability(judged, prior, unseen))


def tracks(*rocks) -> RockTracks:
    """Return rocks, each of (x, y, radius, existence)."""
    table = np.array(rocks, np.float64).reshape(-1, 4)
    n = len(table)
    return RockTracks(table[:, :2], np.full(n, 0.05), table[:, 2], np.full(n, 0.01), table[:, 3])


def clear(rocks: RockTracks) -> np.ndarray:
    """Return the product over rocks whose discs reach into the footprint."""
    out = np.ones(GRID.shape)
    xy = GRID.centres()
    for place, radius, there in zip(rocks.xy, rocks.radius, rocks.existence, strict=True):
        far = np.hypot(*np.moveaxis(xy - place, -1, 0))
        out *= 1.0 - there * (far < FOOTPRINT + radius)
    return out


def eyes(ratio=1.0, found=None, p=0.97, seen=True, of=GRID, **more) -> RockEvidence:
    """Return what an eye for rocks knows: one ratio everywhere, or as the array (rows, cols)."""
    whole = np.empty((len(DIAMETERS), *of.shape), np.float32)
    whole[:] = ratio
    drawn = HazardMap(
        of,
        np.full(of.shape, p, np.float32),
        np.full(of.shape, seen),
        np.zeros(of.shape, np.float32),
    )
    return RockEvidence(drawn, DIAMETERS, whole, found or tracks(), clear, **more)


SAMPLED = np.zeros(GRID.shape, np.float32)
# Samples so few on ground so rocky that elevations alone doubt all of it.
DOUBTED = {"density": 0.5, "curve": rocky(20.0), "level": -4.0, "planes": -0.6}


def raster(value: float) -> np.ndarray:
    """Return one value everywhere."""
    return np.full(GRID.shape, value, np.float32)


def samples(own: TerrainEvidence) -> ElevationSamples:
    """Return what elevations say of the places of rocks."""
    return ElevationSamples(
        own.residual_heights, own.site_evidence.density, GRID, TERMS.height_ratio
    )


def bumps(xy, grid, height, density, rng) -> np.ndarray:
    """Return samples of half spheres, at random cells, so many on a square metre."""
    residual_heights = rng.normal(0.0, 0.02, grid.shape)
    for place in xy:
        far = np.hypot(*np.moveaxis(grid.centres() - place, -1, 0))
        residual_heights = np.maximum(
            residual_heights, np.sqrt(np.clip(height**2 - far**2, 0.0, None))
        )
    residual_heights[rng.random(grid.shape) > density * grid.posting**2] = np.nan
    return residual_heights.astype(np.float32)
