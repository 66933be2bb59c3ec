"""Where the lander can still land, as a map."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.onboard.guidance.divert import DivertCost
from lunarsim.onboard.hazards.hazard_map import HazardMap

Array = NDArray[np.float64]
BoolMap = NDArray[np.bool_]

_SIDE = 100  # cells at most


class Reach:
    """What it takes to land in each cell of a grid; surveyed when something first asks.

    Parameters
    ----------
    grid
        Of the cells.
    height
        Of the ground (rows, cols), m.
    cost_of
        Returns what it costs to fly to sites (n, 3) under thrust, tilt, glideslope, propellant and
        the law that flies.
    """

    def __init__(self, grid: Grid, height: Array, cost_of: Callable[[Array], DivertCost]) -> None:
        self.grid = grid
        self._height, self._cost_of = height, cost_of

    @classmethod
    def under(
        cls, hazard_map: HazardMap, site: Array, cost_of: Callable[[Array], DivertCost]
    ) -> Reach:
        """Return the reach over a hazard map, on 100 cells a side at most.

        Where the map has no height the site's (3,) counts.
        """
        fine = hazard_map.grid
        ratio = max(1.0, max(fine.shape) / _SIDE)
        posting = fine.posting * ratio
        # Rounded up: no cell of the map lies beyond it.
        rows, cols = (np.ceil(n / ratio - 1e-9) for n in fine.shape)
        grid = Grid.centred(fine.centre, cols * posting, posting, rows * posting)
        return cls(grid, heights_on(grid, hazard_map, float(site[2])), cost_of)

    @cached_property
    def cost(self) -> DivertCost:
        """Of each cell, row by row (rows cols,)."""
        return self._cost_of(np.column_stack((self.grid.centres().reshape(-1, 2),
                                              self._height.ravel())))  # fmt: skip

    @property
    def propellant(self) -> Array:
        """To reach each cell (rows, cols), kg; inf out of reach."""
        return self.cost.propellant.reshape(self.grid.shape)

    @property
    def reachable(self) -> BoolMap:
        """Whether each cell can be reached (rows, cols)."""
        return self.cost.feasible.reshape(self.grid.shape)

    def at(self, xy: ArrayLike) -> BoolMap:
        """Tell which points (..., 2), m, lie in cells within reach; none beyond the grid does."""
        points = np.asarray(xy, dtype=np.float64)
        inside = np.asarray(self.grid.contains(points))
        row, col = self.grid.cell(np.where(inside[..., None], points, self.grid.centre))
        return inside & self.reachable[row, col]


def heights_on(grid: Grid, hazard_map: HazardMap | None, otherwise: float) -> Array:
    """Return the ground's height at the cells of a grid (rows, cols), m, as a map knows it."""
    height = np.full(grid.shape, otherwise)
    if hazard_map is None or hazard_map.elevation is None:
        return height
    xy = grid.centres()
    known = np.asarray(hazard_map.grid.contains(xy))
    mapped = hazard_map.elevation[hazard_map.grid.cell(xy[known])].astype(np.float64)
    height[known] = np.where(np.isfinite(mapped), mapped, otherwise)
    return height
