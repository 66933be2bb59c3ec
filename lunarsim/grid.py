"""The one way that rasters are placed on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB")


def bytes_in_words(count: float) -> str:
    """Return a number of bytes in words, such as 4.61 TiB.

    Examples
    --------
    >>> bytes_in_words(5e9)
    '4.66 GiB'
    """
    power = 0
    while count >= 1024.0 and power < len(_UNITS) - 1:
        count, power = count / 1024.0, power + 1
    return f"{count:.3g} {_UNITS[power]}"


def check_side(field: str, size: float, posting: float, most: int, what: str = "cells") -> None:
    """Refuse a square raster of too many cells along a side, before memory is asked for it.

    Parameters
    ----------
    field
        Where the side was given.
    size, posting
        Side and distance of the cells, m.
    most
        Cells along a side.
    what
        What the cells are called.

    Raises
    ------
    InputError
        With what the raster would take, 4 bytes a cell.
    """
    count = size / posting
    if not count <= most:
        raise InputError(
            field, size,
            f"at most {most} {what} of {posting:g} m a side: {count:.4g} squared of 4 bytes are "
            + bytes_in_words(4.0 * count * count),
        )  # fmt: skip


@dataclass(frozen=True)
class Grid:
    """A raster of square cells in ENU.

    Values belong to cell centres. Row 0 is the southernmost, column 0 the westernmost, so a
    raster is drawn with ``origin="lower"``.

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
            raise InputError("grid.posting", self.posting, "a positive length in metres")
        if self.rows < 1 or self.cols < 1:
            raise InputError("grid.shape", self.shape, "at least one row and one column")

    @classmethod
    def centred(
        cls, centre: ArrayLike, width: float, posting: float, height: float | None = None
    ) -> Grid:
        """Return a grid whose outer edges are `width` (east) by `height` (north) metres.

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
        """Return the same grid about another centre (2,) or (3,)."""
        width, height = self.cols * self.posting, self.rows * self.posting
        return Grid.centred(centre, width, self.posting, height)

    def moved(self, by: ArrayLike) -> Grid:
        """Return the same grid moved by (2,) or (3,), m."""
        dx, dy = np.asarray(by, dtype=np.float64)[:2]
        return Grid(float(self.x0 + dx), float(self.y0 + dy), self.posting, self.rows, self.cols)

    @property
    def centre(self) -> tuple[float, float]:
        """East and north of the middle, m."""
        west, east, south, north = self.extent
        return 0.5 * (west + east), 0.5 * (south + north)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return (self.rows, self.cols)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south and north outer edges, m (what `imshow` wants)."""
        h = 0.5 * self.posting
        return (
            self.x0 - h,
            self.x0 + (self.cols - 0.5) * self.posting,
            self.y0 - h,
            self.y0 + (self.rows - 0.5) * self.posting,
        )

    @property
    def x(self) -> NDArray[np.float64]:
        """East coordinates of the columns (cols,), m."""
        return np.asarray(self.x0 + self.posting * np.arange(self.cols, dtype=np.float64))

    @property
    def y(self) -> NDArray[np.float64]:
        """North coordinates of the rows (rows,), m."""
        return np.asarray(self.y0 + self.posting * np.arange(self.rows, dtype=np.float64))

    def centres(self) -> NDArray[np.float64]:
        """Cell centres (rows, cols, 2), m."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)

    def cell(self, xy: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return row and column of the cells that hold points (..., 2); may lie outside.

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

    def contains(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Tell which points (..., 2) lie in a cell of the grid.

        Examples
        --------
        >>> Grid.centred((0.0, 0.0), 4.0, 1.0).contains([[0.0, 0.0], [2.5, 0.0]])
        array([ True, False])
        """
        row, col = self.cell(xy)
        return (row >= 0) & (row < self.rows) & (col >= 0) & (col < self.cols)

    def centre_of(self, row: ArrayLike, col: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (..., 2) of cells, m.

        Examples
        --------
        >>> Grid.centred((0.0, 0.0), 4.0, 1.0).centre_of(0, 3)
        array([ 1.5, -1.5])
        """
        x = self.x0 + self.posting * np.asarray(col, dtype=np.float64)
        y = self.y0 + self.posting * np.asarray(row, dtype=np.float64)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)
