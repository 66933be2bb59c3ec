"""Maps of the true terrain: elevation, slope, rocks, safety and shadow."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.atomic_files import atomic_write_netcdf
from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_raster_size
from lunarsim.models.lander import Lander
from lunarsim.typing import BoolArray
from lunarsim.world import World
from lunarsim.world.far_shadow import FarShadow
from lunarsim.world.site_safety import site_safety

# Rays to the Sun start this far above the surface, so that they do not hit it, m.
_RAY_OFFSET_M = 1e-3


_MAX_CELLS_PER_SIDE = 8000


@dataclass(frozen=True)
class TruthProducts:
    """True maps on one grid, all (rows, cols), row 0 south.

    Attributes
    ----------
    grid
        Grid of the maps.
    elevation
        Elevation of terrain and rocks, m; NaN where unknown.
    slope
        Angle between surface normal and vertical, rocks included, rad; NaN where unknown.
    rock
        Index of the rock on top; -1 for bare terrain.
    safe
        Exact safety for the lander at every heading (Definition III.1 of the Gaussian DEM paper).
    shadow
        Whether the cell's centre is in shadow, also that of far terrain; False where the elevation
        is unknown. With the Sun below the horizon, all other cells are True.
    """

    grid: Grid
    elevation: NDArray[np.float32]
    slope: NDArray[np.float32]
    rock: NDArray[np.int32]
    safe: BoolArray
    shadow: BoolArray

    @classmethod
    def of(cls, world: World, lander: Lander, grid: Grid) -> TruthProducts:
        """Compute the true maps of a world on a grid, with safety for a lander."""
        terrain = world.terrain
        elevation = terrain.raster(grid)
        centres = grid.centres()
        normal = terrain.normal(centres)
        slope = np.arccos(np.clip(normal[..., 2], -1.0, 1.0))
        sun = world.light.direction
        known = np.isfinite(elevation)
        dark = known & ((np.einsum("ijk,k->ij", normal, sun) <= 0.0) | (sun[2] <= 0.0))
        if sun[2] > 0.0:
            lit = known & ~dark
            points = np.dstack((centres, elevation.astype(np.float64)))
            start = points + _RAY_OFFSET_M * normal
            rays = np.broadcast_to(sun, (int(lit.sum()), 3))
            dark[lit] = np.isfinite(terrain.cast(start[lit], rays, normals=False).range)
            if world.far_terrain is not None:
                light = FarShadow.of(world.far_terrain, world.light).sunlight(points[lit])
                dark[lit] |= light < 0.5
        safe, _ = site_safety(terrain, grid, lander)
        return cls(grid, elevation, slope.astype(np.float32), terrain.rock_raster(grid), safe, dark)

    def save(self, path: Path) -> None:
        """Write the maps to a NetCDF file with coordinates and units."""
        import xarray as xr  # noqa: PLC0415  (loads slowly)

        maps: tuple[tuple[str, NDArray[Any], str], ...] = (
            ("elevation", self.elevation, "m"),
            ("slope", self.slope, "rad"),
            ("rock", self.rock, "1"),
            ("safe", self.safe.astype(np.int8), "1"),
            ("shadow", self.shadow.astype(np.int8), "1"),
        )
        units = {"units": "m"}
        dataset = xr.Dataset(
            {name: (("north", "east"), data, {"units": unit}) for name, data, unit in maps},
            {"north": ("north", self.grid.y, units), "east": ("east", self.grid.x, units)},
        )
        atomic_write_netcdf(path, dataset)


def truth_grid(world: World, centre: tuple[float, float], size: float, posting: float) -> Grid:
    """Return the grid of a square map, checked to lie on the terrain.

    `centre` is its middle (east, north; m), `size` its side and `posting` the grid spacing, m.

    Raises
    ------
    InputError
        If `posting` is not positive, if the square has fewer than 10 or more than 8,000 cells along
        a side, or if it extends beyond the terrain.
    """
    if not (np.isfinite(posting) and posting > 0.0):
        raise InputError("--posting", posting, "must be positive and finite")
    if not (np.isfinite(size) and size >= 10.0 * posting):
        raise InputError(
            "--size", size, f"must be at least {10.0 * posting:g} m, ten times --posting"
        )
    check_raster_size("--size", size, posting, _MAX_CELLS_PER_SIDE)
    west, east, south, north = world.terrain.bounds
    half = 0.5 * size
    max_half = min(centre[0] - west, east - centre[0], centre[1] - south, north - centre[1])
    if half > max_half:
        raise InputError(
            "--size",
            size,
            f"must be at most {2.0 * max_half:g} m",
            "The square around the target must lie on the terrain.",
        )
    return Grid.centred(centre, size, posting)
