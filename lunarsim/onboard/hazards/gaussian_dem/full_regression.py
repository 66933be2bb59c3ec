"""Full Gaussian process regression, the reference for the local approximation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from lunarsim.onboard.hazards.gaussian_dem.conventional import check_points
from lunarsim.typing import Array

_MAX_POINTS = 5000  # points; the cost grows with the cube of their number


def full_regression(
    points: ArrayLike, xy: ArrayLike, *, sigma_f: float, length_scale: float, sigma_eps: float
) -> tuple[Array, Array]:
    """Interpolate elevations by Gaussian process regression on all points.

    Implements Eqs. 4 to 6 of the Gaussian DEM paper without the local approximation, as a
    reference.

    Parameters
    ----------
    points
        East, north, up (n, 3), m; at most 5,000.
    xy
        Points at which the elevation is predicted (m, 2), m.
    sigma_f, length_scale, sigma_eps
        Prior standard deviation of the terrain, length scale of the kernel and standard deviation
        of a sample, m.

    Returns
    -------
    mean, variance
        Mean (m,), m, and variance (m,), m^2, of the elevation. The prior mean is the mean of the
        points.

    Raises
    ------
    ValueError
        If there are too many points, or if the kernel matrix is singular (coincident points without
        noise).
    """
    cloud = check_points(points)
    if len(cloud) > _MAX_POINTS:
        raise ValueError(
            f"points: must be at most {_MAX_POINTS} points, got {len(cloud)}. "
            "Use gaussian_dem for more points."
        )
    prior = sigma_f * sigma_f
    gram = prior * np.exp(-cdist(cloud[:, :2], cloud[:, :2]) / length_scale)
    gram[np.diag_indices_from(gram)] += sigma_eps * sigma_eps
    try:
        factor = cho_factor(gram, lower=True)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"sigma_eps: must be positive if two points coincide, got {sigma_eps}. "
            "The kernel matrix is singular."
        ) from None
    base = float(cloud[:, 2].mean())
    cross = prior * np.exp(-cdist(np.atleast_2d(xy), cloud[:, :2]) / length_scale)
    mean = base + cross @ cho_solve(factor, cloud[:, 2] - base)
    explained = np.einsum("mn,nm->m", cross, cho_solve(factor, cross.T))
    return mean, np.maximum(prior - explained, 0.0)
