"""Rejection of isolated returns of a LiDAR scan, such as noise counts.

A return on the terrain has neighbours at nearly the same range: other terrain, or the same rock. A
noise count has a random range. The test is a radius outlier removal (Rusu and Cousins, "3D is here:
Point Cloud Library", ICRA 2011) on the detector, with one neighbour required.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from lunarsim.messages.measurements import LidarScan
from lunarsim.typing import Array

# Half side of the square of pixels in which a neighbour is searched.
_REACH_PIXELS = 2
# A neighbour differs in range by at most this distance (m) plus a number of sample spacings plus a
# number of standard deviations. A rock that only one pixel hits is narrower than two spacings, and
# rocks are not higher than wide: such a rock is always a neighbour of the terrain beside it.
_MIN_DIFFERENCE_M, _SPACINGS, _SIGMAS = 1.0, 2.0, 6.0


def without_isolated_returns(scan: LidarScan, attitude: Array) -> LidarScan:
    """Return a scan without the returns that no neighbouring return supports.

    A return is removed (NaN) if other returns are within two pixels, but none of them at nearly
    the same range. The maximum difference is 1 m plus two sample spacings plus six standard
    deviations.

    Parameters
    ----------
    scan
        Valid scan, as in `LidarScan.check`.
    attitude
        Quaternion of the lander, body to ENU (4,).
    """
    limit = _MIN_DIFFERENCE_M + _SPACINGS * scan.spacing(attitude) + _SIGMAS * scan.sigma
    ranges = np.pad(scan.range.reshape(scan.shape), _REACH_PIXELS, constant_values=np.nan)
    own, has_neighbour = np.flatnonzero(np.isfinite(scan.range)), np.zeros(scan.range.size, bool)
    around = product(range(-_REACH_PIXELS, _REACH_PIXELS + 1), repeat=2)
    # The nearest pixels first: nearly all returns have support there and leave the loop.
    for down, right in sorted(around, key=lambda offset: offset[0] ** 2 + offset[1] ** 2)[1:]:
        row, col = np.divmod(own, scan.shape[1])
        near = ranges[row + down + _REACH_PIXELS, col + right + _REACH_PIXELS]
        has_neighbour[own] |= np.isfinite(near)
        with np.errstate(invalid="ignore"):
            own = own[~(np.abs(near - scan.range[own]) <= limit[own])]
    isolated = own[has_neighbour[own]]
    if not len(isolated):
        return scan
    kept = scan.range.copy()
    kept[isolated] = np.nan
    return replace(scan, range=kept)
