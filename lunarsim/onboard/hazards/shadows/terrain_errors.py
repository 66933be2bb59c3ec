"""Terrain below tracked rocks, and errors of positions and heights between them.

The map is tied to the terrain by the rocks, whose positions are known. Terrain heights between them
are interpolated. The error grows with the distance to the rocks and with the height differences of
neighbours. Seen from the side, a height error of 1 m displaces a point by 1 m or more.

Evidence from images is stored at positions that follow the mean motion of the rocks
(`lunarsim.onboard.hazards.shadows.map_motion`). The error of a position is thus that of the mean of
the nearby rocks: the error that they share with each other but not with the lander, plus a
fraction of their individual errors. A single inaccurate rock increases it. The median of the
individual errors is another upper bound.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.hazards.hazard_map import TerrainSurface
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.navigation.matrix_2x2 import invert_2x2, largest_eigenvalue_2x2
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.terrain_heights import NEIGHBOUR_COUNT
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

    The result is None without elevations, if less than a quarter of the map is observed, if the
    tangent of the slope exceeds 0.3, or if the slope is too uncertain, as estimated by a jackknife
    over squares of the map.
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


# Half width of the square over which heights are averaged, m, so that the rock itself and errors of
# single returns have little effect.
_HALF_WIDTH_M = 1.0


class MeasuredTerrain:
    """Plane and smoothed heights of the terrain that an elevation mapper has measured.

    Parameters
    ----------
    mapper
        Elevation mapper; None: no measured terrain.
    """

    def __init__(self, mapper: HazardMapper | None) -> None:
        self._mapper = mapper
        self._last_surface: TerrainSurface | None = None
        self._plane: GroundPlane | None = None
        self._heights: Array | None = None
        self._changed = False

    def has_changed(self) -> bool:
        """Return whether the measured terrain has changed since the last call."""
        self._current_surface()
        has_changed, self._changed = self._changed, False
        return has_changed

    def plane(self) -> GroundPlane | None:
        """Return the plane fitted to the terrain; None if it cannot be determined."""
        self._current_surface()
        return self._plane

    def heights(self, xy: Array) -> Array:
        """Return terrain heights (n,) at points (n, 2), local frame, m; NaN if unmeasured.

        Each is the mean of the known heights in a square of 2 m around the cell of the point.
        """
        out = np.full(len(xy), np.nan)
        surface = self._current_surface()
        if surface is None or self._heights is None:
            return out
        at = np.flatnonzero(np.isfinite(xy).all(1))
        at = at[surface.grid.contains(xy[at])]
        out[at] = self._heights[surface.grid.cell(xy[at])]
        return out

    def _current_surface(self) -> TerrainSurface | None:
        """Return the elevations of the mapper; update plane and heights if they are new."""
        if self._mapper is None:
            return None
        surface = self._mapper.terrain_surface()
        if surface is not self._last_surface:
            self._last_surface, self._plane, self._heights = (
                surface,
                fit_terrain_plane(surface),
                _smoothed_elevation(surface),
            )
            self._changed = True
        return surface


def _smoothed_elevation(surface: TerrainSurface) -> Array | None:
    """Return the mean of the known elevations around each known cell (rows, cols), m.

    NaN in unknown cells; None if no elevation is known.
    """
    if surface.elevation is None:
        return None
    known = np.isfinite(surface.elevation)
    if not known.any():
        return None
    side = 2 * max(1, round(_HALF_WIDTH_M / surface.grid.posting)) + 1
    total, share = (
        cv2.blur(of, (side, side), borderType=cv2.BORDER_CONSTANT)
        for of in (np.where(known, surface.elevation, 0.0).astype(np.float64), known.astype(float))
    )
    return np.where(known, total / np.where(known, share, 1.0), np.nan)


# Number of neighbours with which each rock is compared.
_NEIGHBOUR_PAIRS = 3
# Weight of the prior, as a total distance between rocks, m.
_PRIOR_WEIGHT_M = 10.0


def height_variance_growth(rocks: RockFilter) -> float:
    """Estimate the growth of the terrain height variance per metre of distance, m^2/m.

    The estimate is the mean squared height difference of neighbouring rocks, plus the variance of
    its error, per metre of their distance. It is averaged with the prior of the filter `rocks`,
    which is returned for fewer than two rocks.
    """
    prior = rocks.prior_variance_growth
    if rocks.count < 2:
        return prior
    others = np.arange(2, min(_NEIGHBOUR_PAIRS, rocks.count - 1) + 2)
    distance, near = cKDTree(rocks.xy).query(rocks.xy, k=others)
    height = rocks.xyz[:, 2]
    rise = np.square(height[:, None] - height[near]) + rocks.height_difference_variance(near)
    return float((prior * _PRIOR_WEIGHT_M + rise.sum()) / (_PRIOR_WEIGHT_M + distance.sum()))


def height_sigma(rocks: RockFilter, xy: Array) -> Array:
    """Return the error of the terrain height between tracked rocks at points (n, 2).

    The error (n,), m, 1 sigma, is relative to the lander; it is infinite without tracked rocks. The
    variance is the minimum over the nearest rocks of the height variance of the rock plus its
    growth with distance.
    """
    if rocks.count == 0:
        return np.full(len(xy), np.inf)
    nearest = np.arange(1, min(NEIGHBOUR_COUNT, rocks.count) + 1)
    distance, near = cKDTree(rocks.xy).query(xy, k=nearest)
    own = rocks.relative_covariance()[:, 2, 2]
    return np.asarray(np.sqrt((own[near] + height_variance_growth(rocks) * distance).min(axis=1)))


# Number of nearby rocks that determine the error.
_NEIGHBOUR_COUNT = 8


def position_sigma(rocks: RockFilter, xy: Array, sufficient_sigma: float = 0.0) -> Array:
    """Return the error of terrain positions relative to the lander, 1 sigma per axis.

    The error (n,), m, is that of the tracked rocks near each position. It is infinite without
    tracked rocks, because the navigation error between images then exceeds the size of a rock.

    Parameters
    ----------
    rocks
        Filter of the tracked rocks.
    xy
        Positions (n, 2), east and north, m.
    sufficient_sigma
        If the median error of the nearby rocks is at most this value, m, it is returned without
        computing the smaller error of their mean.
    """
    if rocks.count == 0:
        return np.full(len(xy), np.inf)
    rock_sigma = np.sqrt(0.5 * np.trace(rocks.relative_covariance()[:, :2, :2], axis1=1, axis2=2))
    near = cKDTree(rocks.xy).query(xy, k=np.arange(1, min(_NEIGHBOUR_COUNT, rocks.count) + 1))[1]
    sigma = np.asarray(np.median(rock_sigma[near], axis=1))
    is_uncertain = sigma > sufficient_sigma
    sigma[is_uncertain] = np.minimum(sigma[is_uncertain], _mean_sigma(rocks, near[is_uncertain]))
    return sigma


def _mean_sigma(rocks: RockFilter, groups: IntArray) -> Array:
    """Return the error of the mean position of groups of rocks (n,), 1 sigma, m.

    `groups` (n, k) are the indices of the rocks in each group.
    """
    p, places = rocks.state.covariance_for_rows(), rocks.state_indices()
    variance = np.zeros(len(groups))
    for axis in range(2):
        at = places[groups, axis]
        between = rocks.state.pair_covariances(at[:, :, None], at[:, None, :]).mean((1, 2))
        variance += 0.5 * (between - 2.0 * p[axis, at].mean(1) + p[axis, axis])
    return np.sqrt(np.maximum(variance, 0.0))


def terrain_position_covariance(
    points: Array, pixel_covariance: Array, rocks: RockFilter, camera: CameraModel
) -> Array:
    """Convert image covariances to covariances on the terrain (n, 2, 2), m^2.

    `points` (n, 3) are on the terrain, m, and `pixel_covariance` (n, 2, 2) is in pixels^2. The
    filter `rocks` contains the pose of the camera.
    """
    if len(points) == 0:
        return np.empty((0, 2, 2))
    back = invert_2x2(rocks.project_rocks(camera, points).jacobian_by_rock[:, :, :2])
    return np.asarray(back @ pixel_covariance @ np.swapaxes(back, 1, 2))


def terrain_position_sigma(
    points: Array, pixel_covariance: Array, rocks: RockFilter, camera: CameraModel
) -> Array:
    """Convert image covariances to position errors on the terrain (n,), 1 sigma, m.

    The error is that along the worst axis, and NaN where a point is not visible. The arguments are
    those of `terrain_position_covariance`.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(
            np.sqrt(
                largest_eigenvalue_2x2(
                    terrain_position_covariance(points, pixel_covariance, rocks, camera)
                )
            )
        )
