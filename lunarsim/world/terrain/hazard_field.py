"""Artificial hazard field on flat grassland, as at Kennedy Space Center.

A rotated field of 100 x 100 m with boulders and craters, after the field that Morpheus flew over
(quadtree paper, section 5): hemispheres up to 1 m across, craters up to 5 m wide and 0.5 m deep.
"""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.rocks.field import RockField
from lunarsim.world.terrain._crater_kernels import add_crater_profiles
from lunarsim.world.terrain.craters import APRON_RADII, DEPTH_RATIO, RIM_HEIGHT_RATIO
from lunarsim.world.terrain.heightfield import Heightfield
from lunarsim.world.terrain.relief import fractal_relief
from lunarsim.world.terrain.terrain import Terrain

# Gives a depth of 0.5 m at a diameter of 5 m.
_FRESHNESS = 0.5


def hazard_field(
    rng: np.random.Generator,
    *,
    size: float = 100.0,
    surround: float = 320.0,
    posting: float = 0.25,
    turn: float = np.deg2rad(20.0),
    boulders: int = 300,
    craters: int = 24,
    grass_sigma: float = 0.02,
    swell: float = 0.25,
) -> Terrain:
    """Generate terrain with random boulders and craters in the middle of grassland.

    Parameters
    ----------
    rng
        Source of random numbers.
    size
        Side of the field, m.
    surround
        Side of the grassland, m.
    posting
        Grid spacing of the relief, m.
    turn
        Rotation of the field, counter-clockwise, rad.
    boulders, craters
        Numbers of each. Diameters follow an inverse square law, from 0.4 to 1 m for boulders and
        from 2 to 5 m for craters.
    grass_sigma
        Roughness of the grass, 1 sigma, m.
    swell
        Standard deviation of the long-wavelength relief, m.
    """
    if not 0.0 < size <= surround:
        raise InputError(
            "terrain.field_m", size, f"must be positive and at most size_m, which is {surround:g} m"
        )
    for name, count in (("boulders", boulders), ("craters", craters)):
        if count < 0:
            raise InputError(f"terrain.{name}", count, "must be 0 or more")
    grid = Grid.centred((0.0, 0.0), surround, posting)
    waves = fractal_relief(grid, rng, hurst=0.95, rms_slope=np.deg2rad(1.0)).z.astype(np.float64)
    z = waves * (swell / waves.std()) + grass_sigma * rng.standard_normal(grid.shape)
    x, y, diameter = _scatter_objects(rng, "craters", craters, 2.0, 5.0, size, turn)
    fresh = np.full(craters, _FRESHNESS)
    add_crater_profiles(
        z,
        grid.x0,
        grid.y0,
        grid.posting,
        x,
        y,
        diameter,
        fresh,
        DEPTH_RATIO,
        RIM_HEIGHT_RATIO,
        APRON_RADII,
    )
    relief = Heightfield(grid, (z - z.mean()).astype(np.float32))
    x, y, diameter = _scatter_objects(rng, "boulders", boulders, 0.4, 1.0, size, turn)
    terrain_height = Terrain(relief).elevation(np.column_stack((x, y)))
    return Terrain(relief, RockField.hemispheres(x, y, terrain_height, 0.5 * diameter))


def _scatter_objects(
    rng: np.random.Generator,
    name: str,
    count: int,
    min_diameter: float,
    max_diameter: float,
    size: float,
    turn: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample east, north and diameter (m) of discs without overlap, largest first.

    The number of discs of diameter D or more falls as D^-2. The discs lie on a square of side
    `size`, m, that is rotated by `turn`, rad, counter-clockwise. An error names the key `name` of
    the terrain.
    """
    u = rng.random(count)
    diameter = np.sort(1.0 / np.sqrt(u / min_diameter**2 + (1.0 - u) / max_diameter**2))[::-1]
    placed = np.zeros((0, 3))
    for d in diameter:
        for _ in range(1000):
            p = rng.uniform(-0.5, 0.5, 2) * (size - d)
            gap = np.hypot(placed[:, 0] - p[0], placed[:, 1] - p[1])
            if np.all(gap > 0.5 * (placed[:, 2] + d)):
                break
        else:
            raise InputError(
                f"terrain.{name}",
                count,
                f"must be smaller, because only {len(placed)} fit into a square of side {size:g} m",
            )
        placed = np.vstack((placed, [*p, d]))
    c, s = np.cos(turn), np.sin(turn)
    x = c * placed[:, 0] - s * placed[:, 1]
    y = s * placed[:, 0] + c * placed[:, 1]
    return np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(placed[:, 2])
