"""Returns of all scans of a descent, accumulated per map cell.

Maps of single scans must not be averaged as if their errors were independent: scans from one place
sample the same points and share their interpolation errors. The pool therefore stores the samples,
and the map is interpolated once between all of them. Noise averages out where a cell is measured
again; interpolation errors shrink only where new points fall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import _sample_kernels as k
from lunarsim.onboard.hazards.gaussian_dem.conventional import (
    base_height,
    check_heights,
    check_points,
    finite_rows,
)
from lunarsim.onboard.hazards.gaussian_dem.scan_alignment import ScanOffset, scan_offset
from lunarsim.onboard.hazards.map_tilt_correction import rotate_about
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import as_real_array, check_finite, check_shape

# Maximum standard deviation or spacing of samples, m.
_MAX_LENGTH_M = 1e4
# Minimum standard deviation of a height, m, whatever the sensor states.
_MIN_SIGMA_M = 1e-4


class SamplePool:
    """Elevation samples of all scans, summed per cell of a grid.

    The memory does not grow with the number of scans.

    Parameters
    ----------
    grid
        Cells of the pool.

    Attributes
    ----------
    base
        Reference height, m, above which the heights in the sums are measured; None before the first
        sample.
    centroid
        Sums of precision (1 / variance, 1/m^2), and of precision times east, north (from the cell
        centre) and height (above `base`), over the samples in each cell (rows, cols, 4).
    splat
        Sums over the samples around each cell, with bilinear weights (Eq. 1 of the Gaussian DEM
        paper) (rows, cols, 4). The first entry is the sum of weights of one scan, the maximum over
        all scans, so that a cell hit only at its edge does not count as measured after many scans.
        The others are the sums of weight over variance, of weight times height over variance, and
        of squared weight over variance.
    spacing
        Minimum distance of neighbouring samples within their scans (rows, cols), m; inf without
        samples.
    peak
        Maximum over the samples in each cell of their height above `base` minus four standard
        deviations (rows, cols), m; -inf without samples.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.base: float | None = None
        self.centroid = np.zeros((*grid.shape, 4))
        self.splat = np.zeros((*grid.shape, 4))
        self.spacing = np.full(grid.shape, np.inf, np.float32)
        self.peak = np.full(grid.shape, -np.inf)

    @property
    def nbytes(self) -> int:
        """Memory used by the sums, bytes."""
        return sum(a.nbytes for a in (self.centroid, self.splat, self.spacing, self.peak))

    def add(self, points: ArrayLike, sigma: ArrayLike, spacing: ArrayLike) -> int:
        """Add the samples of one scan and return how many fell on the grid.

        Parameters
        ----------
        points
            East, north, up (n, 3), m; rows with NaN are ignored.
        sigma
            Standard deviation of each height, scalar or (n,), m.
        spacing
            Distance of neighbouring samples in the scan, scalar or (n,), m.

        Raises
        ------
        InputError
            If points are infinite or beyond 8 km in height, or if a standard deviation or spacing
            is not positive.
        """
        raw = as_real_array("points", points)
        cloud = check_points(raw)
        if not len(cloud):
            return 0
        finite = finite_rows(raw)
        noise, gaps = (
            _check_positive(name, np.broadcast_to(as_real_array(name, values), len(raw))[finite])
            for name, values in (("sigma", sigma), ("spacing", spacing))
        )
        check_heights(cloud)
        base = base_height(cloud) if self.base is None else self.base
        g = self.grid
        call_weight = np.zeros(g.shape)
        count = k.add_points(
            cloud, base, np.maximum(noise, _MIN_SIGMA_M), gaps, (g.x0, g.y0, g.posting),
            self.centroid, self.splat, call_weight, self.spacing, self.peak,
        )  # fmt: skip
        np.maximum(self.splat[..., 0], call_weight, out=self.splat[..., 0])
        # A cloud outside the grid leaves the pool empty.
        self.base = base if call_weight.any() else self.base
        return int(count)

    def offset(self, points: ArrayLike) -> ScanOffset | None:
        """Estimate the offset of new points from the stored samples.

        None if fewer than 30 new points are in cells with stored samples.

        Parameters
        ----------
        points
            East, north, up (n, 3), m; rows with NaN are ignored.
        """
        if self.base is None:
            return None
        with np.errstate(divide="ignore", invalid="ignore"):
            stored = self.base + self.splat[..., 2] / self.splat[..., 1]
        return scan_offset(stored, self.grid, points)

    def shifted(self, by: Array) -> SamplePool:
        """Return the same samples and grid shifted by (3,), m; arrays are not copied."""
        out = SamplePool(self.grid.moved(by))
        out.base = None if self.base is None else self.base + float(by[2])
        out.centroid, out.splat = self.centroid, self.splat
        out.spacing, out.peak = self.spacing, self.peak
        return out

    def about(self, centre: ArrayLike) -> SamplePool:
        """Return the same samples on a grid centred near another point (2,) or (3,), m.

        The grid moves by an integer number of cells and drops samples that leave it. An empty pool
        is centred exactly.
        """
        g = self.grid
        if self.base is None:
            return SamplePool(g.about(centre))
        by = np.asarray(centre, dtype=np.float64)[:2] - g.centre
        east, north = (int(v) for v in np.rint(by / g.posting))
        out = self.on_shifted_grid(g.moved((east * g.posting, north * g.posting)))
        return SamplePool(g.about(centre)) if out.base is None else out

    def on_shifted_grid(self, grid: Grid) -> SamplePool:
        """Return the same samples on `grid`, shifted by an integer number of cells.

        Samples off the new grid are dropped.
        """
        out, g = SamplePool(grid), self.grid
        by = np.rint((np.asarray(grid.centre) - g.centre) / g.posting)
        rows, from_rows = _overlap(g.rows, int(by[1]))
        cols, from_cols = _overlap(g.cols, int(by[0]))
        for name in ("centroid", "splat", "spacing", "peak"):
            getattr(out, name)[rows, cols] = getattr(self, name)[from_rows, from_cols]
        out.base = self.base if out.splat[..., 1].any() else None
        return out

    def rotated(self, turn: ArrayLike, pivot: ArrayLike) -> SamplePool:
        """Return the samples rotated about a point, without those that leave the grid.

        The mean point of each cell is rotated. This is exact except for samples that would move to
        another cell than their mean. The splatted sums of a cell move by an integer number of cells
        with the point above its centre.

        Parameters
        ----------
        turn, pivot
            Rotation matrix (3, 3) and the point (3,) about which the samples are rotated, m.

        Raises
        ------
        InputError
            If `turn` is not a rotation or `pivot` is not a point.
        """
        r, c = np.asarray(turn, np.float64), np.asarray(pivot, np.float64)
        if not (r.shape == (3, 3) and np.allclose(r @ r.T, np.eye(3), atol=1e-6)):
            raise InputError("turn", turn, "must be a rotation matrix (3, 3)")
        check_shape("pivot", c, (3,))
        check_finite("pivot", c)
        out = SamplePool(self.grid)
        if self.base is None:
            return out
        out.base = self.base
        points, _, spacing = self.vertices()
        rows, cols = np.nonzero(self.centroid[..., 0])
        new = rotate_about(points, r, c)
        at, keep = _cells(self.grid, new)
        weight = self.centroid[rows, cols, 0][keep]
        away = new[keep] - np.column_stack(
            (self.grid.centre_of(*at), np.full(len(weight), out.base))
        )
        moved = weight[:, None] * np.column_stack((np.ones(len(weight)), away))
        np.add.at(out.centroid, at, moved)
        np.minimum.at(out.spacing, at, spacing[keep].astype(np.float32))
        raised = (self.peak[rows, cols] + new[:, 2] - points[:, 2])[keep]
        np.maximum.at(out.peak, at, raised)
        rows, cols = np.nonzero(self.splat[..., 1])
        splat = self.splat[rows, cols]
        above = out.base + splat[:, 2] / splat[:, 1]
        old = np.column_stack((self.grid.centre_of(rows, cols), above))
        new = rotate_about(old, r, c)
        at, keep = _cells(self.grid, new)
        splat[:, 2] += splat[:, 1] * (new[:, 2] - old[:, 2])
        np.add.at(out.splat[..., 1:], at, splat[keep, 1:])
        np.maximum.at(out.splat[..., 0], at, splat[keep, 0])
        out.base = self.base if out.splat[..., 1].any() else None
        return out

    def union(self, other: SamplePool) -> SamplePool:
        """Return a pool with the samples of this pool and of another on the same grid."""
        if other.base is None or self.base is None:
            return self if other.base is None else other
        out = SamplePool(self.grid)
        out.base = self.base
        base_offset = other.base - self.base
        out.centroid = self.centroid + other.centroid
        out.centroid[..., 3] += base_offset * other.centroid[..., 0]
        out.splat = self.splat + other.splat
        out.splat[..., 2] += base_offset * other.splat[..., 1]
        out.splat[..., 0] = np.maximum(self.splat[..., 0], other.splat[..., 0])
        out.spacing = np.minimum(self.spacing, other.spacing)
        out.peak = np.maximum(self.peak, other.peak + base_offset)
        return out

    def vertices(self) -> tuple[Array, Array, Array]:
        """Return the mean sample of each occupied cell with its variance and spacing.

        Mean points (n, 3), m, their height variances (n,), m^2, and the minimum spacing of the
        samples (n,), m.
        """
        rows, cols = np.nonzero(self.centroid[..., 0])
        total = self.centroid[rows, cols]
        mean = total[:, 1:] / total[:, :1]
        mean[:, :2] += self.grid.centre_of(rows, cols)
        mean[:, 2] += self.base or 0.0
        return mean, 1.0 / total[:, 0], self.spacing[rows, cols].astype(np.float64)


def _cells(grid: Grid, points: Array) -> tuple[tuple[IntArray, IntArray], BoolArray]:
    """Return rows and columns of the points (n, 3) that are on a grid.

    The second result (n,) is True for these points.
    """
    keep = np.asarray(grid.contains(points[:, :2]))
    row, col = grid.cell(points[keep, :2])
    return (np.asarray(row), np.asarray(col)), keep


def _overlap(count: int, shift: int) -> tuple[slice, slice]:
    """Return the slices of a shifted axis and of the original axis that overlap.

    The axis has `count` cells; `shift` is in cells.
    """
    kept = max(count - abs(shift), 0)
    return slice(max(-shift, 0), max(-shift, 0) + kept), slice(max(shift, 0), max(shift, 0) + kept)


def _check_positive(name: str, values: Array) -> Array:
    """Return `values` as float64; raise InputError for `name` if one is not positive."""
    out = np.ascontiguousarray(values, dtype=np.float64)
    is_invalid = ~((out > 0.0) & (out <= _MAX_LENGTH_M))
    if is_invalid.any():
        problem = f"must be positive and at most {_MAX_LENGTH_M:g} m"
        raise InputError(name, float(out[is_invalid][0]), problem)
    return out
