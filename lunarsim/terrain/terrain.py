"""`Terrain`: relief and rocks as one surface, with exact queries."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.terrain import _kernels as k
from lunarsim.terrain.heightfield import Heightfield
from lunarsim.terrain.rocks import RockField

# Side of a bucket of the acceleration structure, m: about the size of a large rock.
_BUCKET = 1.6


@dataclass(frozen=True)
class RayHits:
    """Where rays meet the ground.

    Attributes
    ----------
    range
        Distance along each ray (n,), m; NaN for no return.
    normal
        Unit surface normal at the hit (n, 3), ENU; NaN for no return.
    rock
        Index of the rock that was hit (n,), -1 for relief, -2 for no return.
    """

    range: NDArray[np.float64]
    normal: NDArray[np.float64]
    rock: NDArray[np.int64]


@dataclass(frozen=True)
class Terrain:
    """Ground truth: a heightfield and the rocks that stand on it.

    The surface at a point is the higher of the relief and any rock there. Outside the
    heightfield, or over no-data, elevation and normal are NaN and rays find nothing.

    Attributes
    ----------
    relief
        The ground without rocks.
    rocks
        The rocks.
    """

    relief: Heightfield
    rocks: RockField = field(default_factory=RockField.empty)

    _frame: tuple[float, float, float] = field(init=False, repr=False, compare=False)
    _surface: tuple[Any, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        g = self.relief.grid
        leaf = max(1, round(_BUCKET / g.posting))
        z = np.ascontiguousarray(self.relief.z)
        r = self.rocks
        rocks = np.column_stack(
            (r.x, r.y, r.base, r.a, r.b, r.height, np.cos(r.yaw), np.sin(r.yaw))
        )
        start, index, top = k.build_buckets(z, g.x0, g.y0, g.posting, leaf, rocks)
        object.__setattr__(self, "_frame", (g.x0, g.y0, g.posting))
        object.__setattr__(self, "_surface", (z, rocks, start, index, top, leaf))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, east, south, north limits, m."""
        return self.relief.bounds

    @property
    def z_range(self) -> tuple[float, float]:
        """Least elevation of the relief and greatest of relief and rocks, m."""
        low, high = self.relief.z_range
        if len(self.rocks):
            high = max(high, float(np.max(self.rocks.base + self.rocks.height)))
        return low, high

    def elevation(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return the elevation (...,) at points (..., 2), m; NaN where unknown."""
        xy = np.asarray(xy, dtype=np.float64)
        flat = np.ascontiguousarray(xy.reshape(-1, 2))
        x0, y0, p = self._frame
        z, rocks, start, index, _, leaf = self._surface
        out = k.elevation_at(flat, z, x0, y0, p, leaf, rocks, start, index)
        return np.asarray(out).reshape(xy.shape[:-1])

    def normal(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Return the unit surface normal (..., 3) at points (..., 2); NaN where unknown."""
        xy = np.asarray(xy, dtype=np.float64)
        flat = np.ascontiguousarray(xy.reshape(-1, 2))
        x0, y0, p = self._frame
        z, rocks, start, index, _, leaf = self._surface
        out = k.normal_at(flat, z, x0, y0, p, leaf, rocks, start, index)
        return np.asarray(out).reshape((*xy.shape[:-1], 3))

    def raster(self, grid: Grid) -> NDArray[np.float32]:
        """Return the elevation at every cell centre of `grid` (rows, cols), m."""
        x0, y0, p = self._frame
        z, rocks, start, index, _, leaf = self._surface
        return np.asarray(
            k.raster(
                grid.x0,
                grid.y0,
                grid.posting,
                grid.rows,
                grid.cols,
                z,
                x0,
                y0,
                p,
                leaf,
                rocks,
                start,
                index,
            )
        )

    def cast(self, origin: ArrayLike, direction: ArrayLike, max_range: float = np.inf) -> RayHits:
        """Cast rays onto the surface.

        Parameters
        ----------
        origin
            ENU start of the rays, (3,) for all or (n, 3), m.
        direction
            Unit vectors (n, 3), ENU.
        max_range
            Longest distance that counts as a return, m.
        """
        direction = np.ascontiguousarray(direction, dtype=np.float64)
        origin = np.ascontiguousarray(np.atleast_2d(np.asarray(origin, dtype=np.float64)))
        x0, y0, p = self._frame
        z, rocks, start, index, top, leaf = self._surface
        distance, normal, rock = k.cast(
            origin,
            direction,
            float(max_range),
            z,
            x0,
            y0,
            p,
            leaf,
            top,
            rocks,
            start,
            index,
        )
        return RayHits(distance, normal, rock)
