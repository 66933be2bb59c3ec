"""Map of the cells that the lander can still reach, with the propellant needed."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.grid import Grid
from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.typing import Array, BoolArray

BoolMap = BoolArray

_MAX_CELLS_PER_SIDE = 100


class ReachabilityMap:
    """Propellant and feasibility of landing in each cell of a grid.

    They are computed on first use.

    Parameters
    ----------
    grid
        Grid of the cells.
    height
        Terrain height of each cell (rows, cols), m.
    cost_of
        Function that returns propellant and time-to-go of flying to sites (n, 3), m, with the
        guidance law in use, within the limits of thrust, tilt, glideslope and propellant.
    """

    def __init__(self, grid: Grid, height: Array, cost_of: Callable[[Array], DivertCost]) -> None:
        self.grid = grid
        self._height, self._cost_of = height, cost_of

    @classmethod
    def over_map(
        cls, hazard_map: HazardMap, site: Array, cost_of: Callable[[Array], DivertCost]
    ) -> ReachabilityMap:
        """Return the reachability over a hazard map, on at most 100 x 100 cells.

        Where the map has no height, the height of the current `site` (3,), m, is used. `cost_of`
        returns the cost of flying to sites (n, 3), m.
        """
        fine = hazard_map.grid
        ratio = max(1.0, max(fine.shape) / _MAX_CELLS_PER_SIDE)
        posting = fine.posting * ratio
        # Rounded up, so that the grid covers every cell of the map.
        rows, cols = (np.ceil(n / ratio - 1e-9) for n in fine.shape)
        grid = Grid.centred(fine.centre, cols * posting, posting, rows * posting)
        return cls(grid, elevation_on_grid(grid, hazard_map, float(site[2])), cost_of)

    @cached_property
    def cost(self) -> DivertCost:
        """Propellant and time-to-go for all cells, flattened row by row (rows * cols,)."""
        return self._cost_of(np.column_stack((self.grid.centres().reshape(-1, 2),
                                              self._height.ravel())))  # fmt: skip

    @property
    def propellant(self) -> Array:
        """Propellant to reach each cell (rows, cols), kg; inf if out of reach."""
        return self.cost.propellant.reshape(self.grid.shape)

    @property
    def reachable(self) -> BoolMap:
        """Whether the lander can fly to each cell within its limits (rows, cols)."""
        return self.cost.feasible.reshape(self.grid.shape)

    def at(self, xy: ArrayLike) -> BoolMap:
        """Return which points (..., 2), m, lie in reachable cells; False outside the grid."""
        points = np.asarray(xy, dtype=np.float64)
        inside = np.asarray(self.grid.contains(points))
        row, col = self.grid.cell(np.where(inside[..., None], points, self.grid.centre))
        return inside & self.reachable[row, col]


def elevation_on_grid(grid: Grid, hazard_map: HazardMap | None, default_height: float) -> Array:
    """Return a hazard map's terrain heights at the cells of a grid (rows, cols), m.

    Parameters
    ----------
    grid
        Grid of the cells.
    hazard_map
        Hazard map. With None or a map without elevation, all heights are `default_height`.
    default_height
        Height where the map has none, m.
    """
    height = np.full(grid.shape, default_height)
    if hazard_map is None or hazard_map.elevation is None:
        return height
    xy = grid.centres()
    known = np.asarray(hazard_map.grid.contains(xy))
    mapped = hazard_map.elevation[hazard_map.grid.cell(xy[known])].astype(np.float64)
    height[known] = np.where(np.isfinite(mapped), mapped, default_height)
    return height
