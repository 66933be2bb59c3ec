"""The terrain surface with exact point queries and ray casting."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.rocks.field import RockField
from lunarsim.rocks.shapes import shape_table
from lunarsim.typing import Array, IntArray
from lunarsim.world.terrain import _ray_kernels, _surface_kernels
from lunarsim.world.terrain.albedo_map import AlbedoMap
from lunarsim.world.terrain.heightfield import Heightfield

# Side of a bucket of rocks in the ray caster, m: about the size of a large rock.
_BUCKET_SIDE_M = 1.6


@dataclass(frozen=True)
class RayHits:
    """Hits of rays on the terrain.

    Attributes
    ----------
    range
        Distance along each ray (n,), m; NaN if the ray misses.
    normal
        Unit surface normal at the hit (n, 3), ENU; NaN if the ray misses.
    rock
        Index of the rock that was hit (n,); -1 for relief, -2 if the ray misses.
    """

    range: Array
    normal: Array
    rock: NDArray[np.int32]


@dataclass(frozen=True)
class Terrain:
    """True terrain: a heightfield and the rocks on it.

    The surface at a point is the higher of the relief and any rock there. Outside the
    heightfield, or over no-data, elevation and normal are NaN and rays hit nothing.

    Attributes
    ----------
    relief
        Relief without rocks.
    rocks
        Rocks on the relief.
    albedo
        Relative albedo of the relief in images; None: uniform.

    Examples
    --------
    >>> grid = Grid.centred((0.0, 0.0), 4.0, 1.0)
    >>> terrain = Terrain(Heightfield(grid, np.full(grid.shape, 2.0, np.float32)))
    >>> terrain.elevation([[0.0, 0.0], [9.0, 0.0]]).tolist()  # the second point is outside
    [2.0, nan]
    >>> terrain.cast([0.0, 0.0, 50.0], [[0.0, 0.0, -1.0]]).range.tolist()
    [48.0]
    """

    relief: Heightfield
    rocks: RockField = field(default_factory=RockField.empty)
    albedo: AlbedoMap | None = field(default=None, repr=False)

    # Arguments of the kernels: first grid point (x, y) and spacing; rocks; pyramid of maxima.
    _frame: tuple[float, float, float] = field(init=False, repr=False, compare=False)
    _leaf: int = field(init=False, repr=False, compare=False)
    _rock_arrays: _ray_kernels.Rocks = field(init=False, repr=False, compare=False)
    _pyramid: _ray_kernels.Pyramid = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        g = self.relief.grid
        base = max(0, round(np.log2(_BUCKET_SIDE_M / g.posting)))
        table = shape_table()
        rows = self.rocks.rows()
        z = np.ascontiguousarray(self.relief.z)
        high, wide = _levels(g.rows - 1, g.cols - 1, base)
        offset = np.concatenate(([0], np.cumsum(high * wide)[:-1]))
        start, index = _ray_kernels.list_rocks(
            rows, self.rocks.reach(), g.x0, g.y0, g.posting * 2**base, high[base], wide[base]
        )
        peak, terrain_peak = _ray_kernels.build_pyramid(
            z, rows, start, index, base, offset, high, wide
        )
        object.__setattr__(self, "_frame", (g.x0, g.y0, g.posting))
        object.__setattr__(self, "_leaf", 2**base)
        listed = _ray_kernels.Rocks(rows, table.planes, table.count, start, index)
        pyramid = _ray_kernels.Pyramid(base, peak, terrain_peak, offset, high, wide)
        object.__setattr__(self, "_rock_arrays", listed)
        object.__setattr__(self, "_pyramid", pyramid)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, east, south and north edges, m."""
        return self.relief.bounds

    @property
    def z_range(self) -> tuple[float, float]:
        """Minimum elevation of the relief and maximum of relief and rocks, m."""
        low, high = self.relief.z_range
        if len(self.rocks):
            high = max(high, float(np.max(self.rocks.base + self.rocks.height)))
        return low, high

    @property
    def nbytes(self) -> int:
        """Memory of the heightfield, the rocks and the ray caster's arrays, bytes."""
        arrays = (self.relief.z, *self._rock_arrays, *self._pyramid)
        return sum(a.nbytes for a in arrays if isinstance(a, np.ndarray))

    def elevation(self, xy: ArrayLike) -> Array:
        """Return the surface elevation (...,), m, at points (..., 2), east and north, m.

        Rocks are included. NaN outside the map and over no-data.
        """
        xy = np.asarray(xy, dtype=np.float64)
        flat = np.ascontiguousarray(xy.reshape(-1, 2))
        out = _surface_kernels.elevation_at(
            flat, self.relief.z, *self._frame, self._leaf, *self._rock_arrays
        )
        return np.asarray(out).reshape(xy.shape[:-1])

    def normal(self, xy: ArrayLike) -> Array:
        """Return unit surface normals (..., 3), ENU, at points (..., 2), east, north, m.

        Rocks are included. NaN outside the map and over no-data.
        """
        xy = np.asarray(xy, dtype=np.float64)
        flat = np.ascontiguousarray(xy.reshape(-1, 2))
        out = _surface_kernels.normal_at(
            flat, self.relief.z, *self._frame, self._leaf, *self._rock_arrays
        )
        return np.asarray(out).reshape((*xy.shape[:-1], 3))

    def raster(self, grid: Grid) -> NDArray[np.float32]:
        """Return the surface elevation (rows, cols), m, at every cell centre of a grid.

        Rocks are included. NaN outside the map and over no-data.
        """
        g = grid
        out = np.empty(grid.shape, np.float32)
        rocks, planes, count, _, _ = self._rock_arrays
        _surface_kernels.raster(
            g.x0, g.y0, g.posting, self.relief.z, *self._frame, rocks, planes, count,
            self.rocks.reach(), out,
        )  # fmt: skip
        return out

    def rock_raster(self, grid: Grid) -> NDArray[np.int32]:
        """Return the index (rows, cols) of the top rock at every cell centre of a grid.

        The index is -1 where no rock covers the centre.
        """
        g = grid
        out = np.full(grid.shape, -1, np.int32)
        _surface_kernels.rock_raster(
            g.x0, g.y0, g.posting, self.relief.z, *self._frame, self._leaf, *self._rock_arrays, out
        )
        return out

    def cast(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        max_range: float = np.inf,
        *,
        normals: bool = True,
    ) -> RayHits:
        """Intersect rays with the surface of relief and rocks.

        Parameters
        ----------
        origin
            Start of the rays, (3,) for all or (n, 3), ENU, m.
        direction
            Unit vectors (n, 3), ENU.
        max_range
            Maximum range, m; more distant hits are misses.
        normals
            Whether to compute surface normals; otherwise `normal` is empty.

        Returns
        -------
        RayHits
            Range, surface normal and rock index of the first hit of each ray.
        """
        direction = np.ascontiguousarray(direction, dtype=np.float64)
        origin = np.ascontiguousarray(np.atleast_2d(np.asarray(origin, dtype=np.float64)))
        rays = len(direction)
        distance, rock = np.empty(rays), np.empty(rays, np.int32)
        normal = np.empty((rays if normals else 0, 3))
        _ray_kernels.cast.run_loop(
            rays,
            1.0,
            origin,
            direction,
            float(max_range),
            normals,
            self.relief.z,
            self._frame,
            *self._pyramid,
            *self._rock_arrays,
            (distance, normal, rock),
        )
        return RayHits(distance, normal, rock)


def _levels(rows: int, cols: int, base: int) -> tuple[IntArray, IntArray]:
    """Return the numbers of rows and columns of each level of the height pyramid.

    Level 0 has `rows` x `cols` cells; each further level has half of the rows and columns. There
    are more than `base` levels, and the last level is a single cell.
    """
    high, wide = [rows], [cols]
    while max(high[-1], wide[-1]) > 1 or len(high) <= base:
        high.append((high[-1] + 1) // 2)
        wide.append((wide[-1] + 1) // 2)
    return np.array(high), np.array(wide)
