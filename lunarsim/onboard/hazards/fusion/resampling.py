"""Conservative resampling of map layers to another grid."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.typing import BoolArray, IntArray

_WORST = {"minimum": ndimage.minimum_filter, "maximum": ndimage.maximum_filter}


def resample_to_grid(
    layer: NDArray[Any],
    source: Grid,
    target: Grid,
    outside: Any,
    worst: Literal["minimum", "maximum"],
) -> NDArray[Any]:
    """Resample a map layer (rows, cols) to the cells of another grid, conservatively.

    If both grids are equal, the layer is returned unchanged. Otherwise each cell of `target` takes
    the worst value in a square of source cells around its centre. The square extends half a target
    cell, rounded up to complete source cells, beyond the source cell that contains the centre.

    Parameters
    ----------
    layer
        Values of the cells of `source` (rows, cols).
    source, target
        Grid of the layer, and grid of the result.
    outside
        Value of target cells whose centre is off the source grid.
    worst
        Whether the minimum or the maximum of several values is the worst.
    """
    if source == target:
        return layer
    width = 2 * int(np.ceil(max(0.5 * target.posting / source.posting, 1.0))) + 1
    near = _WORST[worst](layer, width, mode="nearest")
    row, col, inside = _cell_indices(source, target)
    return np.asarray(np.where(inside, near[row, col], outside), layer.dtype)


@lru_cache(maxsize=2)
def _cell_indices(source: Grid, target: Grid) -> tuple[IntArray, IntArray, BoolArray]:
    """Return the row and column of `source` that contain each cell centre of `target`.

    The third array is True where a cell of `target` lies on `source`; elsewhere the indices are
    clipped. All have the shape of `target`.
    """
    xy = target.centres()
    row, col = source.cell(xy)
    found = np.clip(row, 0, source.rows - 1), np.clip(col, 0, source.cols - 1), source.contains(xy)
    for layer in found:
        layer.flags.writeable = False
    return found
