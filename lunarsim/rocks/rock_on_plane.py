"""A single rock on a horizontal plane, for computing its image and shadow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.rocks import _kernels as kernels
from lunarsim.rocks.field import RockField
from lunarsim.rocks.shapes import shape_table
from lunarsim.typing import Array, BoolArray


@dataclass(frozen=True)
class RockOnPlane:
    """One rock of a set, placed at the origin of the plane z = 0.

    Attributes
    ----------
    field, index
        Set of rocks, and index of the rock in the set. The base elevation of the rock is kept, but
        its position becomes the origin.
    """

    field: RockField
    index: int = 0

    def _row(self) -> Array:
        row = self.field.rows()[self.index : self.index + 1].copy()
        row[:, :2] = 0.0
        return row

    def cast(self, origin: Array, direction: Array) -> tuple[Array, Array]:
        """Intersect rays with the rock and the plane.

        `origin` and `direction` (n, 3) are the rays. Returns distances (n,), m, and unit normals at
        the hits (n, 3). Rays that hit nothing have the distance inf and the normal (0, 0, 1).
        """
        distance = np.empty(len(origin))
        normal = np.empty((len(origin), 3))
        table = shape_table()
        kernels.cast_on_plane(
            np.ascontiguousarray(origin), np.ascontiguousarray(direction), self._row(),
            table.planes, table.count, distance, normal,
        )  # fmt: skip
        return distance, normal

    def covers(self, xy: Array) -> BoolArray:
        """Return which points of the plane lie under the rock, seen from above.

        `xy` (..., 2) are the points, m; the result has the shape (...,).
        """
        start = np.column_stack((xy.reshape(-1, 2), np.full(xy.size // 2, 60.0)))
        down = np.broadcast_to([0.0, 0.0, -1.0], start.shape)
        distance, _ = self.cast(start, np.ascontiguousarray(down))
        return np.asarray(distance < 60.0).reshape(xy.shape[:-1])
