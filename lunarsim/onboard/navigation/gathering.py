"""Scans that cover too few posts of a map, gathered until together they cover enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation import _ground_kernels as kernels
from lunarsim.onboard.navigation.seen_scan import SeenScan
from lunarsim.onboard.navigation.submap import Submap

Array = NDArray[np.float64]

# Squares along a post's side that gather scans; and so many posts as must agree must be covered:
# those at the edge have no slope.
_SQUARES, _ENOUGH = 4, 3


class Gathering:
    """Lays scans in the local frame on squares until they cover posts enough for a fit.

    Parameters
    ----------
    posting
        Of the map, m.
    least
        Posts that must agree.
    longest
        Scans older than this are left out, s.
    """

    def __init__(self, posting: float, least: int, longest: float) -> None:
        self._posting = posting
        self._enough = _ENOUGH * least
        self._longest = longest
        self._submap: Submap | None = None
        self._since = -np.inf

    def take(self, seen: SeenScan, time: float) -> SeenScan | None:
        """Return a scan of the local frame that covers posts enough, or all gathered once they do.

        What was gathered is seen from where the lander is now: the frame hangs on the ground.
        """
        points = seen.points()
        if posts_under(points, self._posting, self._enough) == self._enough:
            return seen
        if self._submap is None or time - self._since > self._longest:
            self._submap, self._since = Submap(0.0, 0.0, self._posting / _SQUARES), time
        self._submap.add(points)
        if self._submap.count < self._enough * _SQUARES**2:
            return None
        gathered, self._submap = self._submap, None
        body = (gathered.points() - seen.position) @ quat_to_matrix(seen.attitude)
        reach = np.linalg.norm(body, axis=1)
        scan = replace(
            seen.scan, range=reach, direction=(body @ seen.scan.mount) / reach[:, None],
            sigma=np.full(len(reach), float(np.nanmedian(seen.scan.sigma))), shape=(1, len(reach)),
        )  # fmt: skip
        return replace(seen, scan=scan)


def posts_under(points: Array, posting: float, most: int = 1 << 40) -> int:
    """Return how many posts points (n, 3) lie on, NaN for none; `most` once they are so many."""
    count = int(kernels.squares_under(np.ascontiguousarray(points), posting, most))
    if count >= 0:
        return count
    xy = points[np.isfinite(points[:, :2]).all(axis=1), :2]
    place = np.floor((xy - xy.min(axis=0)) / posting)
    return min(len(np.unique(place @ (1.0, 1e7))), most)
