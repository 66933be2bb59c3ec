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
    """Return a layer (rows, cols) on the cells of another grid.

    On the same grid the layer is returned unchanged. Otherwise each cell takes the worst value
    within one cell of its centre, for the larger of both cell sizes.

    Parameters
    ----------
    layer, of
        Values and their grid.
    to
        Target grid.
    outside
        Value off the layer.
    worst
        Which extreme of several values is the worst.
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
    """Return rows, columns of one grid at the cells of another, and which are on it."""
    xy = to.centres()
    row, col = of.cell(xy)
    found = np.clip(row, 0, of.rows - 1), np.clip(col, 0, of.cols - 1), of.contains(xy)
    for layer in found:
        layer.flags.writeable = False
    return found
