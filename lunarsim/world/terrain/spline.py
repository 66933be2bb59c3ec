"""Cubic spline interpolation of a raster that can have gaps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.typing import Array, BoolArray


class GappySpline:
    """Cubic spline through a raster; its values next to gaps are extrapolated.

    Parameters
    ----------
    z
        Values (rows, cols); NaN in gaps, but not everywhere.
    extrapolate_slopes
        Whether to extrapolate slopes into gaps, which prevents oscillation next to them;
        otherwise gaps take the value of the nearest known point.
    """

    def __init__(self, z: NDArray[np.floating], *, extrapolate_slopes: bool = False) -> None:
        self._known = np.isfinite(z)
        self.filled = z.astype(np.float64)
        if not self._known.all():
            nearest = ndimage.distance_transform_edt(
                ~self._known, return_distances=False, return_indices=True
            )
            self.filled = self.filled[tuple(nearest)]
            if extrapolate_slopes:
                self._extrapolate_slopes(nearest)
        self._coefficients = ndimage.spline_filter(self.filled, order=3, mode="mirror")

    def _extrapolate_slopes(self, nearest: NDArray[np.int32]) -> None:
        """Fill gaps by reflecting the raster through the nearest known point.

        `nearest` (2, rows, cols) are the row and column of that point for every raster point. A gap
        whose mirror point is also a gap keeps the value of the nearest known point.
        """
        rows, cols = np.nonzero(~self._known)
        at = nearest[:, rows, cols]
        shape = np.array(self._known.shape)[:, None]
        row, col = np.clip(2 * at - (rows, cols), 0, shape - 1)
        known = self._known[row, col]
        rows, cols, row, col = rows[known], cols[known], row[known], col[known]
        self.filled[rows, cols] = 2.0 * self.filled[rows, cols] - self.filled[row, col]

    def __call__(self, rows: Array, cols: Array) -> Array:
        """Interpolate the raster at fractional rows and columns inside it."""
        z = ndimage.map_coordinates(
            self._coefficients, (rows, cols), order=3, mode="mirror", prefilter=False
        )
        return np.asarray(z)

    def is_gap(self, rows: Array, cols: Array) -> BoolArray:
        """Return which fractional rows and columns have a gap among their 4 neighbours."""
        if self._known.all():
            return np.zeros(np.shape(rows), dtype=bool)
        gaps = (~self._known).astype(np.float64)
        return np.asarray(ndimage.map_coordinates(gaps, (rows, cols), order=1) > 1e-9)
