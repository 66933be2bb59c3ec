"""Alignment of a new scan with the elevation samples of earlier scans.

The estimated position of the lander drifts by decimetres between scans. Samples that are placed
wrongly relative to each other make rocks look wide and low. The offset between the scans is the
shift that minimises the mean absolute height difference between new points and stored samples.

Height differences that remain may show that the scans are tilted relative to each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem.conventional import finite_rows
from lunarsim.onboard.hazards.mapper import NEGLIGIBLE_TILT_RAD
from lunarsim.typing import Array, IntArray

# Maximum horizontal offset that is searched for, m.
_MAX_SHIFT_M = 1.0
# Maximum number of points of a scan that are compared; more are thinned evenly.
_MAX_POINTS = 16_384
# Minimum number of new points in cells with stored samples.
_MIN_SHARED_POINTS = 30
# An offset counts from this many standard errors on; shorter ones stay uncorrected, m.
_MIN_OFFSET_SIGMAS, _MIN_HEIGHT_M, _MIN_SHIFT_CELLS = 5.0, 0.01, 0.25
# A tilt is fitted to medians of the height differences in squares: squares along a side of the map,
# minimum number of points in a square, and of squares: four for each of the five unknowns.
_SQUARES, _MIN_SQUARE_POINTS, _MIN_SQUARES = 8, 10, 20
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
    spread
        Standard deviation, from the median, of the height differences that remain, m.
    tilt, tilt_sigma
        Angle between the scan and the stored samples, and its standard error, rad.
    """

    shift: Array
    height_sigma: float
    spread: float
    tilt: float
    tilt_sigma: float

    def is_tilted(self, stated_sigma: float) -> bool:
        """Return whether the tilt exceeds what the stated attitude errors explain.

        `stated_sigma` is the standard deviation of the tilt of a scan, rad; NaN if unknown. A tilt
        counts if it exceeds `NEGLIGIBLE_TILT_RAD` by five standard deviations.
        """
        sigma = np.hypot(self.tilt_sigma, np.sqrt(2.0) * stated_sigma)
        return bool(self.tilt > NEGLIGIBLE_TILT_RAD + _MIN_OFFSET_SIGMAS * sigma)


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
    tilt = _fit_tilt(cells - reach, cloud[:, 2], moved, grid)
    moved = moved[np.isfinite(moved)]
    rise = float(np.median(moved))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(moved - rise)))
    sigma = _MEDIAN_TO_MEAN_ERROR * spread / float(np.sqrt(len(moved)))
    if abs(rise) < max(_MIN_OFFSET_SIGMAS * sigma, _MIN_HEIGHT_M):
        rise = 0.0
    return ScanOffset(np.array([*shift, rise]), sigma, spread, *tilt)


def _fit_tilt(
    cells: IntArray, heights: Array, differences: Array, grid: Grid
) -> tuple[float, float]:
    """Fit the tilt between new and stored heights.

    The results are the tilt and its standard error, rad.
    `cells` (n, 2), `heights` (n,), m, and `differences` (n,), m, are those of the new points. A
    plane is fitted to the medians of the differences in squares. A horizontal shift that remains
    is fitted too: it adds the local slope of the terrain times the shift. The standard error
    follows from the residuals. It is infinite with fewer than 20 squares.
    """
    known = np.isfinite(differences)
    side = -(-max(grid.shape) // _SQUARES)
    shape = -(-grid.rows // side), -(-grid.cols // side)
    index = (cells[:, 0] // side * shape[1] + cells[:, 1] // side)[known]
    few = np.bincount(index, minlength=shape[0] * shape[1]) < _MIN_SQUARE_POINTS
    every = np.arange(few.size)
    difference, height = (
        np.where(few, np.nan, ndimage.median(values[known], index, every)).reshape(shape)
        for values in (differences, heights)
    )
    if min(shape) < 2:
        return 0.0, np.inf
    spacing = side * grid.posting
    row, col = np.indices(shape) * spacing
    columns = np.stack((col, row, *np.gradient(height, spacing), difference), axis=-1)
    columns = columns[np.isfinite(columns).all(axis=-1)]
    if len(columns) < _MIN_SQUARES:
        return 0.0, np.inf
    columns = columns - columns.mean(axis=0)
    design, values = columns[:, :4], columns[:, 4]
    inverse = np.linalg.pinv(design.T @ design)
    fit = inverse @ design.T @ values
    residual = values - design @ fit
    variance = float(residual @ residual) / (len(columns) - 5)
    return float(np.hypot(fit[0], fit[1])), float(np.sqrt(variance * inverse.diagonal()[:2].max()))


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
