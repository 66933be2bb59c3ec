"""Accumulate small scans until they cover enough grid points of a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation import _kriging_kernels as kernels
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan
from lunarsim.onboard.navigation.submap import Submap
from lunarsim.typing import Array

# Squares per grid spacing of the map in which scans are averaged. The second number is the ratio of
# covered grid points to grid points that must agree; points at the edge have no slope.
_SQUARES_PER_POST, _POSTS_RATIO = 4, 3


class ScanAccumulator:
    """Combines small scans until they cover enough map grid points for a fit.

    The scans are averaged over squares of the local frame.

    Parameters
    ----------
    posting
        Grid spacing of the map, m.
    min_agreeing
        Number of grid points that must agree in a fit.
    max_time_s
        Maximum time of an accumulation, s.
    """

    def __init__(self, posting: float, min_agreeing: int, max_time_s: float) -> None:
        self._posting = posting
        self._min_posts = _POSTS_RATIO * min_agreeing
        self._max_time = max_time_s
        self._submap: Submap | None = None
        self._since = -np.inf

    def take(self, corrected: CorrectedScan, time: float) -> CorrectedScan | None:
        """Add a scan; return a scan that covers enough map grid points, else None.

        The result is the given scan if it is large enough, or else all accumulated points. The
        accumulated points are fixed in the local frame, and are returned as a scan from the current
        pose. `time` is in s.
        """
        points = corrected.points()
        if count_covered_squares(points, self._posting, self._min_posts) == self._min_posts:
            return corrected
        if self._submap is None or time - self._since > self._max_time:
            self._submap, self._since = Submap(0.0, 0.0, self._posting / _SQUARES_PER_POST), time
        self._submap.add(points)
        if self._submap.count < self._min_posts * _SQUARES_PER_POST**2:
            return None
        accumulated, self._submap = self._submap, None
        body = (accumulated.points() - corrected.position) @ quat_to_matrix(corrected.attitude)
        reach = np.linalg.norm(body, axis=1)
        scan = replace(
            corrected.scan, range=reach, direction=(body @ corrected.scan.mount) / reach[:, None],
            sigma=np.full(len(reach), float(np.nanmedian(corrected.scan.sigma))),
            shape=(1, len(reach)),
        )  # fmt: skip
        return replace(corrected, scan=scan)


def count_covered_squares(points: Array, posting: float, max_count: int = 1 << 40) -> int:
    """Count the grid squares that contain scan points (n, 3), m; stop at `max_count`.

    The squares have the side `posting`, m. NaN marks missing points.
    """
    count = int(kernels.count_covered_squares(np.ascontiguousarray(points), posting, max_count))
    if count >= 0:
        return count
    xy = points[np.isfinite(points[:, :2]).all(axis=1), :2]
    place = np.floor((xy - xy.min(axis=0)) / posting)
    return min(len(np.unique(place @ (1.0, 1e7))), max_count)
