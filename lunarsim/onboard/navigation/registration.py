"""A scan fitted to a map by least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation import _registration_kernels as k

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


def _on_known_ground(surface: Surface, prior: PriorMap) -> NDArray[np.bool_]:
    """Tell which squares of a scan (m,) a map has an elevation for."""
    g, row, col = prior.grid, surface.row, surface.col
    inside = (col >= 0) & (col < g.cols) & (row >= 0) & (row < g.rows)
    inside[inside] = np.isfinite(prior.elevation[row[inside], col[inside]])
    return inside


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
        inside = _on_known_ground(surface, prior)
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
