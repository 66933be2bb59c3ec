"""Small worlds that are quick to make, and where the repository's scenarios lie."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunarsim.grid import Grid
from lunarsim.rocks.field import RockField
from lunarsim.rocks.shapes import shape_table
from lunarsim.world.terrain import Heightfield, Terrain

ROOT = Path(__file__).parent.parent
SCENARIOS = ROOT / "scenarios"


def flat_terrain(size: float = 40.0, posting: float = 0.5, level: float = 0.0) -> Terrain:
    grid = Grid.centred((0.0, 0.0), size, posting)
    return Terrain(Heightfield(grid, np.full(grid.shape, level, np.float32)))


def sloped_terrain(gradient: tuple[float, float], size: float = 40.0) -> Terrain:
    grid = Grid.centred((0.0, 0.0), size, 0.5)
    z = gradient[0] * grid.x[None, :] + gradient[1] * grid.y[:, None]
    return Terrain(Heightfield(grid, z.astype(np.float32)))


def random_terrain(rng: np.random.Generator, rocks: int = 60, relief: float = 1.0) -> Terrain:
    grid = Grid.centred((0.0, 0.0), 30.0, 0.5)
    z = relief * rng.standard_normal(grid.shape).astype(np.float32)
    x, y = rng.uniform(-14.0, 14.0, (2, rocks))
    field = Heightfield(grid, z)
    base = Terrain(field).elevation(np.column_stack((x, y)))
    radius = rng.uniform(0.1, 1.5, rocks)
    stones = RockField(
        x,
        y,
        base,
        radius,
        radius * rng.uniform(0.5, 1.0, rocks),
        radius * rng.uniform(0.3, 1.2, rocks),
        rng.uniform(0.0, np.pi, rocks),
        rng.integers(0, len(shape_table().count), rocks),
    )
    return Terrain(field, stones)
