"""Shaded relief under a campaign's landings, as an image of some thousand points."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunarsim.grid import Grid
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import build_world
from lunarsim.untrusted_files import read_bounded_bytes
from lunarsim.viz.style import hillshade
from lunarsim.world.terrain import Terrain

# Number of points per side.
_POINTS = 160


def compute_terrain_shading(
    path: Path, seed: int
) -> tuple[list[float], list[float], list[list[float | None]]]:
    """Compute a shaded image of a scenario's terrain without rocks.

    `path` is the TOML file, and `seed` the root seed. Return east and north coordinates, m, and the
    brightness in [0, 1] of each point, None where there is no terrain.
    """
    scenario = Scenario.world_from_toml(
        read_bounded_bytes(path).decode(errors="replace"), path.parent.resolve()
    )
    relief = Terrain(build_world(scenario, RandomStreams(flight_seed(seed, 0))).terrain.relief)
    west, east, south, north = relief.bounds
    posting = max(east - west, north - south) / _POINTS
    middle = (0.5 * (west + east), 0.5 * (south + north))
    grid = Grid.centred(middle, east - west, posting, north - south)
    shade = hillshade(relief.raster(grid), posting)
    rows = [[round(float(v), 3) if np.isfinite(v) else None for v in row] for row in shade]
    return [float(v) for v in grid.x], [float(v) for v in grid.y], rows
