"""Fit a plane to the terrain measured by another mapper."""

from __future__ import annotations

import numpy as np

from lunarsim.onboard.hazards.hazard_map import TerrainSurface
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.typing import Array, BoolArray, IntArray

# Minimum observed fraction of the map, and maximum slope of terrain, tangent.
_MIN_OBSERVED_FRACTION, _MAX_SLOPE = 0.25, 0.3
# Approximate number of cells along a side that are used.
_CELLS_PER_SIDE = 40
# Jackknife squares along a side of the map. Relative to their scatter, a slope must be significant
# by this many standard deviations, or accurate to this tangent. The slope of a crater wall of which
# half is observed is not that of the map.
_SQUARES_PER_SIDE, _MIN_SIGNIFICANCE, _MAX_SLOPE_SIGMA = 6, 2.5, 0.02


def fit_terrain_plane(surface: TerrainSurface) -> GroundPlane | None:
    """Fit a least-squares plane to the elevations of a map.

    The result is None if too little is observed, if the slope exceeds that of landing terrain, or
    if the slope is too uncertain, as estimated by a jackknife over squares of the map.
    """
    if surface.elevation is None:
        return None
    step = max(1, min(surface.grid.shape) // _CELLS_PER_SIDE)
    height = surface.elevation[::step, ::step]
    is_observed: BoolArray = surface.observed[::step, ::step] & np.isfinite(height)
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


def _square_index(is_observed: BoolArray) -> IntArray:
    """Return the index of the jackknife square of each observed cell (n,).

    `is_observed` (rows, cols) marks the observed cells.
    """
    row, col = (np.arange(n) * _SQUARES_PER_SIDE // n for n in is_observed.shape)
    return np.asarray((_SQUARES_PER_SIDE * row[:, None] + col)[is_observed])


def _fit(terms: Array, height: Array, square: IntArray) -> tuple[Array, float]:
    """Fit heights (n,) by least squares as a linear combination of three terms (n, 3).

    `square` (n,) is the jackknife square of each height. Returns the coefficients (3,) and the
    jackknife error of the slope, 1 sigma.
    """
    every = _SQUARES_PER_SIDE**2
    left, right = np.zeros((every, 3, 3)), np.zeros((every, 3))
    np.add.at(left, square, terms[:, :, None] * terms[:, None, :])
    np.add.at(right, square, terms * height[:, None])
    held = np.unique(square)
    rest, their = left.sum(0) - left[held], right.sum(0) - right[held]
    # With few squares the reduced matrix may be singular.
    without = (np.linalg.pinv(rest, hermitian=True) @ their[..., None])[:, :2, 0]
    off = without - without.mean(0)
    sigma = np.sqrt((len(held) - 1) / len(held) * (off**2).sum())
    return np.linalg.pinv(left.sum(0), hermitian=True) @ right.sum(0), float(sigma)
