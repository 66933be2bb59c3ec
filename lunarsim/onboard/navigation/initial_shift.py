"""Find the most probable shift of a scan on a map, as the start of a local fit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lunarsim.onboard.navigation.features import subtract_plane
from lunarsim.onboard.navigation.map_features import FeatureTile, MapFeatures
from lunarsim.onboard.navigation.surface import ScanSurface
from lunarsim.typing import Array

# Range of the searched shifts: standard deviations of the position, and maximum in grid points.
_SEARCH_SIGMAS, _MAX_SHIFT_POSTS = 4.0, 60
# Side of the tiles that may have changed independently, and maximum side of a scan, both in grid
# points of the map.
_TILE_POSTS, _MAX_SCAN_POSTS = 12, 600


@dataclass(frozen=True)
class InitialShift:
    """Most probable horizontal shift of a scan on a map, in steps of the grid spacing.

    Attributes
    ----------
    shift
        East and north (2,), m.
    certainty
        Probability of this shift and its direct neighbours.
    spread
        Second moment of all shifts about the most probable one, weighted by their probability (2,
        2), m^2.
    """

    shift: Array
    certainty: float
    spread: Array


def find_initial_shift(
    surface: ScanSurface, features: MapFeatures, covariance: Array
) -> InitialShift:
    """Find the most probable shift of a scan on a map within its position uncertainty.

    All shifts by an integer number of grid points are evaluated by the likelihood of the scanned
    terrain.

    Parameters
    ----------
    surface
        Scan averaged over the squares of the map grid.
    features
        Features of the map.
    covariance
        Covariance of the scan's position, east and north (2, 2), m^2.
    """
    posting = features.prior.grid.posting
    reach = np.ceil(_SEARCH_SIGMAS * np.sqrt(np.diag(covariance)) / posting).astype(int)
    east, north = (np.arange(-n, n + 1) for n in np.clip(reach, 1, _MAX_SHIFT_POSTS))
    across, along = np.meshgrid(east, north)
    x, y = posting * across, posting * along
    inverse = np.linalg.inv(covariance)
    log = -0.5 * (inverse[0, 0] * x**2 + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y**2)
    for row, col, tile in _tiles(surface, features):
        mean_log_ratio = features.mean_log_ratio(tile)
        if mean_log_ratio is not None:
            likelihood = features.likelihood(tile, row + along.ravel(), col + across.ravel())
            log += features.log_factor(*likelihood, mean_log_ratio, log.size).reshape(log.shape)
    p = np.exp(log - log.max())
    p /= p.sum()
    best = int(np.argmax(p))
    shift = np.array([x.flat[best], y.flat[best]])
    is_near = np.maximum(np.abs(x - shift[0]), np.abs(y - shift[1])) <= 1.01 * posting
    offset = np.column_stack((x.ravel(), y.ravel())) - shift
    return InitialShift(
        shift, float(p[is_near].sum()), np.asarray((offset * p.reshape(-1, 1)).T @ offset)
    )


def _tiles(surface: ScanSurface, features: MapFeatures) -> list[tuple[int, int, FeatureTile]]:
    """Divide a scan into tiles for the comparison with a map.

    Each tile is returned after the row and column of its first cell on the map grid. The result is
    empty for a scan that is too large.
    """
    first = (int(surface.row.min()), int(surface.col.min()))
    shape = (int(surface.row.max()) - first[0] + 1, int(surface.col.max()) - first[1] + 1)
    if max(shape) > _MAX_SCAN_POSTS:
        return []
    place = (surface.row - first[0], surface.col - first[1])
    height, known, spread = np.zeros(shape), np.zeros(shape, np.bool_), np.zeros(shape)
    height[place] = surface.position[:, 2]
    known[place] = True
    above, kept = subtract_plane(height, known, features.reach)
    # The true shift can differ from an integer number of grid points by half the spacing.
    slope = surface.normal[:, :2] - surface.normal[:, :2].mean(axis=0)
    spread[place] = (slope**2).sum(axis=1) * features.prior.grid.posting**2 / 12.0
    variance = features.variance + spread
    tile_counts = [max(1, round(n / _TILE_POSTS)) for n in shape]
    rows, cols = (
        np.linspace(0, n, m + 1).astype(int) for n, m in zip(shape, tile_counts, strict=True)
    )
    out = []
    for r0, r1 in pairwise(rows):
        for c0, c1 in pairwise(cols):
            tile_slice = (slice(r0, r1), slice(c0, c1))
            tile = FeatureTile(
                above[tile_slice], kept[tile_slice].astype(np.float64), variance[tile_slice]
            )
            out.append((first[0] + int(r0), first[1] + int(c0), tile))
    return out
