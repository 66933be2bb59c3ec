"""Define the raster grid in ENU that all maps use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.typing import Array, BoolArray, IntArray

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB")


def format_bytes(count: float) -> str:
    """Format a number of bytes with a binary unit, such as 4.61 TiB.

    Examples
    --------
    >>> format_bytes(5e9)
    '4.66 GiB'
    """
    power = 0
    while count >= 1024.0 and power < len(_UNITS) - 1:
        count, power = count / 1024.0, power + 1
    return f"{count:.3g} {_UNITS[power]}"


def check_raster_size(
    field: str, size: float, posting: float, max_cells_per_side: int, what: str = "cells"
) -> None:
    """Check that a square raster has not too many cells, before memory is allocated.

    Parameters
    ----------
    field
        Name of the field that set the size, for errors.
    size, posting
        Side of the raster and side of a cell, m.
    max_cells_per_side
        Maximum number of cells along a side.
    what
        Name of the cells in the message.

    Raises
    ------
    InputError
        If there are too many cells; the message states the memory they need, at 4 bytes per cell.
    """
    count = size / posting
    if not count <= max_cells_per_side:
        raise InputError(
            field, size,
            f"must be at most {max_cells_per_side * posting:g} m ({max_cells_per_side} {what} of "
            f"{posting:g} m)",
            f"This size needs {format_bytes(4.0 * count * count)} of memory. Decrease the size, or "
            "use a coarser grid.",
        )  # fmt: skip


@dataclass(frozen=True)
class Grid:
    """Raster grid of square cells in the ENU frame.

    Values belong to cell centres. Row 0 is the southernmost row and column 0 the westernmost
    column, so plots of rasters need ``origin="lower"``.

    Attributes
    ----------
    x0, y0
        East and north coordinate of the centre of cell (0, 0), m.
    posting
        Side of a cell, m.
    rows, cols
        Number of cells to the north and to the east.
    """

    x0: float
    y0: float
    posting: float
    rows: int
    cols: int

    def __post_init__(self) -> None:
        if not (np.isfinite(self.posting) and self.posting > 0.0):
            raise InputError("grid.posting", self.posting, "must be positive and finite")
        if self.rows < 1 or self.cols < 1:
            raise InputError("grid.shape", self.shape, "must have at least one row and one column")

    @classmethod
    def centred(
        cls, centre: ArrayLike, width: float, posting: float, height: float | None = None
    ) -> Grid:
        """Return a grid of `width` (east) by `height` (north) metres around a centre.

        `centre` (2,) or (3,) is in ENU, m; `posting` is the side of a cell, m.

        Width and height are measured between outer edges; without `height` the grid is square.

        Examples
        --------
        >>> grid = Grid.centred((0.0, 0.0), 4.0, 1.0)
        >>> grid.shape, grid.extent
        ((4, 4), (-2.0, 2.0, -2.0, 2.0))
        >>> grid.x
        array([-1.5, -0.5,  0.5,  1.5])
        """
        cx, cy = np.asarray(centre, dtype=np.float64)[:2]
        cols = max(1, round(width / posting))
        rows = max(1, round((width if height is None else height) / posting))
        return cls(
            float(cx - 0.5 * (cols - 1) * posting),
            float(cy - 0.5 * (rows - 1) * posting),
            float(posting),
            rows,
            cols,
        )

    def about(self, centre: ArrayLike) -> Grid:
        """Return a grid of the same size around another centre (2,) or (3,), ENU, m."""
        width, height = self.cols * self.posting, self.rows * self.posting
        return Grid.centred(centre, width, self.posting, height)

    def moved(self, by: ArrayLike) -> Grid:
        """Return the grid translated by a vector (2,) or (3,), ENU, m."""
        dx, dy = np.asarray(by, dtype=np.float64)[:2]
        return Grid(float(self.x0 + dx), float(self.y0 + dy), self.posting, self.rows, self.cols)

    @property
    def centre(self) -> tuple[float, float]:
        """East and north coordinate of the centre of the grid, ENU, m."""
        west, east, south, north = self.extent
        return 0.5 * (west + east), 0.5 * (south + north)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return (self.rows, self.cols)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south and north outer edge, ENU, m (the order of `imshow`)."""
        h = 0.5 * self.posting
        return (
            self.x0 - h,
            self.x0 + (self.cols - 0.5) * self.posting,
            self.y0 - h,
            self.y0 + (self.rows - 0.5) * self.posting,
        )

    @property
    def x(self) -> Array:
        """East coordinates of the columns (cols,), m."""
        return np.asarray(self.x0 + self.posting * np.arange(self.cols, dtype=np.float64))

    @property
    def y(self) -> Array:
        """North coordinates of the rows (rows,), m."""
        return np.asarray(self.y0 + self.posting * np.arange(self.rows, dtype=np.float64))

    def centres(self) -> Array:
        """Return the centres of all cells (rows, cols, 2), ENU, m."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)

    def cell(self, xy: ArrayLike) -> tuple[IntArray, IntArray]:
        """Return row and column (...) of the cells that contain points (..., 2), ENU, m.

        Indices of points outside the grid are out of range.

        Examples
        --------
        >>> row, col = Grid.centred((0.0, 0.0), 4.0, 1.0).cell([1.2, -1.6])
        >>> int(row), int(col)
        (0, 3)
        """
        xy = np.asarray(xy, dtype=np.float64)
        col = np.floor((xy[..., 0] - self.x0) / self.posting + 0.5).astype(np.int64)
        row = np.floor((xy[..., 1] - self.y0) / self.posting + 0.5).astype(np.int64)
        return row, col

    def contains(self, xy: ArrayLike) -> BoolArray:
        """Return which points (..., 2), ENU, m, lie inside the grid (...).

        Examples
        --------
        >>> Grid.centred((0.0, 0.0), 4.0, 1.0).contains([[0.0, 0.0], [2.5, 0.0]])
        array([ True, False])
        """
        row, col = self.cell(xy)
        return (row >= 0) & (row < self.rows) & (col >= 0) & (col < self.cols)

    def centre_of(self, row: ArrayLike, col: ArrayLike) -> Array:
        """Return the centres (..., 2), ENU, m, of the cells at rows and columns (...).

        Examples
        --------
        >>> Grid.centred((0.0, 0.0), 4.0, 1.0).centre_of(0, 3)
        array([ 1.5, -1.5])
        """
        x = self.x0 + self.posting * np.asarray(col, dtype=np.float64)
        y = self.y0 + self.posting * np.asarray(row, dtype=np.float64)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)
