"""What heights of two scans differ by where neither pose errs: noise of a comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Squares of deviations by which a slope must stand out from the noise.
_STANDS_OUT = 6.0
# Squares err by no less, m.
_LEAST = 3e-4


def slopes(new: Array, old: Array) -> Array:
    """Return the normals (m, 3) by which two scans are compared.

    Slopes of a scan have its noise, which on smooth ground is all there is: it would look like
    ground that tells where it lies (errors in variables; Fuller 1987, section 1.1). How much of it
    there is shows where the two differ; slopes are drawn to the usual one by so much, and those
    that do not stand out are it.

    Parameters
    ----------
    new, old
        Normals (-dz/dx, -dz/dy, 1) of the same squares in both scans (m, 3).
    """
    slope = 0.5 * (new[:, :2] + old[:, :2])
    middle = np.median(slope, axis=0)
    off = slope - middle
    noise = (1.4826 * float(np.median(np.abs(new[:, :2] - old[:, :2])))) ** 2 / 4.0
    stands = np.maximum(1.0 - _STANDS_OUT * noise / np.maximum(np.sum(off**2, axis=1), 1e-300), 0.0)
    out = np.ones_like(new)
    out[:, :2] = middle + stands[:, None] * off
    return out


def variances(normal: Array, left: Array, used: NDArray[np.bool_]) -> Array:
    """Return by what squares (m,) err, m^2, as what a fit leaves of them (m,) shows.

    Steep ones, on the edges of rocks, err by more: what is seen there hangs on from where.
    """
    square = left**2
    steep = np.sum((normal[:, :2] - np.median(normal[:, :2], axis=0)) ** 2, axis=1)
    flat = used & (steep <= np.median(steep[used]))
    least = max(float(np.mean(square[flat])), _LEAST**2)
    rest = used & ~flat
    more = float(np.sum(steep[rest]))
    growth = max(float(np.sum(square[rest])) - least * int(rest.sum()), 0.0)
    return np.asarray(least + (growth / more if more > 0.0 else 0.0) * steep)


def second_order(prior: Array, ways: Array) -> float:
    """Return the variance of what the fit, being linear, has wrong, alike in all squares, m^2.

    Directions that are not known turn the ways (2, 3) that the lander and the ground seen have gone
    between the two scans; the square of the angle moves their ends.

    Parameters
    ----------
    prior
        Covariance of the pose, the pose kept, and the scanner's errors.
    """
    angles = 0.5 * float(np.trace(prior[3:6, 3:6]) + np.trace(prior[9:12, 9:12]))
    angles += float(np.trace(prior[13:16, 13:16]))
    return float(angles**2 * np.sum(ways**2))
