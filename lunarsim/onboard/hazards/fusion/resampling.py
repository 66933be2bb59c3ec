"""Layers of one map on the cells of another: where in doubt, the worst nearby."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid

_WORST = {"least": ndimage.minimum_filter, "greatest": ndimage.maximum_filter}


def on_grid(
    layer: NDArray[Any], of: Grid, to: Grid, outside: Any, worst: Literal["least", "greatest"]
) -> NDArray[Any]:
    """Return a layer (rows, cols) on the cells of another grid.

    On the same grid it is returned as it is. Else a cell is given the worst of those within a cell
    of its centre, be the cells those of either grid.

    Parameters
    ----------
    layer, of
        Values and their cells.
    to
        The other cells.
    outside
        Value off the layer.
    worst
        Which of several values is the worst.
    """
    if of == to:
        return layer
    width = 2 * int(np.ceil(max(0.5 * to.posting / of.posting, 1.0))) + 1
    near = _WORST[worst](layer, width, mode="nearest")
    xy = to.centres()
    row, col = of.cell(xy)
    found = near[np.clip(row, 0, of.rows - 1), np.clip(col, 0, of.cols - 1)]
    return np.asarray(np.where(of.contains(xy), found, outside), layer.dtype)
