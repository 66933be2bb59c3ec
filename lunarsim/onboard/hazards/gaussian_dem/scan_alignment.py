"""Alignment of a new scan with the elevation samples of earlier scans.

The estimated position of the lander drifts by decimetres between scans. Samples that are placed
wrongly relative to each other make rocks look wide and low. The offset between the scans is the
shift that minimises the mean absolute height difference between new points and stored samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem.conventional import finite_rows
from lunarsim.typing import Array, IntArray

# Maximum horizontal offset that is searched for, m.
_MAX_SHIFT_M = 1.0
# Maximum number of points of a scan that are compared; more are thinned evenly.
_MAX_POINTS = 16_384
# Minimum number of new points in cells with stored samples.
_MIN_SHARED_POINTS = 30
# An offset counts from this many standard errors on; shorter ones stay uncorrected, m.
_MIN_OFFSET_SIGMAS, _MIN_HEIGHT_M, _MIN_SHIFT_CELLS = 5.0, 0.01, 0.25
# Ratio of the standard deviation to the median absolute deviation of normal values, and ratio of
# the standard errors of their median and mean.
_MAD_TO_SIGMA, _MEDIAN_TO_MEAN_ERROR = 1.4826, 1.2533


@dataclass(frozen=True)
class ScanOffset:
    """Offset of a scan from stored samples.

    Attributes
    ----------
    shift
        East, north, up (3,), m: new position of the terrain minus stored position. A component
        that is not significant is 0.
    height_sigma
        Standard error of the height offset, m.
    """

    shift: Array
    height_sigma: float


def scan_offset(stored: Array, grid: Grid, points: ArrayLike) -> ScanOffset | None:
    """Estimate the offset of new points from stored heights.

    The horizontal offset is significant if the height differences decrease by at least five
    standard errors, compared point by point with those without an offset. It is then found to a
    fraction of a cell from the parabola through the neighbouring shifts.

    Parameters
    ----------
    stored
        Heights of the stored samples (rows, cols), m; NaN without a sample.
    grid
        Cells of the stored heights.
    points
        East, north, up (n, 3), m, with the same height datum; rows with NaN are ignored.

    Returns
    -------
    ScanOffset or None
        None if fewer than 30 new points are in cells with stored samples.
    """
    cloud = np.asarray(points, dtype=np.float64)
    cloud = cloud[finite_rows(cloud)]
    cloud = cloud[:: max(1, -(-len(cloud) // _MAX_POINTS))]
    reach = int(np.ceil(_MAX_SHIFT_M / grid.posting)) + 1
    wide = np.pad(stored, reach, constant_values=np.nan)
    cloud = cloud[np.asarray(grid.contains(cloud[:, :2]))]
    cells = np.column_stack(grid.cell(cloud[:, :2])) + reach
    here = _differences(wide, cells, cloud[:, 2], (0, 0))
    shared = np.isfinite(here)
    if np.count_nonzero(shared) < _MIN_SHARED_POINTS:
        return None
    best, north, east = _best_shift(wide, cells, cloud[:, 2], reach)
    moved = _differences(wide, cells, cloud[:, 2], best)
    shift = np.array([east, north]) * grid.posting
    if np.hypot(*shift) < _MIN_SHIFT_CELLS * grid.posting or not _is_significant(
        _loss(here) - _loss(moved)
    ):
        shift, moved = np.zeros(2), here
    moved = moved[np.isfinite(moved)]
    rise = float(np.median(moved))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(moved - rise)))
    sigma = _MEDIAN_TO_MEAN_ERROR * spread / float(np.sqrt(len(moved)))
    if abs(rise) < max(_MIN_OFFSET_SIGMAS * sigma, _MIN_HEIGHT_M):
        rise = 0.0
    return ScanOffset(np.array([*shift, rise]), sigma)


def _differences(wide: Array, cells: IntArray, heights: Array, shift: tuple[int, int]) -> Array:
    """Return new minus stored heights (n,), m, for a shift in cells.

    `shift` is (rows, columns). `wide` are the stored heights with a margin, m; `cells` (n, 2) are
    the cells of the points in it and `heights` (n,) their heights, m.
    """
    return np.asarray(heights - wide[cells[:, 0] - shift[0], cells[:, 1] - shift[1]])


def _is_significant(gain: Array) -> bool:
    """Return whether the mean of gains (n,) significantly exceeds 0; NaN: unknown."""
    gain = gain[np.isfinite(gain)]
    if len(gain) < _MIN_SHARED_POINTS:
        return False
    error = float(gain.std()) / float(np.sqrt(len(gain)))
    return float(gain.mean()) > _MIN_OFFSET_SIGMAS * error


def _loss(differences: Array) -> Array:
    """Return the absolute differences from the median (n,), m."""
    return np.asarray(np.abs(differences - np.nanmedian(differences)))


def _best_shift(
    wide: Array, cells: IntArray, heights: Array, reach: int
) -> tuple[tuple[int, int], float, float]:
    """Return the shift with the smallest mean loss, and its refined values.

    The shift is in integer cells (rows, columns), the refined values are in cells north and east.
    Shifts of up to `reach` cells along rows and columns are compared; those that leave fewer than
    half of the shared points are excluded.
    """
    side = 2 * reach + 1
    losses, counts = np.full((side, side), np.inf), np.zeros((side, side))
    for i in range(side):
        for j in range(side):
            loss = _loss(_differences(wide, cells, heights, (i - reach, j - reach)))
            known = np.isfinite(loss)
            counts[i, j] = np.count_nonzero(known)
            if counts[i, j] >= _MIN_SHARED_POINTS:
                losses[i, j] = float(loss[known].mean())
    losses[counts < 0.5 * counts[reach, reach]] = np.inf
    i, j = divmod(int(np.argmin(losses)), side)
    north = i - reach + _vertex(losses[i - 1 : i + 2, j])
    east = j - reach + _vertex(losses[i, j - 1 : j + 2])
    return (i - reach, j - reach), north, east


def _vertex(values: Array) -> float:
    """Return the minimum of a parabola through three values at -1, 0 and 1.

    The result is the position of the minimum; it is 0 without three finite values.
    """
    if values.size < 3 or not np.isfinite(values).all():
        return 0.0
    curvature = values[0] - 2.0 * values[1] + values[2]
    return float(0.5 * (values[0] - values[2]) / curvature) if curvature > 0.0 else 0.0
