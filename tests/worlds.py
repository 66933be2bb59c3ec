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


def long_terrain(rng: np.random.Generator) -> Terrain:
    """Rough ground longer than wide, off the origin, with rocks up to its edges and a hole."""
    grid = Grid(x0=-3.0, y0=40.0, posting=0.7, rows=41, cols=17)
    z = 0.5 * rng.standard_normal(grid.shape).astype(np.float32)
    z[7, 4] = np.nan
    count = 40
    radius = rng.uniform(0.1, 1.0, count)
    rocks = RockField(
        rng.uniform(-3.0, 8.2, count),
        rng.uniform(40.0, 68.0, count),
        rng.normal(0.0, 0.5, count),
        radius,
        radius * rng.uniform(0.5, 1.0, count),
        radius * rng.uniform(0.3, 1.2, count),
        rng.uniform(0.0, np.pi, count),
        rng.integers(0, len(shape_table().count), count),
    )
    return Terrain(Heightfield(grid, z), rocks)


# A quick flight over rolling ground: 96 x 96 pixels, a coarse map, long control cycles; and a
# quicker one.
SMALL_FLIGHT = {
    "name": "small",
    "simulation": {"cycle_s": 0.2},
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
TINY_FLIGHT = {
    "name": "tiny",
    "simulation": {"cycle_s": 0.2},
    "terrain": {"size_m": 60.0},
    "rocks": {"cover": 0.04, "min_diameter_m": 0.4},
    "target": {"scatter_m": [8.0, 8.0]},
    "sensors": {
        "imu": {"kind": "imu"},
        "fix": {"kind": "navigation-fix"},
        "flash": {"kind": "flash-lidar", "rows": 64, "cols": 64},
    },
    "mappers": {"dem": {"kind": "gaussian-dem", "posting_m": 0.5, "size_m": 40.0}},
}

# A short descent over level ground with a small camera.
SMALL_SHADOW_FLIGHT = {
    "name": "small-shadow",
    "terrain": {"size_m": 160.0, "posting_m": 2.0, "rms_slope_deg": 0.0},
    "rocks": {"min_diameter_m": 0.4},
    "sun": {"azimuth_deg": 45.0, "elevation_deg": 25.0},
    "sensors": {
        "imu": {"kind": "imu"},
        "altimeter": {"kind": "radar-altimeter"},
        "camera": {"kind": "camera", "width": 320, "height": 240},
    },
    "tasking": {"camera": {"kind": "periodic", "rate_hz": 2.0}},
    "navigation": {"kind": "rocks"},
    "start": {
        "position_m": [-90.0, -40.0, 130.0],
        "velocity_m_s": [9.0, 4.0, -9.0],
        "position_sigma_m": 2.0,
        "velocity_sigma_m_s": 0.1,
    },
    "mappers": {"rocks": {"kind": "shadow", "size_m": 60.0, "posting_m": 0.5}},
}

# Commands that take a scenario, and what each needs besides.
TAKE_A_SCENARIO = {
    "fly": [], "compare": ["--out", "new"], "calibrate": ["--out", "new.json"],
    "render": ["--out", "new.png"], "sweep": ["--out", "new", "--over", "sun.elevation_deg=5,6"],
    "scenario check": [], "terrain preview": ["--out", "new.png"],
    "terrain export": ["--out", "new.tif"], "terrain truth": ["--out", "new.nc"],
    "vehicle check": ["--json", "new.json"], "site info": ["--json", "new.json"],
}  # fmt: skip
