"""The exact safety of the true terrain, for judging maps and for the oracle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.hazards.safety import SafetyMap, exact_safety
from lunarsim.vehicle.lander import Lander
from lunarsim.world import World


@dataclass(frozen=True)
class Truth:
    """True elevation and exact safety of the whole terrain.

    Attributes
    ----------
    safety
        Exact safety map, in the true ENU frame.
    elevation
        True elevation on its grid (rows, cols), m.
    """

    safety: SafetyMap
    elevation: NDArray[np.float32]

    @classmethod
    def of(cls, world: World, lander: Lander, posting: float) -> Truth:
        """Evaluate the whole terrain at a posting (m)."""
        west, east, south, north = world.terrain.bounds
        grid = Grid.centred(
            (0.5 * (west + east), 0.5 * (south + north)), east - west, posting, north - south
        )
        elevation = world.terrain.raster(grid)
        return cls(exact_safety(elevation, grid, lander), elevation)

    def safe_at(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Tell which true points (..., 2) are exactly safe (nearest cell); False off the map."""
        grid = self.safety.grid
        row, col = grid.cell(xy)
        inside = grid.contains(xy)
        safe = self.safety.safe[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
        return np.asarray(inside & safe)

    def safe_share(self, half_sides: tuple[float, float], centre: tuple[float, float]) -> float:
        """Return the share of exactly safe cells in a rectangle around `centre` (m)."""
        grid = self.safety.grid
        inside = (np.abs(grid.x - centre[0]) <= half_sides[0])[None, :] & (
            np.abs(grid.y - centre[1]) <= half_sides[1]
        )[:, None]
        return float(self.safety.safe[inside].mean()) if inside.any() else float("nan")
