"""All returns of a descent, thinned to the cells of a map.

Maps of single scans cannot be averaged as if their errors were independent: scans from one place
look between the same points, so that their interpolation errors are the same. What is kept here
are the samples themselves; the map is interpolated once, between all of them. Noise then averages
where cells were measured again, and interpolation errors shrink only where new points fall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import _sample_kernels as k
from lunarsim.onboard.hazards.gaussian_dem.conventional import (
    base_height,
    check_heights,
    check_points,
    finite_rows,
)

Array = NDArray[np.float64]

# Ranges are not known better than this, whatever a sensor says.
_LEAST_SIGMA = 1e-4


class SamplePool:
    """Sums of the samples of each cell of a grid; memory does not grow with the scans.

    Parameters
    ----------
    grid
        The cells.

    Attributes
    ----------
    base
        Height from which heights are counted, m; None before the first sample.
    centroid
        Sums of precision, and of precision times east, north (from the cell's centre) and height
        (above `base`), of the samples that fell into each cell (rows, cols, 4).
    splat
        Of the samples about each cell (rows, cols, 4): the greatest sum of bilinear weights (Eq. 1)
        that one call of `add` gave it, and the sums of all weights over the variance, of height
        times these, and of squared weights over the variance. A far corner that is hit again and
        again does not make a cell measured.
    spacing
        Least distance of neighbouring samples, as their scans had them (rows, cols), m; inf for
        none.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.base: float | None = None
        self.centroid = np.zeros((*grid.shape, 4))
        self.splat = np.zeros((*grid.shape, 4))
        self.spacing = np.full(grid.shape, np.inf, np.float32)

    @property
    def nbytes(self) -> int:
        """Memory of the sums."""
        return self.centroid.nbytes + self.splat.nbytes + self.spacing.nbytes

    def add(self, points: ArrayLike, sigma: ArrayLike, spacing: ArrayLike) -> int:
        """Take in samples; return how many fell on the grid.

        Parameters
        ----------
        points
            East, north, up (n, 3), m; rows with NaN are left out.
        sigma
            Standard deviation of each height, one or (n,), m.
        spacing
            Distance to the neighbouring samples of its scan, one or (n,), m.

        Raises
        ------
        InputError
            If points are infinite or more than 8 km up or down, or a deviation or
            spacing is not positive.
        """
        raw = np.asarray(points, dtype=np.float64)
        try:
            cloud = check_points(raw)
        except ValueError as error:
            raise InputError("points", raw.shape, str(error)) from None
        if not len(cloud):
            return 0
        finite = finite_rows(raw)
        noise, apart = (
            _positive(name, np.broadcast_to(values, len(raw))[finite])
            for name, values in (("sigma", sigma), ("spacing", spacing))
        )
        check_heights(cloud)
        if self.base is None:
            self.base = base_height(cloud)
        g = self.grid
        own = np.zeros(g.shape)
        count = k.pool(
            cloud, self.base, np.maximum(noise, _LEAST_SIGMA), apart, (g.x0, g.y0, g.posting),
            self.centroid, self.splat, own, self.spacing,
        )  # fmt: skip
        np.maximum(self.splat[..., 0], own, out=self.splat[..., 0])
        return int(count)

    def about(self, centre: ArrayLike) -> SamplePool:
        """Return the same samples on a grid about another point (2,) or (3,), m.

        It moves by whole cells, and those that leave it are dropped; without samples, exactly.
        """
        g = self.grid
        if self.base is None:
            return SamplePool(g.about(centre))
        by = np.asarray(centre, dtype=np.float64)[:2] - g.centre
        east, north = (int(v) for v in np.rint(by / g.posting))
        out = SamplePool(g.moved((east * g.posting, north * g.posting)))
        out.base = self.base
        rows, from_rows = _overlap(g.rows, north)
        cols, from_cols = _overlap(g.cols, east)
        for name in ("centroid", "splat", "spacing"):
            getattr(out, name)[rows, cols] = getattr(self, name)[from_rows, from_cols]
        return out if out.centroid[..., 0].any() else SamplePool(g.about(centre))

    def vertices(self) -> tuple[Array, Array, Array]:
        """Return a point a cell (n, 3) with variance (n,), m^2, and spacing (n,)."""
        rows, cols = np.nonzero(self.centroid[..., 0])
        total = self.centroid[rows, cols]
        mean = total[:, 1:] / total[:, :1]
        mean[:, :2] += self.grid.centre_of(rows, cols)
        mean[:, 2] += self.base or 0.0
        return mean, 1.0 / total[:, 0], self.spacing[rows, cols].astype(np.float64)


def _overlap(count: int, by: int) -> tuple[slice, slice]:
    """Return which of a number of cells, moved by some, lie on which of them before."""
    kept = max(count - abs(by), 0)
    return slice(max(-by, 0), max(-by, 0) + kept), slice(max(by, 0), max(by, 0) + kept)


def _positive(name: str, values: Array) -> Array:
    out = np.ascontiguousarray(values, dtype=np.float64)
    if not (np.isfinite(out).all() and (out > 0.0).all()):
        raise InputError(name, float(out[~(out > 0.0)][0]) if (~(out > 0.0)).any() else "inf",
                         "positive lengths in metres")  # fmt: skip
    return out
