"""Register a scan on a map by robust least squares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.corrected_scan import CorrectedScan, ScanSurface, average_scan
from lunarsim.onboard.navigation.map_features import FeatureTile, MapFeatures, subtract_plane
from lunarsim.typing import Array, BoolArray, IntArray

# Minimum number of grid squares with scan heights, minimum fraction of them that agree, and maximum
# mean square of their residuals over the variance.
MIN_SQUARES, MIN_AGREEING_FRACTION, _MAX_MISFIT = 12, 0.7, 1.6
# Probability to reject a valid correction from a reference scan or a search.
REJECTION_PROBABILITY = 4e-5
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
    for row, col, tile in _divide_into_tiles(surface, features):
        mean_log_ratio = features.mean_log_ratio(tile)
        if mean_log_ratio is not None:
            likelihood = features.log_likelihood_ratios(
                tile, row + along.ravel(), col + across.ravel()
            )
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


def _divide_into_tiles(
    surface: ScanSurface, features: MapFeatures
) -> list[tuple[int, int, FeatureTile]]:
    """Divide a scan into tiles for the comparison with a map.

    Each element of the list is a tile and its place: row and column of the tile's first cell on
    the map grid, and the tile. The list is empty if the scan is larger than 600 grid points along
    a side.
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


# The scan position is unambiguous if this number of standard deviations is below half the grid
# spacing of the map, or if the best shift has this probability.
_UNAMBIGUOUS_SIGMAS, _MIN_CERTAINTY = 3.5, 0.9995
# Side of the blocks for the correlation of residuals, in grid points; minimum number of blocks.
_BLOCK_POSTS, _MIN_BLOCKS = 6, 4


@dataclass(frozen=True)
class MapFit:
    """Result of a registration, as information on the errors of the scan.

    Attributes
    ----------
    information
        Information matrix J' W J (d, d), with Jacobian J and inverse variances W.
    vector
        Information vector J' W y (d,), with residuals y.
    used, compared
        Number of squares that agree with the map, and of all compared squares.
    misfit
        Mean square of the residuals of agreeing squares, in units of their variance.
    """

    information: Array
    vector: Array
    used: int
    compared: int
    misfit: float

    @property
    def agreeing_fraction(self) -> float:
        """Fraction of the compared squares that agree with the map."""
        return self.used / self.compared if self.compared else 0.0


def fit_residuals(
    jacobian: Array,
    residual: Array,
    variance: Array,
    prior: Array,
    gate: float = 3.0,
    *,
    outlier_variance: Array | None = None,
) -> MapFit:
    """Return the information on errors in height residuals without outliers.

    The result does not contain the prior; `solve_error` combines both to the estimate.

    Parameters
    ----------
    jacobian, residual, variance
        Jacobian, residuals and variances of n scalar measurements (n, d), (n,), (n,).
    prior
        Prior covariance of the errors (d, d), used only to find outliers.
    gate
        Maximum residual after the fit, in standard deviations; larger ones are outliers.
    outlier_variance
        Variances for the outlier test (n,); default: `variance`. If `variance` is increased for
        measurements that were used before, these are the variances without the increase; otherwise
        the test would accept changed terrain.
    """
    d = jacobian.shape[1]
    if len(residual) == 0:
        return MapFit(np.zeros((d, d)), np.zeros(d), 0, 0, np.nan)
    test_variance = variance if outlier_variance is None else outlier_variance
    keep = np.ones(len(residual), np.bool_)
    # Start without the outliers from the median: a changed patch would bias a plain mean.
    middle = np.median(residual)
    spread = 1.4826 * np.median(np.abs(residual - middle))
    if spread > 0.0:
        keep = np.abs(residual - middle) <= gate * max(spread, float(np.sqrt(test_variance.min())))
    for _ in range(4):
        j, w = jacobian[keep], 1.0 / variance[keep]
        information = (j * w[:, None]).T @ j
        vector = (j * w[:, None]).T @ residual[keep]
        # The prior can be singular: errors of two scans from nearly the same place are equal.
        error = prior @ np.linalg.solve(np.eye(d) + information @ prior, vector)
        residual_after = residual - jacobian @ error
        is_agreeing = residual_after**2 <= gate**2 * test_variance
        if np.array_equal(is_agreeing, keep):
            break
        keep = is_agreeing
    used = int(keep.sum())
    misfit = float(np.mean(residual_after[keep] ** 2 / test_variance[keep])) if used else np.nan
    j, w = jacobian[keep], 1.0 / variance[keep]
    return MapFit(
        (j * w[:, None]).T @ j, (j * w[:, None]).T @ residual[keep], used, len(residual), misfit
    )


def _is_on_map(surface: ScanSurface, prior: PriorMap) -> BoolArray:
    """Return which grid squares of a scan have a known height on a map (n,).

    Squares outside the map have none.
    """
    g, row, col = prior.grid, surface.row, surface.col
    inside = (col >= 0) & (col < g.cols) & (row >= 0) & (row < g.rows)
    inside[inside] = np.isfinite(prior.elevation[row[inside], col[inside]])
    return inside


def register_scan(
    corrected: CorrectedScan,
    features: MapFeatures,
    covariance: Array,
    variance: Array,
    *,
    passes: int = 4,
) -> tuple[MapFit, tuple[IntArray, IntArray]]:
    """Register a scan on a prior map by Gauss-Newton least squares.

    If the position of the scan is uncertain, the fit starts at its most probable horizontal shift;
    if several shifts are plausible, only heights are fitted. After each correction, the scan is
    averaged over the map grid again, until the terrain moves by less than 1/20 of the grid spacing.
    The information is reduced by the correlation of the residuals. It refers to the errors of
    `corrected`, not of the updated scan. If no grid point agrees, `used` of the fit is 0.

    Parameters
    ----------
    corrected, features
        Scan in the frame of the map, and the features of the map.
    covariance
        Prior covariance of the scan's errors (11, 11), in the order of `CorrectedScan`.
    variance
        Variance of the residual at each map grid point (rows, cols), m^2; it grows with the number
        of uses.
    passes
        Maximum number of iterations.

    Returns
    -------
    fit
        Information on the scan's errors.
    posts
        Rows and columns of the compared grid points.
    """
    prior = features.prior
    error, level_only, spread = _initial_error(corrected, features, covariance)
    for _ in range(passes):
        updated = corrected.corrected_by(error)
        surface = average_scan(updated.points(), prior.grid)
        inside = _is_on_map(surface, prior)
        posts = surface.row[inside], surface.col[inside]
        normal, added = _fit_normals(surface.normal[inside], spread if level_only else None)
        jacobian = updated.jacobian(surface.position[inside], normal)
        residual = prior.elevation[posts] - surface.position[inside, 2] + jacobian @ error
        expected = features.variance + added
        result = fit_residuals(
            jacobian, residual, variance[posts] + added, covariance, outlier_variance=expected
        )
        if result.used == 0:
            break
        step = solve_error(result, covariance) - error
        error = error + step
        middle = surface.position[inside].mean(axis=0)
        if np.abs(updated.point_jacobian(middle) @ step).max() < 0.05 * prior.grid.posting:
            break
    if result.used:
        correlation = residual_correlation(posts, residual - jacobian @ error, expected)
        share = max(correlation, prior.equivalent_correlated_posts, 1.0)
        result = replace(
            result, information=result.information / share, vector=result.vector / share
        )
    return result, posts


def solve_error(map_fit: MapFit, covariance: Array) -> Array:
    """Return the maximum a posteriori error (d,) of a fit, given a prior covariance.

    `map_fit` is the result of the fit; `covariance` (d, d) is that of the prior with mean zero.
    """
    both = np.eye(len(covariance)) + map_fit.information @ covariance
    return np.asarray(covariance @ np.linalg.solve(both, map_fit.vector))


def _fit_normals(normals: Array, position_covariance: Array | None) -> tuple[Array, Array]:
    """Return terrain normals (n, 3) for a fit, and added residual variances (n,), m^2.

    `position_covariance` (2, 2), m^2, is that of a horizontal position that the fit must not
    determine. All normals are then replaced by their mean, and the deviation of each slope adds
    variance. With None, the normals are returned unchanged.
    """
    if position_covariance is None or len(normals) == 0:
        return normals, np.zeros(len(normals))
    slope = normals[:, :2] - normals[:, :2].mean(axis=0)
    added = np.asarray(np.einsum("ni,ij,nj->n", slope, position_covariance, slope))
    return np.broadcast_to(normals.mean(axis=0), normals.shape), added


def residual_correlation(
    grid_points: tuple[IntArray, IntArray], residual: Array, variance: Array
) -> float:
    """Return the variance inflation that accounts for the correlation of residuals.

    Sums of residuals over blocks of a few grid points are compared with their variance for
    independent residuals. Map errors with a correlation length of some metres and small terrain
    changes add up in these sums. The result is 1 if there are too few blocks. `grid_points` are
    rows and columns (n,) of the residuals (n,), m, with variances (n,), m^2.
    """
    row, col = (part // _BLOCK_POSTS for part in grid_points)
    keep = residual**2 <= 9.0 * variance
    block = (row - row.min()) * (int(np.ptp(col)) + 1) + col - col.min()
    total = np.bincount(block[keep], residual[keep])
    expected = np.bincount(block[keep], variance[keep])
    full = expected > 0.0
    if full.sum() < _MIN_BLOCKS:
        return 1.0
    return float(np.mean(total[full] ** 2 / expected[full]))


def _initial_error(
    corrected: CorrectedScan, features: MapFeatures, covariance: Array
) -> tuple[Array, bool, Array]:
    """Choose the start of a fit: the initial error, and whether to fit heights only.

    Slopes give the correct position only within half the grid spacing on rough terrain. If the
    position of the scan is less certain, all shifts that its uncertainty allows are compared first.
    If several shifts are plausible, the fit must not choose between them and determines only
    heights. The results are the initial error (11,), whether to fit heights only, and the second
    moment (2, 2), m^2, of the shift about the most probable one. `covariance` (11, 11) is the prior
    covariance of the scan's errors.
    """
    surface = corrected.surface(features.prior.grid)
    error, none = np.zeros(len(covariance)), np.zeros((2, 2))
    if len(surface) == 0:
        return error, False, none
    horizontal_jacobian = corrected.point_jacobian(surface.position.mean(axis=0))[:2]
    position_covariance = horizontal_jacobian @ covariance @ horizontal_jacobian.T
    if (
        _UNAMBIGUOUS_SIGMAS * np.sqrt(np.diag(position_covariance).max())
        <= 0.5 * features.prior.grid.posting
    ):
        return error, False, none
    start = find_initial_shift(surface, features, position_covariance)
    if start.certainty < _MIN_CERTAINTY:
        return error, True, start.spread
    return (
        covariance @ horizontal_jacobian.T @ np.linalg.solve(position_covariance, start.shift),
        False,
        none,
    )


def is_good_fit(fit: MapFit) -> bool:
    """Return whether enough grid squares agree in a fit, with small residuals.

    At least 12 squares and 70 % of the compared ones must agree, and the mean square of their
    residuals must be at most 1.6 times the variance.
    """
    return (
        fit.used >= MIN_SQUARES
        and fit.agreeing_fraction >= MIN_AGREEING_FRACTION
        and fit.misfit <= _MAX_MISFIT
    )
