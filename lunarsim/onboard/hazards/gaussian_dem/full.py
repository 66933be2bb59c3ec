"""Full Gaussian process regression: the reference that the local one approximates."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from lunarsim.onboard.hazards.gaussian_dem.conventional import check_points

_MOST = 5000  # points; the cost grows with the cube of their number

Array = NDArray[np.float64]


def full_regression(
    points: ArrayLike, xy: ArrayLike, *, sigma_f: float, length_scale: float, sigma_eps: float
) -> tuple[Array, Array]:
    """Regress the elevation from all points at once (Eqs. 4 to 6 of the Gaussian DEM paper).

    Parameters
    ----------
    points
        East, north, up (n, 3), m; 5,000 at most.
    xy
        Where to predict (m, 2), m.
    sigma_f, length_scale, sigma_eps
        Prior standard deviation, length scale of the kernel, noise of a sample, m.

    Returns
    -------
    mean, variance
        Of the elevation (m,), m and m^2. The prior mean is the mean of the points.

    Raises
    ------
    ValueError
        If there are too many points, or the kernel matrix is singular (coincident points without
        noise).
    """
    cloud = check_points(points)
    if len(cloud) > _MOST:
        raise ValueError(f"points: {len(cloud)} are too many for full regression, {_MOST} at most")
    prior = sigma_f * sigma_f
    gram = prior * np.exp(-cdist(cloud[:, :2], cloud[:, :2]) / length_scale)
    gram[np.diag_indices_from(gram)] += sigma_eps * sigma_eps
    try:
        factor = cho_factor(gram, lower=True)
    except np.linalg.LinAlgError:
        raise ValueError(
            f"sigma_eps = {sigma_eps}: must be positive where points coincide, the kernel matrix "
            "is singular"
        ) from None
    base = float(cloud[:, 2].mean())
    cross = prior * np.exp(-cdist(np.atleast_2d(xy), cloud[:, :2]) / length_scale)
    mean = base + cross @ cho_solve(factor, cloud[:, 2] - base)
    explained = np.einsum("mn,nm->m", cross, cho_solve(factor, cross.T))
    return mean, np.maximum(prior - explained, 0.0)
