"""A scan fitted to a map by least squares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.fit_start import fit_start
from lunarsim.onboard.navigation.map_features import MapFeatures
from lunarsim.onboard.navigation.surface import Surface, surface_of

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


# A scan's place is certain where so many deviations lie within half a post, or else with such a
# probability.
_DEVIATIONS, _CERTAIN = 3.5, 0.9995
# Posts along a side of the blocks over which residuals are summed; fewer blocks tell nothing.
_BLOCK, _FEWEST_BLOCKS = 6, 4


class Scanned(Protocol):
    """A scan, or several gathered into one."""

    def points(self, position: Array, attitude: Array) -> Array:
        """Return points (n, 3) in ENU for a pose, NaN for none."""
        ...


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
        Mean square of the residuals used, in units of the variance that they are judged by.
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
    single: Array | None = None,
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
    single
        Variance of the residuals (m,) by which they are judged, where they are weighed by more
        because they were used before; left out: `variance`.
    """
    single = variance if single is None else single
    d = jacobian.shape[1]
    if len(residual) == 0:
        return Fit(np.zeros((d, d)), np.zeros(d), 0, 0, np.nan)
    keep = np.ones(len(residual), np.bool_)
    # The first fit rests on the bulk: a patch that has changed would pull a plain mean along.
    middle = np.median(residual)
    spread = 1.4826 * np.median(np.abs(residual - middle))
    if spread > 0.0:
        keep = np.abs(residual - middle) <= gate * max(spread, float(np.sqrt(single.min())))
    for _ in range(4):
        j, w = jacobian[keep], 1.0 / variance[keep]
        information = (j * w[:, None]).T @ j
        vector = (j * w[:, None]).T @ residual[keep]
        # The prior may be singular: two scans at nearly the same place err alike.
        error = prior @ np.linalg.solve(np.eye(d) + information @ prior, vector)
        after = residual - jacobian @ error
        agree = after**2 <= gate**2 * single
        if np.array_equal(agree, keep):
            break
        keep = agree
    used = int(keep.sum())
    misfit = float(np.mean(after[keep] ** 2 / single[keep])) if used else np.nan
    j, w = jacobian[keep], 1.0 / variance[keep]
    return Fit(
        (j * w[:, None]).T @ j, (j * w[:, None]).T @ residual[keep], used, len(residual), misfit
    )


def point_jacobian(point: Array, position: Array, attitude: Array) -> Array:
    """Return how a point (3,) seen from a pose moves with the pose's error (3, 6).

    Columns: position (ENU) and small rotation (body axes).
    """
    rotation = quat_to_matrix(attitude)
    x, y, z = point - position
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.hstack((np.eye(3), -cross @ rotation))


def pose_jacobian(points: Array, normals: Array, position: Array, attitude: Array) -> Array:
    """Return how the height of a scanned surface over fixed places moves with the pose's error.

    Parameters
    ----------
    points, normals
        On the surface (m, 3), and (-dz/dx, -dz/dy, 1) there (m, 3), ENU.
    position, attitude
        Of the lander.

    Returns
    -------
    jacobian
        (m, 6); columns: position (ENU) and small rotation (body axes).
    """
    turn = np.cross(points - position, normals) @ quat_to_matrix(attitude)
    return np.hstack((normals, turn))


def _on_known_ground(surface: Surface, prior: PriorMap) -> NDArray[np.bool_]:
    """Tell which squares of a scan (m,) a map has an elevation for."""
    g, row, col = prior.grid, surface.row, surface.col
    inside = (col >= 0) & (col < g.cols) & (row >= 0) & (row < g.rows)
    inside[inside] = np.isfinite(prior.elevation[row[inside], col[inside]])
    return inside


def register(
    scan: Scanned,
    features: MapFeatures,
    position: Array,
    attitude: Array,
    covariance: Array,
    variance: Array,
    *,
    passes: int = 4,
) -> tuple[Fit, tuple[IntArray, IntArray]]:
    """Fit a scan to a map.

    Gauss-Newton: the scan is averaged afresh at each corrected pose, until the ground moves by less
    than a twentieth of a post. What is returned refers to the pose that was given.

    Parameters
    ----------
    scan, features
        To be compared; the map's.
    position, attitude
        Estimated pose (3,) and (4,).
    covariance
        Of its error (6, 6): position (ENU), small rotation (body axes).
    variance
        Of a residual at each post (rows, cols), m^2: the more the more often it was used.
    passes
        At most.

    Returns
    -------
    fit
        Information on the error of the pose.
    posts
        Rows and columns of the posts compared.
    """
    prior = features.prior
    g = prior.grid
    error, level_only, spread = _begin(scan, features, position, attitude, covariance)
    for _ in range(passes):
        turned = quat_multiply(attitude, quat_from_rotation_vector(error[3:]))
        surface = surface_of(scan.points(position + error[:3], turned), g)
        inside = _on_known_ground(surface, prior)
        posts = surface.row[inside], surface.col[inside]
        normal, added = _normals(surface.normal[inside], spread if level_only else None)
        jacobian = pose_jacobian(surface.position[inside], normal, position + error[:3], turned)
        residual = prior.elevation[posts] - surface.position[inside, 2] + jacobian @ error
        single = features.variance + added
        result = fit(jacobian, residual, variance[posts] + added, covariance, single=single)
        if result.used == 0:
            break
        step = _solved(result, covariance) - error
        error = error + step
        middle = surface.position[inside].mean(axis=0)
        moved = point_jacobian(middle, position, attitude) @ step
        if np.abs(moved).max() < 0.05 * g.posting:
            break
    if result.used:
        many = max(_together(posts, residual - jacobian @ error, single), prior.together)
        result = replace(result, information=result.information / many, vector=result.vector / many)
    return result, posts


def _solved(found: Fit, covariance: Array) -> Array:
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


def _together(posts: tuple[IntArray, IntArray], residual: Array, variance: Array) -> float:
    """Return how many times less residuals tell than if each erred on its own, at least 1.

    By their sums over blocks of a few posts: errors of a map that are alike over some metres, and
    ground that has changed by little, add up there.
    """
    row, col = (part // _BLOCK for part in posts)
    keep = residual**2 <= 9.0 * variance
    block = (row - row.min()) * (int(np.ptp(col)) + 1) + col - col.min()
    total = np.bincount(block[keep], residual[keep])
    expected = np.bincount(block[keep], variance[keep])
    full = expected > 0.0
    if full.sum() < _FEWEST_BLOCKS:
        return 1.0
    return max(1.0, float(np.mean(total[full] ** 2 / expected[full])))


def _begin(
    scan: Scanned,
    features: MapFeatures,
    position: Array,
    attitude: Array,
    covariance: Array,
) -> tuple[Array, bool, Array]:
    """Return where to begin a fit (6,), whether it may tell the level alone, and the spread.

    Slopes tell where a scan lies only as far as they reach, which is half a post on rough ground:
    where the scan's place is less certain, all places that its stated error allows are compared
    first. Where several will do, which one it is must not be told.
    """
    surface = surface_of(scan.points(position, attitude), features.prior.grid)
    error, none = np.zeros(6), np.zeros((2, 2))
    if len(surface) == 0:
        return error, False, none
    middle = surface.position.mean(axis=0)
    across = point_jacobian(middle, position, attitude)[:2]
    place = across @ covariance @ across.T
    if _DEVIATIONS * np.sqrt(np.diag(place).max()) <= 0.5 * features.prior.grid.posting:
        return error, False, none
    start = fit_start(surface, features, place)
    if start.certainty < _CERTAIN:
        return error, True, start.spread
    return covariance @ across.T @ np.linalg.solve(place, start.shift), False, none
