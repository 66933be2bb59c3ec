"""A scan fitted to a map by least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.seen_scan import SeenScan
from lunarsim.onboard.navigation.surface import Surface, surface_of

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
    prior: PriorMap,
    covariance: Array,
    variance: Array,
    expected: float,
    *,
    passes: int = 4,
) -> tuple[Fit, tuple[IntArray, IntArray]]:
    """Fit a scan to a map.

    Gauss-Newton: the scan is averaged afresh with each correction, until the ground moves by less
    than a twentieth of a post. What is returned refers to the scan as it was given.

    Parameters
    ----------
    seen, prior
        To be compared; the scan in the frame of the map.
    covariance
        Of the scan's errors (11, 11): see `SeenScan`.
    variance
        Of a residual at each post (rows, cols), m^2, greater the more often it has been used.
    expected
        Of a residual by itself, m^2.
    passes
        At most.

    Returns
    -------
    fit
        Information on the scan's errors.
    posts
        Rows and columns of the posts compared.
    """
    g = prior.grid
    error = np.zeros(len(covariance))
    for _ in range(passes):
        moved = seen.moved(error)
        surface = surface_of(moved.points(), g)
        inside = _on_known_ground(surface, prior)
        posts = surface.row[inside], surface.col[inside]
        jacobian = moved.jacobian(surface.position[inside], surface.normal[inside])
        residual = prior.elevation[posts] - surface.position[inside, 2] + jacobian @ error
        result = fit(
            jacobian, residual, variance[posts], covariance,
            expected=np.full(len(residual), expected),
        )  # fmt: skip
        if result.used == 0:
            break
        step = (
            covariance
            @ np.linalg.solve(np.eye(len(error)) + result.information @ covariance, result.vector)
            - error
        )
        error = error + step
        middle = surface.position[inside].mean(axis=0)
        if np.abs(moved.point_jacobian(middle) @ step).max() < 0.05 * g.posting:
            break
    return result, posts
