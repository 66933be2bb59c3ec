"""Truth as maps: what a perfect survey of the ground would say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_side
from lunarsim.models.lander import Lander
from lunarsim.safety import exact_safety
from lunarsim.whole_netcdf import write_netcdf_whole
from lunarsim.world import World

_OFF = 1e-3  # rays to the Sun start this far off the ground, m


# Along a side of the maps.
_MOST_CELLS = 8000


@dataclass(frozen=True)
class TruthProducts:
    """True maps on one grid, all (rows, cols), row 0 south.

    Attributes
    ----------
    grid
        Places the cells.
    elevation
        Of relief and rocks, m; NaN where unknown.
    slope
        Angle of the surface normal from the vertical, rocks included, rad; NaN where unknown.
    rock
        Number of the rock on top, -1 for relief.
    safe
        Exact safety of the lander (Definition III.1 of the Gaussian DEM paper), at any heading.
    shadow
        Whether the cell's centre sees no Sun; True at night.
    """

    grid: Grid
    elevation: NDArray[np.float32]
    slope: NDArray[np.float32]
    rock: NDArray[np.int32]
    safe: NDArray[np.bool_]
    shadow: NDArray[np.bool_]

    @classmethod
    def of(cls, world: World, lander: Lander, grid: Grid) -> TruthProducts:
        """Survey the world."""
        terrain = world.terrain
        elevation = terrain.raster(grid)
        centres = grid.centres()
        normal = terrain.normal(centres)
        slope = np.arccos(np.clip(normal[..., 2], -1.0, 1.0))
        sun = world.light.direction
        dark = np.einsum("ijk,k->ij", normal, sun) <= 0.0
        if sun[2] > 0.0:
            lit = ~dark & np.isfinite(elevation)
            ground = np.dstack((centres, elevation.astype(np.float64)))
            start = ground + _OFF * normal
            rays = np.broadcast_to(sun, (int(lit.sum()), 3))
            dark[lit] = np.isfinite(terrain.cast(start[lit], rays, normals=False).range)
        safe = exact_safety(elevation, grid, lander).safe
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
        write_netcdf_whole(path, dataset)


def survey_grid(world: World, centre: tuple[float, float], size: float, posting: float) -> Grid:
    """Return a square grid, checked to lie on the terrain.

    Raises
    ------
    InputError
        If a value is not positive or the square reaches beyond the terrain.
    """
    if not (np.isfinite(posting) and posting > 0.0):
        raise InputError("--posting", posting, "more than 0, in metres")
    if not (np.isfinite(size) and size >= 10.0 * posting):
        raise InputError("--size", size, f"at least ten postings, {10.0 * posting:g} m")
    check_side("--size", size, posting, _MOST_CELLS)
    west, east, south, north = world.terrain.bounds
    half = 0.5 * size
    room = min(centre[0] - west, east - centre[0], centre[1] - south, north - centre[1])
    if half > room:
        raise InputError("--size", size, f"at most {2.0 * room:g} m around the target")
    return Grid.centred(centre, size, posting)
