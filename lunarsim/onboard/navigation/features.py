"""What of a raster stands out from its surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Least share of the square around a post that must be known.
_LEAST = 0.6


def above_plane(height: Array, known: Mask, reach: int) -> tuple[Array, Mask]:
    """Return heights above the plane fitted to the known posts around, and where there is one.

    Swells and the tilt of a wrong attitude are gone; what is left are features. Voids leave a
    plane as it is as long as they are few.

    Parameters
    ----------
    height
        (rows, cols), m; anything where it is not known.
    known
        (rows, cols).
    reach
        The square around a post has 2 `reach` + 1 posts a side.

    Returns
    -------
    above
        (rows, cols), m; 0 where there is none.
    kept
        Where the post itself is known, and six tenths of the square around it, on all its sides.
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
    # Cramer's rule for the plane's height at the post.
    a, b, c = xx * yy - xy * xy, x * yy - y * xy, x * xy - y * xx
    det = n * a - x * b + y * c
    # The variance of the plane there, in units of a post's: large where all lie to one side.
    kept = known & (n >= _LEAST * side * side)
    kept &= a <= 4.0 * det / (_LEAST * side * side)
    safe = np.where(kept, det, 1.0)
    plane = (z * a - xz * b + yz * c) / safe
    return np.where(kept, filled - plane, 0.0), kept
