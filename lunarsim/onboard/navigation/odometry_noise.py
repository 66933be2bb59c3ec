"""Noise model of scan-to-scan height differences."""

from __future__ import annotations

import numpy as np

from lunarsim.typing import Array, BoolArray

# Factor on the noise variance of a slope below which the slope is set to the median.
_MIN_SLOPE_RATIO = 6.0
# Minimum standard deviation of the height of a square, m.
_MIN_SIGMA_M = 3e-4


def comparison_normals(new: Array, old: Array) -> Array:
    """Return terrain normals (n, 3) for the comparison of two scans, without noise.

    Measured slopes contain the scan noise, which dominates on smooth terrain and would look like
    position information (errors in variables; Fuller 1987, section 1.1). The difference of the two
    scans gives the noise. Slopes are shrunk towards the median slope by this noise, and slopes that
    do not exceed it are set to the median.

    Parameters
    ----------
    new, old
        Normals (-dz/dx, -dz/dy, 1) of the same squares in both scans (n, 3).
    """
    slope = 0.5 * (new[:, :2] + old[:, :2])
    middle = np.median(slope, axis=0)
    deviation = slope - middle
    noise = (1.4826 * float(np.median(np.abs(new[:, :2] - old[:, :2])))) ** 2 / 4.0
    shrinkage = np.maximum(
        1.0 - _MIN_SLOPE_RATIO * noise / np.maximum(np.sum(deviation**2, axis=1), 1e-300), 0.0
    )
    out = np.ones_like(new)
    out[:, :2] = middle + shrinkage[:, None] * deviation
    return out


def height_variances(normal: Array, residual: Array, used: BoolArray) -> Array:
    """Estimate the height variance of each square (n,), m^2, from fit residuals.

    `residual` (n,), m, are the residuals, `normal` (n, 3) the terrain normals, and `used` (n,)
    marks the squares used in the fit. The variance grows with the squared slope: at the edges of
    rocks the measured height depends on the viewpoint.
    """
    square = residual**2
    squared_slope = np.sum((normal[:, :2] - np.median(normal[:, :2], axis=0)) ** 2, axis=1)
    is_flat = used & (squared_slope <= np.median(squared_slope[used]))
    min_variance = max(float(np.mean(square[is_flat])), _MIN_SIGMA_M**2)
    is_steep = used & ~is_flat
    slope_sum = float(np.sum(squared_slope[is_steep]))
    growth = max(float(np.sum(square[is_steep])) - min_variance * int(is_steep.sum()), 0.0)
    return np.asarray(
        min_variance + (growth / slope_sum if slope_sum > 0.0 else 0.0) * squared_slope
    )


def linearisation_variance(prior: Array, displacements: Array) -> float:
    """Return the variance of the linearisation error of a scan comparison, m^2.

    The error is common to all squares. Attitude errors rotate the displacements of the lander and
    of the observed terrain between the two scans. The squared angle times the displacement is the
    second-order error.

    Parameters
    ----------
    prior
        Prior covariance of the pose, the reference pose and the scanner errors.
    displacements
        Displacements of the lander and of the observed terrain (2, 3), m.
    """
    angles = 0.5 * float(np.trace(prior[3:6, 3:6]) + np.trace(prior[9:12, 9:12]))
    angles += float(np.trace(prior[13:16, 13:16]))
    return float(angles**2 * np.sum(displacements**2))
