"""A scan fitted to a map by least squares."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.fit_start import fit_start
from lunarsim.onboard.navigation.map_features import MapFeatures
from lunarsim.onboard.navigation.seen_scan import SeenScan
from lunarsim.onboard.navigation.surface import Surface, surface_of

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A scan's place is certain where so many deviations lie within half a post, or else with such a
# probability.
_DEVIATIONS, _CERTAIN = 3.5, 0.9995
# Posts along a side of the blocks over which residuals are summed; fewer blocks tell nothing.
_BLOCK, _FEWEST_BLOCKS = 6, 4


@dataclass(frozen=True)
class Fit:
    """Outcome of a registration, as information on an error state.

    Attributes
    ----------
    information
        J' W J (d, d).
    vector
        J' W y (d,).
    used, offered
        Squares that agree with the map, and all that could be compared.
    misfit
        Mean square of the residuals used, in units of their variance.
    """

    information: Array
    vector: Array
    used: int
    offered: int
    misfit: float

    @property
    def share(self) -> float:
        """Share of the squares that agree."""
        return self.used / self.offered if self.offered else 0.0


def fit(
    jacobian: Array,
    residual: Array,
    variance: Array,
    prior: Array,
    gate: float = 3.0,
    *,
    expected: Array | None = None,
) -> Fit:
    """Fit an error to residuals, leaving out those that no likely error explains.

    Parameters
    ----------
    jacobian, residual, variance
        Of m scalar measurements (m, d), (m,), (m,).
    prior
        Covariance (d, d) of the error before.
    gate
        Residuals farther than so many deviations from the fit are left out.
    expected
        Variance of a residual by which they are judged (m,); left out, `variance`, which may be
        greater because a measurement has been used before. Judged by that, ground that has changed
        would agree once it has been looked at often enough.
    """
    d = jacobian.shape[1]
    if len(residual) == 0:
        return Fit(np.zeros((d, d)), np.zeros(d), 0, 0, np.nan)
    judged = variance if expected is None else expected
    keep = np.ones(len(residual), np.bool_)
    # The first fit rests on the bulk: a patch that has changed would pull a plain mean along.
    middle = np.median(residual)
    spread = 1.4826 * np.median(np.abs(residual - middle))
    if spread > 0.0:
        keep = np.abs(residual - middle) <= gate * max(spread, float(np.sqrt(judged.min())))
    for _ in range(4):
        j, w = jacobian[keep], 1.0 / variance[keep]
        information = (j * w[:, None]).T @ j
        vector = (j * w[:, None]).T @ residual[keep]
        # The prior may be singular: two scans at nearly the same place err alike.
        error = prior @ np.linalg.solve(np.eye(d) + information @ prior, vector)
        after = residual - jacobian @ error
        agree = after**2 <= gate**2 * judged
        if np.array_equal(agree, keep):
            break
        keep = agree
    used = int(keep.sum())
    misfit = float(np.mean(after[keep] ** 2 / judged[keep])) if used else np.nan
    j, w = jacobian[keep], 1.0 / variance[keep]
    return Fit(
        (j * w[:, None]).T @ j, (j * w[:, None]).T @ residual[keep], used, len(residual), misfit
    )


def _on_known_ground(surface: Surface, prior: PriorMap) -> NDArray[np.bool_]:
    """Tell which squares of a scan (m,) a map has an elevation for."""
    g, row, col = prior.grid, surface.row, surface.col
    inside = (col >= 0) & (col < g.cols) & (row >= 0) & (row < g.rows)
    inside[inside] = np.isfinite(prior.elevation[row[inside], col[inside]])
    return inside


def register(
    seen: SeenScan,
    features: MapFeatures,
    covariance: Array,
    variance: Array,
    *,
    passes: int = 4,
) -> tuple[Fit, tuple[IntArray, IntArray]]:
    """Fit a scan to a map.

    Gauss-Newton: the scan is averaged afresh with each correction, until the ground moves by less
    than a twentieth of a post. What is returned refers to the scan as it was given.

    Parameters
    ----------
    seen, features
        To be compared: the scan in the frame of the map, and the map's features.
    covariance
        Of the scan's errors (11, 11): see `SeenScan`.
    variance
        Of a residual at each post (rows, cols), m^2, greater the more often it has been used.
    passes
        At most.

    Returns
    -------
    fit
        Information on the scan's errors.
    posts
        Rows and columns of the posts compared.
    """
    prior = features.prior
    error, level_only, spread = _begin(seen, features, covariance)
    for _ in range(passes):
        moved = seen.moved(error)
        surface = surface_of(moved.points(), prior.grid)
        inside = _on_known_ground(surface, prior)
        posts = surface.row[inside], surface.col[inside]
        normal, added = _normals(surface.normal[inside], spread if level_only else None)
        jacobian = moved.jacobian(surface.position[inside], normal)
        residual = prior.elevation[posts] - surface.position[inside, 2] + jacobian @ error
        expected = features.variance + added
        result = fit(jacobian, residual, variance[posts] + added, covariance, expected=expected)
        if result.used == 0:
            break
        step = solved(result, covariance) - error
        error = error + step
        middle = surface.position[inside].mean(axis=0)
        if np.abs(moved.point_jacobian(middle) @ step).max() < 0.05 * prior.grid.posting:
            break
    if result.used:
        alike = together(posts, residual - jacobian @ error, expected)
        share = max(alike, prior.together, 1.0)
        result = replace(
            result, information=result.information / share, vector=result.vector / share
        )
    return result, posts


def solved(found: Fit, covariance: Array) -> Array:
    """Return the error that a fit and the covariance before make likeliest (d,)."""
    both = np.eye(len(covariance)) + found.information @ covariance
    return np.asarray(covariance @ np.linalg.solve(both, found.vector))


def _normals(normal: Array, spread: Array | None) -> tuple[Array, Array]:
    """Return the normals (m, 3) that a fit uses, and what is added to the variances (m,), m^2.

    With a `spread` (2, 2) the place is not to be told: the slope of the whole, the same for all,
    ties the level to the place, and slopes that differ from it are errors.
    """
    if spread is None or len(normal) == 0:
        return normal, np.zeros(len(normal))
    slope = normal[:, :2] - normal[:, :2].mean(axis=0)
    added = np.asarray(np.einsum("ni,ij,nj->n", slope, spread, slope))
    return np.broadcast_to(normal.mean(axis=0), normal.shape), added


def together(posts: tuple[IntArray, IntArray], residual: Array, variance: Array) -> float:
    """Return how many times less residuals tell than if each erred on its own.

    By their sums over blocks of a few posts: errors of a map that are alike over some metres, and
    ground that has changed by little, add up there. 1 with too few blocks to tell.
    """
    row, col = (part // _BLOCK for part in posts)
    keep = residual**2 <= 9.0 * variance
    block = (row - row.min()) * (int(np.ptp(col)) + 1) + col - col.min()
    total = np.bincount(block[keep], residual[keep])
    expected = np.bincount(block[keep], variance[keep])
    full = expected > 0.0
    if full.sum() < _FEWEST_BLOCKS:
        return 1.0
    return float(np.mean(total[full] ** 2 / expected[full]))


def _begin(seen: SeenScan, features: MapFeatures, covariance: Array) -> tuple[Array, bool, Array]:
    """Return where to begin a fit (11,), whether it may tell the level alone, and the spread.

    Slopes tell where a scan lies only as far as they reach, which is half a post on rough ground:
    where the scan's place is less certain, all places that its stated error allows are compared
    first. Where several will do, which one it is must not be told.
    """
    surface = seen.surface(features.prior.grid)
    error, none = np.zeros(len(covariance)), np.zeros((2, 2))
    if len(surface) == 0:
        return error, False, none
    across = seen.point_jacobian(surface.position.mean(axis=0))[:2]
    place = across @ covariance @ across.T
    if _DEVIATIONS * np.sqrt(np.diag(place).max()) <= 0.5 * features.prior.grid.posting:
        return error, False, none
    start = fit_start(surface, features, place)
    if start.certainty < _CERTAIN:
        return error, True, start.spread
    return covariance @ across.T @ np.linalg.solve(place, start.shift), False, none
