"""Extract local height features (deviations from a local plane) from a raster."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from lunarsim.typing import Array, BoolArray

# Minimum known fraction of the square around a grid point.
_MIN_KNOWN_SHARE = 0.6


def subtract_plane(height: Array, known: BoolArray, reach: int) -> tuple[Array, BoolArray]:
    """Subtract from each raster height the plane fitted to its neighbourhood.

    The neighbourhood is a square centred on the grid point. The subtraction removes long
    undulations and the tilt by an attitude error, and leaves local terrain features. A few unknown
    heights hardly change the plane.

    Parameters
    ----------
    height
        Heights (rows, cols), m; unknown ones may have any value.
    known
        Whether each height is known (rows, cols).
    reach
        Half width of the square; it has 2 `reach` + 1 grid points per side.

    Returns
    -------
    above
        Heights above the planes (rows, cols), m; 0 without a plane.
    kept
        Whether there is a plane (rows, cols): the grid point and 60 % of its square are known, and
        the known points surround it.
    """
    side = 2 * reach + 1
    offset = np.arange(-reach, reach + 1, dtype=np.float64) / max(reach, 1)
    ones = np.ones(side)
    weight = known.astype(np.float64)
    filled = np.where(known, height, 0.0)

    def moment(of: Array, east: int, north: int) -> Array:
        along = ndimage.correlate1d(of, ones * offset**east, axis=1, mode="constant")
        return np.asarray(ndimage.correlate1d(along, ones * offset**north, axis=0, mode="constant"))

    n = moment(weight, 0, 0)
    x, y = moment(weight, 1, 0), moment(weight, 0, 1)
    xx, xy, yy = moment(weight, 2, 0), moment(weight, 1, 1), moment(weight, 0, 2)
    z, xz, yz = moment(filled, 0, 0), moment(filled, 1, 0), moment(filled, 0, 1)
    # Height of the plane at the central grid point by Cramer's rule.
    a, b, c = xx * yy - xy * xy, x * yy - y * xy, x * xy - y * xx
    det = n * a - x * b + y * c
    # Limit the variance of the plane: it is large if all known points lie on one side.
    kept = known & (n >= _MIN_KNOWN_SHARE * side * side)
    kept &= a <= 4.0 * det / (_MIN_KNOWN_SHARE * side * side)
    safe = np.where(kept, det, 1.0)
    plane = (z * a - xz * b + yz * c) / safe
    return np.where(kept, filled - plane, 0.0), kept
