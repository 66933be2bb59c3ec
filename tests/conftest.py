"""Shared fixtures: small worlds that are quick to fly over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from lunarsim.grid import Grid
from lunarsim.rocks.field import RockField
from lunarsim.rocks.shapes import shape_table
from lunarsim.scenario import Scenario
from lunarsim.world.terrain import Heightfield, Terrain

# The first example of a test may compile a kernel.
settings.register_profile(
    "kernels",
    deadline=None,
    max_examples=40,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("kernels")

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


@pytest.fixture
def small_scenario() -> Scenario:
    """A quick flight over rolling ground: 64 x 64 pixels, a coarse map."""
    return Scenario.from_dict(
        {
            "name": "small",
            "terrain": {"size_m": 80.0},
            "rocks": {"cover": 0.04, "min_diameter_m": 0.3},
            "target": {"scatter_m": [15.0, 15.0]},
            "sensors": {
                "imu": {"kind": "imu"},
                "fix": {"kind": "navigation-fix"},
                "flash": {"kind": "flash-lidar", "rows": 96, "cols": 96},
            },
            "mappers": {"dem": {"kind": "gaussian-dem", "posting_m": 0.4, "size_m": 60.0}},
        }
    )
