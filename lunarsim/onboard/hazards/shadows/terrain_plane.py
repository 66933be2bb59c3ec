"""Ground that another mapper of the lander has measured, as the plane on which rocks stand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.hazards.hazard_map import Surface
from lunarsim.onboard.perception.ground_plane import GroundPlane

Array = NDArray[np.float64]

# So much of a map must have been seen, and no ground is steeper than this, tangent.
_MIN_OBSERVED_FRACTION, _MAX_SLOPE = 0.25, 0.3
# About so many cells along a side are looked at.
_CELLS_PER_SIDE = 40
# Squares along a side of the map of which each is left out once. By what that changes, a slope must
# be so many standard deviations, or known so well, tangent: that of a crater's wall, of which half
# was seen, is not the map's.
_SQUARES_PER_SIDE, _MIN_SIGNIFICANCE, _MAX_SLOPE_SIGMA = 6, 2.5, 0.02


def fit_terrain_plane(surface: Surface) -> GroundPlane | None:
    """Return the plane through the elevations of a map by least squares.

    None where too little of it was seen, it seems steeper than ground that is landed on, or what is
    seen does not agree on how it slopes: the delete-a-group jackknife over squares of the map.
    """
    if surface.elevation is None:
        return None
    step = max(1, min(surface.grid.shape) // _CELLS_PER_SIDE)
    height = surface.elevation[::step, ::step]
    is_observed: NDArray[np.bool_] = surface.observed[::step, ::step] & np.isfinite(height)
    if is_observed.mean() < _MIN_OBSERVED_FRACTION:
        return None
    x, y = np.meshgrid(surface.grid.x[::step], surface.grid.y[::step])
    centre = np.array(
        [x[is_observed].mean(), y[is_observed].mean(), height[is_observed].mean(dtype=np.float64)]
    )
    terms = np.column_stack(
        (x[is_observed] - centre[0], y[is_observed] - centre[1], np.ones(is_observed.sum()))
    )
    coefficients, sigma = _fit(terms, height[is_observed] - centre[2], _square_index(is_observed))
    slope = np.hypot(*coefficients[:2])
    if slope > _MAX_SLOPE or (sigma > _MAX_SLOPE_SIGMA and slope < _MIN_SIGNIFICANCE * sigma):
        return None
    return GroundPlane.through((*centre[:2], centre[2] + coefficients[2]), coefficients[:2])


def _square_index(is_observed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return in which square of the map each cell (n,) lies that was seen (rows, cols)."""
    row, col = (np.arange(n) * _SQUARES_PER_SIDE // n for n in is_observed.shape)
    return np.asarray((_SQUARES_PER_SIDE * row[:, None] + col)[is_observed])


def _fit(terms: Array, height: Array, square: NDArray[np.int64]) -> tuple[Array, float]:
    """Return by how much heights (n,) rise with each of three terms (n, 3), by least squares.

    And what the first two together change by from square to square (n,), 1 sigma of the whole.
    """
    every = _SQUARES_PER_SIDE**2
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
