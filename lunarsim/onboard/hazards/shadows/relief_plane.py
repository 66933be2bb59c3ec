"""Ground that another mapper of the lander has measured, as the plane on which rocks stand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import Surface
from lunarsim.onboard.perception.ground_plane import GroundPlane

Array = NDArray[np.float64]

# So much of a map must have been seen, and no ground is steeper than this, tangent.
_LEAST_SEEN, _STEEPEST = 0.25, 0.3
# About so many cells along a side are looked at.
_CELLS = 40
# Squares along a side of the map of which each is left out once. By what that changes, a slope must
# be so many standard deviations, or known so well, tangent: that of a crater's wall, of which half
# was seen, is not the map's.
_SQUARES, _SURE, _KNOWN = 6, 2.5, 0.02


def relief_plane(drawn: Surface) -> GroundPlane | None:
    """Return the plane through the elevations of a map by least squares.

    None where too little of it was seen, it seems steeper than ground that is landed on, or what is
    seen does not agree on how it slopes: the delete-a-group jackknife over squares of the map.
    """
    if drawn.elevation is None:
        return None
    step = max(1, min(drawn.grid.shape) // _CELLS)
    height = drawn.elevation[::step, ::step]
    seen: NDArray[np.bool_] = drawn.observed[::step, ::step] & np.isfinite(height)
    if seen.mean() < _LEAST_SEEN:
        return None
    x, y = np.meshgrid(drawn.grid.x[::step], drawn.grid.y[::step])
    middle = np.array([x[seen].mean(), y[seen].mean(), height[seen].mean(dtype=np.float64)])
    terms = np.column_stack((x[seen] - middle[0], y[seen] - middle[1], np.ones(seen.sum())))
    rises, sigma = _fitted(terms, height[seen] - middle[2], _squares(seen))
    slope = np.hypot(*rises[:2])
    if slope > _STEEPEST or (sigma > _KNOWN and slope < _SURE * sigma):
        return None
    return GroundPlane.through((*middle[:2], middle[2] + rises[2]), rises[:2])


def _squares(seen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return in which square of the map each cell (n,) lies that was seen (rows, cols)."""
    row, col = (np.arange(n) * _SQUARES // n for n in seen.shape)
    return np.asarray((_SQUARES * row[:, None] + col)[seen])


def _fitted(terms: Array, height: Array, square: NDArray[np.int64]) -> tuple[Array, float]:
    """Return by how much heights (n,) rise with each of three terms (n, 3), by least squares.

    And what the first two together change by from square to square (n,), 1 sigma of the whole.
    """
    every = _SQUARES**2
    left, right = np.zeros((every, 3, 3)), np.zeros((every, 3))
    np.add.at(left, square, terms[:, :, None] * terms[:, None, :])
    np.add.at(right, square, terms * height[:, None])
    held = np.unique(square)
    rest, their = left.sum(0) - left[held], right.sum(0) - right[held]
    # Of a few cells none may be left to tell.
    without = (np.linalg.pinv(rest, hermitian=True) @ their[..., None])[:, :2, 0]
    off = without - without.mean(0)
    sigma = np.sqrt((len(held) - 1) / len(held) * (off**2).sum())
    return np.linalg.pinv(left.sum(0), hermitian=True) @ right.sum(0), float(sigma)
