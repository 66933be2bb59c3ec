"""Exact safety of the true terrain, for evaluating maps and for the oracle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import SafetyMap, exact_safety
from lunarsim.safety.footprint import footprint_of
from lunarsim.typing import Array, BoolArray
from lunarsim.world import World

# Fixed, so that no map setting changes the reference that maps are evaluated against, m.
TRUTH_POSTING_M = 0.2
# West, east, south and north edges, m.
Bounds = tuple[float, float, float, float]


@dataclass(frozen=True)
class TerrainTruth:
    """True elevation and exact safety of the terrain or of a part of it.

    Attributes
    ----------
    safety
        Exact safety map, in the true ENU frame.
    elevation
        True elevation on the grid of `safety` (rows, cols), m.
    lander
        Lander that the safety applies to.
    """

    safety: SafetyMap
    elevation: NDArray[np.float32]
    lander: Lander

    @classmethod
    def of(
        cls,
        world: World,
        lander: Lander,
        posting: float = TRUTH_POSTING_M,
        bounds: Bounds | None = None,
    ) -> TerrainTruth:
        """Compute true elevations and exact landing safety of a world for a lander.

        Parameters
        ----------
        world, lander
            World and lander to evaluate.
        posting
            Cell size, m.
        bounds
            West, east, south and north edges of the part to evaluate, m; omitted: the complete
            terrain. The part is extended by the reach of the lander's footprint. Cells coincide
            with those of the complete terrain.
        """
        west, east, south, north = world.terrain.bounds
        grid = Grid.centred(
            (0.5 * (west + east), 0.5 * (south + north)), east - west, posting, north - south
        )
        if bounds is not None:
            rows, cols = _cells_within(grid, bounds, footprint_of(lander, posting).reach)
            grid = _part(grid, rows, cols)
        elevation = world.terrain.raster(grid)
        return cls(exact_safety(elevation, grid, lander), elevation, lander)

    def within(self, bounds: Bounds, max_cells: int) -> TerrainTruth:
        """Return the part within `bounds`, with at most `max_cells` cells per side.

        `bounds` are the west, east, south and north edges, m. A larger part keeps only every k-th
        row and column.
        """
        rows, cols = _cells_within(self.safety.grid, bounds, 0)
        step = -(-max(rows.stop - rows.start, cols.stop - cols.start) // max_cells)
        rows, cols = slice(rows.start, rows.stop, step), slice(cols.start, cols.stop, step)
        s = self.safety
        safety = SafetyMap(
            _part(s.grid, rows, cols), s.slope[rows, cols], s.roughness[rows, cols],
            s.safe[rows, cols], s.observed[rows, cols],
        )  # fmt: skip
        return TerrainTruth(safety, self.elevation[rows, cols], self.lander)

    @cached_property
    def clearance(self) -> Array:
        """Distance (rows, cols), m, from each safe cell to the nearest unsafe cell.

        Distances are between cell centres; unsafe cells have 0.
        """
        cells = ndimage.distance_transform_edt(self.safety.safe)
        return np.asarray(cells * self.safety.grid.posting)

    def is_safe_at(self, xy: ArrayLike) -> BoolArray:
        """Return whether true points (..., 2), ENU, m, are safe to land on.

        The safety is that of the nearest cell; points outside the map count as unsafe.
        """
        grid = self.safety.grid
        row, col = grid.cell(xy)
        inside = grid.contains(xy)
        safe = self.safety.safe[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
        return np.asarray(inside & safe)

    def is_known_at(self, xy: ArrayLike) -> BoolArray:
        """Return whether the exact safety is known at true points (..., 2), ENU, m.

        The value is that of the nearest cell; False outside the map.
        """
        grid = self.safety.grid
        row, col = grid.cell(xy)
        known = self.safety.observed[np.clip(row, 0, grid.rows - 1), np.clip(col, 0, grid.cols - 1)]
        return np.asarray(grid.contains(xy) & known)

    def safe_fraction(
        self, centre: ArrayLike, half_sides: ArrayLike, heading: float | None = None
    ) -> float:
        """Return the fraction of exactly safe cells in a rectangle; NaN without cells.

        Parameters
        ----------
        centre, half_sides
            Centre of the rectangle and half of its sides, each east and north (2,), m.
        heading
            Azimuth of the body x axis, rad; omitted: cells must be safe at every heading.
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


def _cells_within(grid: Grid, bounds: Bounds, margin: int) -> tuple[slice, slice]:
    """Return slices of the rows and columns of `grid` within bounds.

    `bounds` are west, east, south and north, m; the slices are extended by `margin` cells.
    """
    west, east, south, north = bounds
    (south_row, north_row), (west_col, east_col) = grid.cell([[west, south], [east, north]])
    return (
        slice(max(int(south_row) - margin, 0), min(int(north_row) + margin + 1, grid.rows)),
        slice(max(int(west_col) - margin, 0), min(int(east_col) + margin + 1, grid.cols)),
    )


def _part(grid: Grid, rows: slice, cols: slice) -> Grid:
    """Return the grid of the selected rows and columns."""
    step = rows.step or 1
    return Grid(
        grid.x0 + grid.posting * cols.start, grid.y0 + grid.posting * rows.start,
        grid.posting * step, len(range(rows.start, rows.stop, step)),
        len(range(cols.start, cols.stop, step)),
    )  # fmt: skip
