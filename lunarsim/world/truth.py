"""The exact safety of the true terrain, for judging maps and for the oracle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import SafetyMap, exact_safety
from lunarsim.world import World

# Of the yardstick, m: its own, so that no map's setting changes what maps are judged by.
POSTING = 0.2


@dataclass(frozen=True)
class Truth:
    """True elevation and exact safety of the whole terrain.

    Attributes
    ----------
    safety
        Exact safety map, in the true ENU frame.
    elevation
        True elevation on its grid (rows, cols), m.
    lander
        The lander it was evaluated for.
    """

    safety: SafetyMap
    elevation: NDArray[np.float32]
    lander: Lander

    @classmethod
    def of(cls, world: World, lander: Lander, posting: float = POSTING) -> Truth:
        """Evaluate the whole terrain at a posting (m)."""
        west, east, south, north = world.terrain.bounds
        grid = Grid.centred(
            (0.5 * (west + east), 0.5 * (south + north)), east - west, posting, north - south
        )
        elevation = world.terrain.raster(grid)
        return cls(exact_safety(elevation, grid, lander), elevation, lander)

    @cached_property
    def clearance(self) -> NDArray[np.float64]:
        """Distance of each safe cell's centre to the nearest unsafe one's (rows, cols), m."""
        cells = ndimage.distance_transform_edt(self.safety.safe)
        return np.asarray(cells * self.safety.grid.posting)

    def safe_at(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Tell which true points (..., 2) are exactly safe (nearest cell); False off the map."""
        grid = self.safety.grid
        row, col = grid.cell(xy)
        inside = grid.contains(xy)
        safe = self.safety.safe[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
        return np.asarray(inside & safe)

    def known_at(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Tell at which true points (..., 2) the exact test has a verdict (nearest cell)."""
        grid = self.safety.grid
        row, col = grid.cell(xy)
        known = self.safety.observed[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
        return np.asarray(grid.contains(xy) & known)

    def safe_share(
        self, centre: ArrayLike, half_sides: ArrayLike, heading: float | None = None
    ) -> float:
        """Return the share of exactly safe cells in a rectangle.

        Parameters
        ----------
        centre, half_sides
            East and north (2,), m.
        heading
            Azimuth of body x (rad) for the share at that heading alone.
        """
        grid = self.safety.grid
        safe = self.safety.safe
        if heading is not None:
            safe = exact_safety(self.elevation, grid, self.lander, heading=heading).safe
        centre, half_sides = np.asarray(centre), np.asarray(half_sides)
        inside = (np.abs(grid.x - centre[0]) <= half_sides[0] + 0.5 * grid.posting)[None, :] & (
            np.abs(grid.y - centre[1]) <= half_sides[1] + 0.5 * grid.posting
        )[:, None]
        return float(safe[inside].mean()) if inside.any() else float("nan")
