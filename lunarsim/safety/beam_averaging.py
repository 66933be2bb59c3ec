"""Heights of rocks averaged over the footprint of a LiDAR beam.

A beam of finite width measures the mean range over its footprint. A rock that is not much wider is
measured too low. The intensity of the beam is Gaussian, and a rock is half an ellipsoid with a
circular outline.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import dawsn, i0e, i1e

from lunarsim.typing import Array

# Rock heights over the beam's standard deviation in the table of `unaveraged_height`.
_RELATIVE_HEIGHTS = np.geomspace(1e-3, 1e3, 400)


def peak_ratio(radius: ArrayLike, beam_sigma: float) -> Array:
    """Return the measured height at the centre of a rock over its height (...).

    The mean of the height ``H sqrt(1 - r^2 / R^2)`` over a Gaussian beam at the centre is ``H (1 -
    F(x) / x)`` with ``x = R / (sqrt(2) sigma)`` and Dawson's integral F. It is 1 for a line beam.

    Parameters
    ----------
    radius
        Radius of the outline (...), m.
    beam_sigma
        Standard deviation of the beam's intensity across the beam, m; 0: a line.
    """
    r = np.asarray(radius, dtype=np.float64)
    if beam_sigma == 0.0:
        return np.ones_like(r)
    x = r / (np.sqrt(2.0) * beam_sigma)
    # Below the limit the difference is less accurate than the first term of its series.
    return np.asarray(np.where(x < 1e-2, 2.0 / 3.0 * x * x, 1.0 - dawsn(x) / np.maximum(x, 1e-2)))


def unaveraged_height(measured: ArrayLike, beam_sigma: float, height_ratio: float) -> Array:
    """Return the height of the rock that a beam measures as a given height (...), m.

    The beam hits the centre of the rock. Depths below the terrain are converted like heights.

    Parameters
    ----------
    measured
        Measured heights above the terrain (...), m; negative: depths.
    beam_sigma
        Standard deviation of the beam's intensity across the beam, m; 0: a line.
    height_ratio
        Height of the rocks over their diameter.
    """
    z = np.asarray(measured, dtype=np.float64)
    if beam_sigma == 0.0:
        return z
    height = beam_sigma * _RELATIVE_HEIGHTS
    seen = height * peak_ratio(0.5 * height / height_ratio, beam_sigma)
    size = np.abs(z)
    found = np.exp(np.interp(np.log(np.maximum(size, 1e-12)), np.log(seen), np.log(height)))
    return np.sign(z) * np.maximum(found, size) * (size > 0.0)


def sharpened_elevation(elevation: Array, posting: float, beam_sigma: float) -> Array:
    """Return elevations corrected for the averaging over a beam (rows, cols), m.

    To first order, the averaging over a Gaussian beam changes the elevation by ``sigma^2 / 2``
    times its Laplacian. The averaged elevations have a smaller Laplacian than the terrain. The
    correction therefore uses the radius of the beam at 1/e^2, 2 sigma, in place of sigma. It is
    computed from the four neighbours of a cell. A cell without these neighbours is not corrected.

    Parameters
    ----------
    elevation
        Measured elevations (rows, cols), m; NaN where unknown.
    posting
        Side of a cell, m.
    beam_sigma
        Standard deviation of the beam's intensity across the beam, m; 0: a line.
    """
    if beam_sigma == 0.0:
        return elevation
    z, out = elevation, elevation.copy()
    laplacian = z[:-2, 1:-1] + z[2:, 1:-1] + z[1:-1, :-2] + z[1:-1, 2:] - 4.0 * z[1:-1, 1:-1]
    change = 0.5 * (2.0 * beam_sigma / posting) ** 2 * laplacian
    out[1:-1, 1:-1] -= np.where(np.isfinite(change), change, 0.0).astype(z.dtype)
    return out


def variogram_ratio(distance: float, beam_sigma: float) -> float:
    """Return the variogram of averaged over that of true elevations at a distance.

    The variogram of the true elevations is linear up to this distance. The averages at two points
    contain points with distances ``|d + e|``, where e has the variance 2 sigma^2 per axis: the
    variogram of the averages is proportional to ``E|d + e| - E|e|``.

    Parameters
    ----------
    distance
        Distance between two samples, m.
    beam_sigma
        Standard deviation of the beam's intensity across the beam, m; 0: a line.
    """
    if beam_sigma == 0.0:
        return 1.0
    x = (0.5 * distance / beam_sigma) ** 2
    # Mean of a Rice distribution over the mean of the Rayleigh distribution.
    mean = (1.0 + x) * i0e(0.5 * x) + x * i1e(0.5 * x)
    return float((mean - 1.0) * beam_sigma * np.sqrt(np.pi) / distance)
