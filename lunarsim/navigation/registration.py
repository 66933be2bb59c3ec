"""Where a scan lies on a map: fine registration by least squares, coarse search by correlation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.signal import correlate

from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.grid import Grid
from lunarsim.navigation import _registration_kernels as k
from lunarsim.navigation.prior_map import PriorMap
from lunarsim.sensors.lidar import LidarScan

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Surface:
    """A scan averaged over the squares of a grid, at their middles.

    Attributes
    ----------
    col, row
        Of the squares (m,); may lie beyond the grid.
    position
        Middles of the squares at the scan's height there (m, 3), ENU, m.
    normal
        (-dz/dx, -dz/dy, 1) of the scan (m, 3). It comes from the scan, not from the map, whose
        noise would look like slope and make flat ground seem to tell where it is.
    """

    col: IntArray
    row: IntArray
    position: Array
    normal: Array

    def __len__(self) -> int:
        return len(self.col)


def surface_of(points: Array, grid: Grid, least: int = 4) -> Surface:
    """Average points (n, 3), NaN for none, over the squares of a grid."""
    col, row, mean, _ = k.average(
        np.ascontiguousarray(points), grid.x0, grid.y0, grid.posting, least
    )
    height, slope, good = k.surface(
        col, row, mean, grid.x0, grid.y0, grid.posting, 0.25 * grid.posting
    )
    col, row, height, slope = col[good], row[good], height[good], slope[good]
    position = np.stack(
        (grid.x0 + grid.posting * col, grid.y0 + grid.posting * row, height), axis=-1
    )
    return Surface(col, row, position, np.column_stack((-slope, np.ones(len(col)))))


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


def fit(jacobian: Array, residual: Array, variance: Array, prior: Array, gate: float = 3.0) -> Fit:
    """Fit an error to residuals, leaving out those that no likely error explains.

    Parameters
    ----------
    jacobian, residual, variance
        Of m scalar measurements (m, d), (m,), (m,).
    prior
        Covariance (d, d) of the error before.
    gate
        Residuals farther than so many deviations from the fit are left out.
    """
    d = jacobian.shape[1]
    if len(residual) == 0:
        return Fit(np.zeros((d, d)), np.zeros(d), 0, 0, np.nan)
    keep = np.ones(len(residual), np.bool_)
    # The first fit rests on the bulk: a patch that has changed would pull a plain mean along.
    middle = np.median(residual)
    spread = 1.4826 * np.median(np.abs(residual - middle))
    if spread > 0.0:
        keep = np.abs(residual - middle) <= gate * max(spread, float(np.sqrt(variance.min())))
    for _ in range(4):
        j, w = jacobian[keep], 1.0 / variance[keep]
        information = (j * w[:, None]).T @ j
        vector = (j * w[:, None]).T @ residual[keep]
        # The prior may be singular: two scans at nearly the same place err alike.
        error = prior @ np.linalg.solve(np.eye(d) + information @ prior, vector)
        after = residual - jacobian @ error
        agree = after**2 <= gate**2 * variance
        if np.array_equal(agree, keep):
            break
        keep = agree
    used = int(keep.sum())
    misfit = float(np.mean(after[keep] ** 2 / variance[keep])) if used else np.nan
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


def register(
    scan: LidarScan,
    prior: PriorMap,
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
    scan, prior
        To be compared.
    position, attitude
        Estimated pose (3,) and (4,).
    covariance
        Of its error (6, 6): position (ENU), small rotation (body axes).
    variance
        Of a residual at each post (rows, cols), m^2.
    passes
        At most.

    Returns
    -------
    fit
        Information on the error of the pose.
    posts
        Rows and columns of the posts compared.
    """
    g = prior.grid
    error = np.zeros(6)
    for _ in range(passes):
        turned = quat_multiply(attitude, quat_from_rotation_vector(error[3:]))
        surface = surface_of(scan.points(position + error[:3], turned), g)
        inside = (
            (surface.col >= 0)
            & (surface.col < g.cols)
            & (surface.row >= 0)
            & (surface.row < g.rows)
        )
        inside[inside] = np.isfinite(prior.elevation[surface.row[inside], surface.col[inside]])
        posts = surface.row[inside], surface.col[inside]
        jacobian = pose_jacobian(
            surface.position[inside], surface.normal[inside], position + error[:3], turned
        )
        residual = prior.elevation[posts] - surface.position[inside, 2] + jacobian @ error
        result = fit(jacobian, residual, variance[posts], covariance)
        if result.used == 0:
            break
        step = (
            covariance @ np.linalg.solve(np.eye(6) + result.information @ covariance, result.vector)
            - error
        )
        error = error + step
        middle = surface.position[inside].mean(axis=0)
        moved = point_jacobian(middle, position, attitude) @ step
        if np.abs(moved).max() < 0.05 * g.posting:
            break
    return result, posts


@dataclass(frozen=True)
class Match:
    """Where the correlation search finds a patch.

    Attributes
    ----------
    shift
        To be added to the patch (3,), ENU, m.
    covariance
        Of the shift (3, 3), m^2.
    certainty
        Probability that the patch lies within one and a half posts of there.
    share
        Of the posts that agree there.
    up, up_variance
        Mean and variance of the vertical shift over all places, by their probability, m and m^2: on
        level ground the height is known before the place.
    """

    shift: Array
    covariance: Array
    certainty: float
    share: float
    up: float
    up_variance: float


def high_pass(
    height: Array, known: NDArray[np.bool_], reach: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Return heights less their mean over a square of 2 `reach` + 1, and where all of it is known.

    What is left are features; swells and the tilt of a wrong attitude are gone.
    """
    side = 2 * reach + 1
    full = ndimage.uniform_filter(known.astype(np.float64), side, mode="constant") > 1.0 - 1e-9
    filled = np.where(known, height, 0.0)
    return np.where(full, filled - ndimage.uniform_filter(filled, side, mode="constant"), 0.0), full


@dataclass(frozen=True)
class Features:
    """What of a scan stands out from its surroundings.

    Attributes
    ----------
    col, row
        Of the squares (m,).
    height
        Above the mean of the square around (m,), m.
    level
        Height of the scan itself there (m,), m.
    """

    col: IntArray
    row: IntArray
    height: Array
    level: Array


def features_of(surface: Surface, reach: int) -> Features:
    """Return a scan's features: each scan by itself, so that drift between scans leaves no step."""
    if len(surface) == 0:
        return Features(surface.col, surface.row, np.zeros(0), np.zeros(0))
    first = (int(surface.row.min()), int(surface.col.min()))
    shape = (int(surface.row.max()) - first[0] + 1, int(surface.col.max()) - first[1] + 1)
    height, known = np.zeros(shape), np.zeros(shape, np.bool_)
    place = (surface.row - first[0], surface.col - first[1])
    height[place] = surface.position[:, 2]
    known[place] = True
    above, kept = high_pass(height, known, reach)
    row, col = np.nonzero(kept)
    return Features(col + first[1], row + first[0], above[kept], height[kept])


@dataclass(frozen=True)
class Patch:
    """Features of several scans on one raster.

    Attributes
    ----------
    first
        Row and column of its corner.
    height, level
        As in `Features`, averaged (rows, cols), m; 0 where unknown.
    known
        (rows, cols).
    """

    first: tuple[int, int]
    height: Array
    level: Array
    known: NDArray[np.bool_]

    @classmethod
    def merged(cls, scans: list[Features]) -> Patch | None:
        """Return the features of scans together; None if there are none."""
        row = np.concatenate([f.row for f in scans])
        col = np.concatenate([f.col for f in scans])
        if len(row) == 0:
            return None
        first = (int(row.min()), int(col.min()))
        shape = (int(row.max()) - first[0] + 1, int(col.max()) - first[1] + 1)
        place = (row - first[0]) * shape[1] + col - first[1]
        size = shape[0] * shape[1]
        count = np.bincount(place, minlength=size)
        height, level = (
            np.bincount(place, np.concatenate([getattr(f, name) for f in scans]), size)
            / np.maximum(count, 1)
            for name in ("height", "level")
        )
        known = (count > 0).reshape(shape)
        return cls(first, height.reshape(shape), level.reshape(shape), known)


# Places by correlation that are looked at post by post.
_CANDIDATES = 150
# Share of a map that may show another ground than there is, by squares of so many posts.
_CHANGED, _TILE = 0.1, 24
# Size of features, m.
_FEATURE = 0.3


def search(
    patch: Patch,
    elevation: Array,
    posting: float,
    variance: float,
    prior: Array,
    first: Array,
    *,
    reach: int,
    least: int = 60,
) -> Match | None:
    """Find a patch on a map: the posterior over whole-post shifts.

    A matched filter, all shifts at once by correlation, proposes places. Each is then judged post
    by post: how much likelier is what the map shows there if the patch lies there than if not? A
    map's noise agrees with flat ground everywhere, so only features tell; and where a part of the
    map shows another ground altogether, because it is out of date, that part tells nothing.

    Parameters
    ----------
    patch
        What was scanned.
    elevation
        Map (rows, cols), m; NaN for none.
    posting
        Of both, m.
    variance
        Of a residual, m^2.
    prior
        Covariance (2, 2) of the shift beforehand, m^2.
    first
        Shift that puts the patch's corner on the map's (2,), east and north, m.
    reach
        By which the features were found, posts.
    least
        Fewest posts to compare.

    Returns
    -------
    match
        None if the patch is too small, or no shift puts all of it on the map.
    """
    kept = patch.known
    h, posts = high_pass(elevation, np.isfinite(elevation), reach)
    total = float(kept.sum())
    if total < least:
        return None
    weight = kept.astype(np.float64)

    def slide(template: Array, image: Array) -> Array:
        return np.asarray(correlate(image, template, mode="valid", method="fft"))

    covered = slide(weight, posts.astype(np.float64)) > total - 0.5
    if not covered.any():
        return None
    sy, sx = np.meshgrid(
        np.arange(covered.shape[0]) * posting + first[1],
        np.arange(covered.shape[1]) * posting + first[0],
        indexing="ij",
    )
    inverse = np.linalg.inv(prior)
    away = inverse[0, 0] * sx**2 + 2.0 * inverse[0, 1] * sx * sy + inverse[1, 1] * sy**2
    # What is higher than features get is not worth more than they.
    proposal = slide(patch.height, np.clip(h, -_FEATURE, _FEATURE)) / variance - 0.5 * away
    proposal[~covered] = -np.inf
    peaks = np.flatnonzero(covered & (proposal == ndimage.maximum_filter(proposal, 3)))
    best_first = np.argsort(-proposal.ravel()[peaks], kind="stable")
    row, col = np.unravel_index(peaks[best_first[:_CANDIDATES]], covered.shape)
    rows, cols = np.nonzero(kept)
    shown = h[row[:, None] + rows, col[:, None] + cols]
    tile = (rows // _TILE) * (1 + kept.shape[1] // _TILE) + cols // _TILE
    busy = float(np.mean(np.abs(h[posts]) > _FEATURE))
    log = _evidence(patch.height[kept], shown, variance, busy, tile) - 0.5 * away[row, col]
    # Places not looked at are as likely as they were before.
    elsewhere = float(np.exp(-0.5 * away[covered] - log.max()).sum())
    p = np.exp(log - log.max())
    best = int(np.argmax(p))
    x, y = sx[row, col], sy[row, col]
    near = np.hypot(x - x[best], y - y[best]) <= 1.5 * posting + 1e-9
    certainty = float(p[near].sum() / (p.sum() + elsewhere))
    q = np.where(near, p, 0.0) / p[near].sum()
    east, north = float(q @ x), float(q @ y)
    agree = (shown[best] - patch.height[kept]) ** 2 <= 9.0 * variance
    rise = elevation[row[best] + rows, col[best] + cols] - patch.level[kept]
    # A post's width is left open besides the spread of the posterior.
    covariance = np.diag(
        [
            float(q @ (x - east) ** 2) + posting**2,
            float(q @ (y - north) ** 2) + posting**2,
            variance / total + (0.4 * posting) ** 2,
        ]
    )
    up, up_variance = _level(
        slide(weight, np.where(posts, elevation, 0.0)) / total - patch.level[kept].mean(),
        np.where(covered, np.exp(-0.5 * (away - away[covered].min())), 0.0),
    )
    return Match(
        np.array([east, north, float(np.median(rise[agree])) if agree.any() else up]),
        covariance,
        certainty,
        float(agree.mean()),
        up,
        up_variance,
    )


def _evidence(patch: Array, shown: Array, variance: float, busy: float, tile: IntArray) -> Array:
    """Return the log-likelihood ratio of places (c,): the patch lies there, or it does not.

    Parameters
    ----------
    patch
        Features scanned (m,), m.
    shown
        What the map shows at each place (c, m), m.
    variance
        Of the map's noise, m^2.
    busy
        Share of the map's posts that are features.
    tile
        Part of the patch that a post belongs to (m,): ground changes by parts, and one that has
        tells nothing, however many posts it has.
    """
    busy = float(np.clip(busy, 0.01, 0.5))
    wide = variance + _FEATURE**2

    def normal(x: Array, v: float) -> Array:
        return np.asarray(np.exp(-0.5 * x * x / v) / np.sqrt(v))

    elsewhere = (1.0 - busy) * normal(shown, variance) + busy * normal(shown, wide)
    here = (1.0 - busy) * normal(shown - patch, variance) + busy * normal(shown - patch, wide)
    order = np.argsort(tile, kind="stable")
    starts = np.flatnonzero(np.diff(tile[order], prepend=-1))
    # Neighbouring posts on one feature agree or fail together: they count half.
    parts = 0.5 * np.add.reduceat(np.log(here / elsewhere)[:, order], starts, axis=1)
    return np.asarray(np.logaddexp(parts + np.log1p(-_CHANGED), np.log(_CHANGED)).sum(axis=1))


def _level(rise: Array, weight: Array) -> tuple[float, float]:
    """Return mean and variance of the vertical shift over all places, by their probability."""
    weight = weight / weight.sum()
    mean = float((weight * rise).sum())
    return mean, float((weight * (rise - mean) ** 2).sum())
