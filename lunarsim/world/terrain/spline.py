"""Interpolate a raster that may have gaps by cubic spline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


class GappySpline:
    """Cubic spline through a raster; it is NaN next to a gap, which it would only invent.

    Parameters
    ----------
    z
        Values (rows, cols); NaN in gaps, but not everywhere.
    """

    def __init__(self, z: NDArray[np.floating]) -> None:
        self._known = np.isfinite(z)
        self.filled = z.astype(np.float64)
        if not self._known.all():
            nearest = ndimage.distance_transform_edt(
                ~self._known, return_distances=False, return_indices=True
            )
            self.filled = self.filled[tuple(nearest)]
        self._coefficients = ndimage.spline_filter(self.filled, order=3, mode="mirror")

    def __call__(
        self, rows: NDArray[np.float64], cols: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return values at fractional rows and columns, which lie within the raster."""
        z = ndimage.map_coordinates(
            self._coefficients, (rows, cols), order=3, mode="mirror", prefilter=False
        )
        return np.asarray(z)

    def is_gap(self, rows: NDArray[np.float64], cols: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether a gap is among the four posts about each place."""
        if self._known.all():
            return np.zeros(np.shape(rows), dtype=bool)
        gaps = (~self._known).astype(np.float64)
        return np.asarray(ndimage.map_coordinates(gaps, (rows, cols), order=1) > 0.0)
