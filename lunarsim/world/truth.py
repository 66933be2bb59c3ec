"""Exact safety of the true terrain, for evaluating maps and for the oracle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import SafetyMap, exact_safety
from lunarsim.typing import BoolArray
from lunarsim.world import World
from lunarsim.world.site_safety import site_safety
from lunarsim.world.terrain import Terrain

# Fixed, so that no map setting changes the reference that maps are evaluated against, m.
TRUTH_POSTING_M = 0.2
# West, east, south and north edges, m.
Bounds = tuple[float, float, float, float]
# Values of `TerrainTruth._known_sites`: not evaluated, unknown terrain, unsafe, safe.
_OPEN, _UNKNOWN, _UNSAFE, _SAFE = range(4)


@dataclass(frozen=True)
class TruthMap:
    """True elevation and exact safety of the sites of a grid, in the true ENU frame.

    Attributes
    ----------
    grid
        Grid of the sites.
    elevation
        True elevation (rows, cols), m.
    safe
        Whether a touchdown at each site is safe at every heading (rows, cols).
    observed
        False where the footprint leaves the terrain or contains unknown terrain (rows, cols).
    """

    grid: Grid
    elevation: NDArray[np.float32]
    safe: BoolArray
    observed: BoolArray


@dataclass(frozen=True, eq=False)
class TerrainTruth:
    """Exact landing safety of sites on the true terrain.

    A site is evaluated when it is needed, on the terrain sampled finely (`site_safety`).

    Attributes
    ----------
    terrain
        True relief and rocks.
    grid
        Grid of the sites, in the true ENU frame.
    lander
        Lander that the safety applies to.
    """

    terrain: Terrain
    grid: Grid
    lander: Lander

    @classmethod
    def of(cls, world: World, lander: Lander, posting: float = TRUTH_POSTING_M) -> TerrainTruth:
        """Return the landing safety of a world for a lander, at sites `posting` (m) apart."""
        west, east, south, north = world.terrain.bounds
        centre = 0.5 * (west + east), 0.5 * (south + north)
        grid = Grid.centred(centre, east - west, posting, north - south)
        return cls(world.terrain, grid, lander)

    @cached_property
    def _known_sites(self) -> NDArray[np.uint8]:
        return np.zeros(self.grid.shape, np.uint8)

    def _evaluated(self, row: NDArray[np.int64], col: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return the safety class of sites in rows and columns (...); evaluate if open."""
        known = self._known_sites
        is_open = known[row, col] == _OPEN
        if is_open.any():
            rows, cols = (_range_of(index[is_open]) for index in (row, col))
            part = known[rows, cols]
            where = np.zeros(part.shape, np.bool_)
            where[row[is_open] - rows.start, col[is_open] - cols.start] = True
            grid = _part(self.grid, rows, cols)
            safe, observed = site_safety(self.terrain, grid, self.lander, where=where)
            found = np.where(observed, np.where(safe, _SAFE, _UNSAFE), _UNKNOWN)
            part[where] = found[where]
        return np.asarray(known[row, col])

    def _at(self, xy: ArrayLike) -> NDArray[np.uint8]:
        """Return the safety class of the sites nearest to points (..., 2), ENU, m."""
        row, col = (np.atleast_1d(index) for index in self.grid.cell(xy))
        inside = np.atleast_1d(self.grid.contains(xy))
        found = np.full(row.shape, _UNKNOWN, np.uint8)
        found[inside] = self._evaluated(row[inside], col[inside])
        return found.reshape(np.shape(xy)[:-1])

    def is_safe_at(self, xy: ArrayLike) -> BoolArray:
        """Return whether true points (..., 2), ENU, m, are safe to land on.

        The safety is that of the nearest site; points outside the terrain count as unsafe.
        """
        return np.asarray(self._at(xy) == _SAFE)

    def is_known_at(self, xy: ArrayLike) -> BoolArray:
        """Return whether the exact safety is known at true points (..., 2), ENU, m.

        The value is that of the nearest site; False outside the terrain.
        """
        return np.asarray(self._at(xy) != _UNKNOWN)

    def within(self, bounds: Bounds, max_cells: int | None = None) -> TruthMap:
        """Return the sites within bounds.

        Parameters
        ----------
        bounds
            West, east, south and north edges, m.
        max_cells
            Maximum number of sites along a side: a larger part keeps every k-th row and column.
        """
        rows, cols = _cells_within(self.grid, bounds)
        longest = max(rows.stop - rows.start, cols.stop - cols.start)
        step = -(-longest // max_cells) if max_cells is not None else 1
        # Sites of different parts coincide, so that they are evaluated once.
        rows, cols = (slice(-(-r.start // step) * step, r.stop, step) for r in (rows, cols))
        grid = _part(self.grid, rows, cols)
        row, col = (np.arange(part.start, part.stop, part.step) for part in (rows, cols))
        found = self._evaluated(*np.meshgrid(row, col, indexing="ij"))
        return TruthMap(grid, self.terrain.raster(grid), found == _SAFE, found != _UNKNOWN)

    def raster_safety(self) -> SafetyMap:
        """Return the exact safety of a raster of the complete terrain, one value per site.

        Terrain between the values is not considered, so that some sites seem safe that are not.
        """
        return exact_safety(self.terrain.raster(self.grid), self.grid, self.lander)

    def safe_fraction(
        self, centre: ArrayLike, half_sides: ArrayLike, heading: float | None = None
    ) -> float:
        """Return the fraction of exactly safe sites in a rectangle; NaN without sites.

        Parameters
        ----------
        centre, half_sides
            Centre of the rectangle and half of its sides, each east and north (2,), m.
        heading
            Azimuth of the body x axis, rad; omitted: sites must be safe at every heading.
        """
        (east, north), (dx, dy) = np.asarray(centre)[:2], np.asarray(half_sides)
        rows, cols = _cells_within(self.grid, (east - dx, east + dx, north - dy, north + dy))
        if rows.stop <= rows.start or cols.stop <= cols.start:
            return float("nan")
        grid = _part(self.grid, rows, cols)
        if heading is not None:
            safe, _ = site_safety(self.terrain, grid, self.lander, heading=heading)
            return float(safe.mean())
        return float(self.is_safe_at(grid.centres()).mean())


def _range_of(index: NDArray[np.int64]) -> slice:
    """Return the slice from the minimum to the maximum of indices (n,)."""
    return slice(int(index.min()), int(index.max()) + 1)


def _cells_within(grid: Grid, bounds: Bounds) -> tuple[slice, slice]:
    """Return slices of the rows and columns of `grid` within bounds.

    `bounds` are west, east, south and north, m.
    """
    west, east, south, north = bounds
    (south_row, north_row), (west_col, east_col) = grid.cell([[west, south], [east, north]])
    return (
        slice(max(int(south_row), 0), min(int(north_row) + 1, grid.rows)),
        slice(max(int(west_col), 0), min(int(east_col) + 1, grid.cols)),
    )


def _part(grid: Grid, rows: slice, cols: slice) -> Grid:
    """Return the grid of the selected rows and columns."""
    step = rows.step or 1
    return Grid(
        grid.x0 + grid.posting * cols.start, grid.y0 + grid.posting * rows.start,
        grid.posting * step, len(range(rows.start, rows.stop, step)),
        len(range(cols.start, cols.stop, step)),
    )  # fmt: skip
