"""Height map of the scanned terrain in the local frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation import _kriging_kernels as kernels
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan
from lunarsim.typing import Array, BoolArray

# Maximum number of squares per side: a scan that grazes the horizon covers an unlimited area.
_MAX_SQUARES = 3000


class Submap:
    """Height map that accumulates the mean height of scan points over grid squares.

    A single scan covers few grid points of a prior map; all scans together cover the swept area.

    Parameters
    ----------
    west, south
        Corner of square (0, 0), m.
    side
        Side of the squares, m.

    Attributes
    ----------
    first
        Row and column of the first stored square.
    """

    def __init__(self, west: float, south: float, side: float) -> None:
        self._west, self._south, self._side = west, south, side
        self.first = (0, 0)
        self._sum = np.zeros((0, 0))
        self._count = np.zeros((0, 0))

    def add(self, points: Array) -> bool:
        """Add points (n, 3), m, local frame; return whether any was added.

        NaN marks missing points. No point is added if the map would have more than 3000 squares
        along a side.
        """
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) == 0:
            return False
        place = np.floor((points[:, :2] - (self._west, self._south)) / self._side)
        if np.ptp(place, axis=0).max() >= _MAX_SQUARES:
            return False
        col, row = place.astype(np.int64).T
        if not self._extend_to_cover(
            int(row.min()), int(row.max()), int(col.min()), int(col.max())
        ):
            return False
        rows, cols = self._sum.shape
        index = (row - self.first[0]) * cols + col - self.first[1]
        self._sum += np.bincount(index, points[:, 2], rows * cols).reshape(rows, cols)
        self._count += np.bincount(index, minlength=rows * cols).reshape(rows, cols)
        return True

    def _extend_to_cover(self, south: int, north: int, west: int, east: int) -> bool:
        """Extend the arrays to cover given rows and columns; return whether possible.

        `south` and `north` are row numbers, `west` and `east` column numbers. If the map would
        have more than 3000 squares along a side, the arrays stay unchanged and the result is
        False.
        """
        rows, cols = self._sum.shape
        if self._sum.size:
            south, west = min(south, self.first[0]), min(west, self.first[1])
            north = max(north, self.first[0] + rows - 1)
            east = max(east, self.first[1] + cols - 1)
        if north - south >= _MAX_SQUARES or east - west >= _MAX_SQUARES:
            return False
        shape = (north - south + 1, east - west + 1)
        if shape != (rows, cols):
            # Allocate a margin for later scans, so that not every scan copies the arrays.
            margin = 32
            grown = np.zeros((2, shape[0] + 2 * margin, shape[1] + 2 * margin))
            first = (south - margin, west - margin)
            if self._sum.size:
                r, c = self.first[0] - first[0], self.first[1] - first[1]
                grown[:, r : r + rows, c : c + cols] = self._sum, self._count
            self._sum, self._count = grown
            self.first = first
        return True

    @property
    def count(self) -> int:
        """Number of grid squares that contain points."""
        return int(np.count_nonzero(self._count))

    def points(self) -> Array:
        """Return the square centres at their mean heights (n, 3), m.

        Only squares that contain points are returned.
        """
        row, col = np.nonzero(self._count)
        place = np.column_stack((col + self.first[1], row + self.first[0])) + 0.5
        xy = place * self._side + (self._west, self._south)
        return np.column_stack((xy, self._sum[row, col] / self._count[row, col]))

    def block_means(self) -> tuple[Array, BoolArray]:
        """Return mean heights over blocks of 2 x 2 squares, m, and which are known.

        Element (i, j) is the mean over the squares (i, j) to (i + 1, j + 1) after `first`. If the
        squares are half as wide as the spacing of a prior map, there is one element at every half
        grid spacing. A height is known if all four squares have points, which makes it the mean
        over an evenly covered area.
        """
        if min(self._sum.shape) < 2:
            return np.zeros((0, 0)), np.zeros((0, 0), np.bool_)
        seen = self._count > 0.0
        mean = self._sum / np.maximum(self._count, 1.0)
        parts = [(slice(a, a - 1 or None), slice(b, b - 1 or None)) for a in (0, 1) for b in (0, 1)]
        known = np.logical_and.reduce([seen[p] for p in parts])
        height = 0.25 * sum(mean[p] for p in parts)
        return np.where(known, height, 0.0), known


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

        If the given scan is large enough, it is returned and not added. Otherwise it is added, and
        all accumulated points are returned once they are enough; the accumulation then starts
        again, as it does after the maximum time. The accumulated points are fixed in the local
        frame, and are returned as a scan from the current pose. `time` is in s.
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
