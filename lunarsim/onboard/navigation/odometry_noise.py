"""What heights of two scans differ by where neither pose errs: noise of a comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.navigation.registration import Fit, together

Array = NDArray[np.float64]

# Deviations by which chance may make slopes of two scans alike.
_BY_CHANCE = 3.0
# The differences of two scans scatter by no less than this share of what is taken beforehand; and
# tell this many times less than they scatter, since the slopes that weigh them err too.
_LEAST_SCATTER, _SLOPES = 0.01, 1.5


def slopes(new: Array, old: Array) -> Array:
    """Return the normals (m, 3) by which two scans are compared.

    Slopes of a scan have its noise, which on smooth ground is all there is: it would look like
    ground that tells where it lies (errors in variables; Fuller 1987, section 1.1). What both scans
    have in common is none of it, so slopes are drawn to their mean by the share of their variance
    that the two have not in common.

    Parameters
    ----------
    new, old
        Normals (-dz/dx, -dz/dy, 1) of the same squares in both scans (m, 3).
    """
    slope = 0.5 * (new[:, :2] + old[:, :2])
    middle = slope.mean(axis=0)
    a, b = new[:, :2] - new[:, :2].mean(axis=0), old[:, :2] - old[:, :2].mean(axis=0)
    common, own = float(np.mean(a * b)), float(np.mean((slope - middle) ** 2))
    # By chance the slopes of two level scans have this much in common.
    chance = _BY_CHANCE * float(np.sqrt(np.mean(a**2) * np.mean(b**2) / (2 * len(a))))
    share = min(max(common - chance, 0.0) / own, 1.0) if own > 0.0 else 0.0
    out = np.ones_like(new)
    out[:, :2] = middle + share * (slope - middle)
    return out


def scatter(
    result: Fit, squares: tuple[NDArray[np.int64], NDArray[np.int64]], left: Array, variance: Array
) -> float:
    """Return the variance of two scans' differences by what a fit leaves of them.

    Over that taken beforehand: of single squares, or of their sums over blocks if that is more.
    """
    single = max(result.misfit, _LEAST_SCATTER**2)
    return _SLOPES * single * max(together(squares, left, single * variance), 1.0)


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
