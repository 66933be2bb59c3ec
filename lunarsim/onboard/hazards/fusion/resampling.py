"""Conservative resampling of map layers to another grid."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid

_WORST = {"minimum": ndimage.minimum_filter, "maximum": ndimage.maximum_filter}


def resample_to_grid(
    layer: NDArray[Any], of: Grid, to: Grid, outside: Any, worst: Literal["minimum", "maximum"]
) -> NDArray[Any]:
    """Resample a map layer (rows, cols) to the cells of another grid, conservatively.

    If both grids are equal, the layer is returned unchanged. Otherwise each cell takes the worst
    value within one cell of its centre, for the larger of both cell sizes.

    Parameters
    ----------
    layer, of
        Values (rows, cols) and the grid of their cells.
    to
        Grid of the result.
    outside
        Value of cells that are off the layer.
    worst
        Whether the minimum or the maximum of several values is the worst.
    """
    if of == to:
        return layer
    width = 2 * int(np.ceil(max(0.5 * to.posting / of.posting, 1.0))) + 1
    near = _WORST[worst](layer, width, mode="nearest")
    row, col, inside = _cell_indices(of, to)
    return np.asarray(np.where(inside, near[row, col], outside), layer.dtype)


@lru_cache(maxsize=2)
def _cell_indices(
    of: Grid, to: Grid
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return rows and columns of grid `of` at the cell centres of grid `to`.

    The third array is True where a cell of `to` lies on `of`; elsewhere the indices are clipped.
    All have the shape of `to`.
    """
    xy = to.centres()
    row, col = of.cell(xy)
    found = np.clip(row, 0, of.rows - 1), np.clip(col, 0, of.cols - 1), of.contains(xy)
    for layer in found:
        layer.flags.writeable = False
    return found
