"""Rock states at the end of an error state: positions, radii and their errors.

Rocks do not move, and their radius is measured directly, in metres and with independent errors
(shadow EKF paper, III.B). Radii are therefore not correlated with the lander or with each other,
and exact scalar filters estimate them.

The paper assumes that all rocks stand on one plane. Here the height of a new rock is interpolated
from its neighbours and from the terrain height below the lander (`terrain_kriging.py`), together
with their errors, so that a height error counts once in repeated observations. If another sensor
has measured the terrain, its shape is used, with an offset from the rocks. After each such
measurement, rocks with a larger height error are corrected by it (`measured_heights.py`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.error_state import MAP, POSE, ErrorState, UpdateOutcome
from lunarsim.onboard.navigation.terrain_heights import (
    COMMON_SIGMA_M,
    INDIVIDUAL_SIGMA_M,
    NEIGHBOUR_COUNT,
    TERRAIN,
    TerrainHeights,
    TerrainPrior,
    correct_heights,
    height_jacobian,
    interpolate_heights,
    kriging_weights,
)
from lunarsim.typing import Array, BoolArray, IntArray

# Number of coordinates of a rock: east, north and height.
ROCK_DIM = 3
# Minimum number of rocks to estimate the offset of the measured terrain.
_MIN_ROCKS = 5


class RockStates:
    """Positions and radii of rocks, with position errors at the end of an error state.

    Parameters
    ----------
    state
        Error state of the lander; the rocks are appended after its blocks.
    terrain_prior
        Prior knowledge of the terrain height.
    capacity
        Initial number of rocks to allocate; it grows as needed.

    Attributes
    ----------
    state
        Error state.
    count
        Number of rocks.
    first
        Index of the first rock's east coordinate in the error state.
    measured_terrain
        Source of measured terrain heights; None: heights are interpolated between the rocks.
    """

    def __init__(self, state: ErrorState, terrain_prior: TerrainPrior, capacity: int) -> None:
        if state.tail:
            raise InputError(
                "state.tail",
                state.tail,
                "must be 0 before rocks are added",
                "Use an error state without rocks.",
            )
        self.state = state
        self.state.reserve(ROCK_DIM * capacity)
        self.state.listeners.append(self._apply_correction)
        self.first = self.state.head
        self.count = 0
        self.measured_terrain: TerrainHeights | None = None
        self._terrain_prior = terrain_prior
        self._xyz = np.zeros((capacity, ROCK_DIM))
        self._r = np.zeros((capacity, 2))
        self._frozen = np.zeros(capacity, bool)

    def _apply_correction(self, error: Array) -> None:
        """Add a correction of the error state (size,) to the rock positions."""
        self.xyz[:] += error[self.first :].reshape(-1, ROCK_DIM)

    def freeze(self, rocks: BoolArray) -> None:
        """Stop correcting the marked rocks by measurements, until the next call.

        `rocks` (n,) marks the frozen rocks. New rocks are not frozen. Correlations between frozen
        and other errors are still updated, so the covariance remains correct.
        """
        self._frozen[: self.count] = rocks
        self._update_frozen()

    def _update_frozen(self) -> None:
        self.state.freeze_tail(np.repeat(self._frozen[: self.count], ROCK_DIM))

    def state_indices(self, index: IntArray | None = None) -> IntArray:
        """Return the indices of the rocks' coordinates in the error state (n, 3).

        `index` (n,) selects rocks; default: all rocks.
        """
        rocks = np.arange(self.count) if index is None else np.asarray(index)
        return np.asarray(self.first + ROCK_DIM * rocks[:, None] + np.arange(ROCK_DIM))

    @property
    def xyz(self) -> Array:
        """Centres of the rocks on the terrain (n, 3), ENU, m."""
        return self._xyz[: self.count]

    @property
    def xy(self) -> Array:
        """Centres of the rocks (n, 2), east and north, m."""
        return self._xyz[: self.count, :2]

    @property
    def radius(self) -> Array:
        """Radii of the rocks (n,), m."""
        return self._r[: self.count, 0]

    @property
    def radius_variance(self) -> Array:
        """Variances of the radii (n,), m^2."""
        return self._r[: self.count, 1]

    def rock_covariance(self) -> Array:
        """Return the covariance of each rock's coordinates (n, 3, 3), m^2."""
        i = self.state_indices()
        return np.asarray(self.state.covariance_for_rows()[i[:, :, None], i[:, None, :]])

    def relative_covariance(self) -> Array:
        """Return the covariance of rock positions relative to the lander (n, 3, 3), m^2.

        Errors common to lander and rocks are not included: they shift the map together with the
        lander and are harmless for positions relative to the map.
        """
        own = self.rock_covariance()
        if self.count == 0:
            return own
        p = self.state.covariance_for_rows()
        cross = np.moveaxis(p[np.arange(ROCK_DIM)[:, None, None], self.state_indices()[None]], 0, 1)
        return np.asarray(own + p[:ROCK_DIM, :ROCK_DIM] - cross - np.swapaxes(cross, 1, 2))

    def height_difference_variance(self, neighbours: IntArray) -> Array:
        """Return the variance of the height difference between rocks (n, k), m^2.

        The differences are those of each of the n rocks to k others, whose indices are
        `neighbours` (n, k).
        """
        p, height = self.state.covariance_for_rows(), self.state_indices()[:, 2]
        own = p[height, height]
        between = self.state.pair_covariances(height[:, None], height[neighbours])
        return np.asarray(own[:, None] + own[neighbours] - 2.0 * between)

    @property
    def prior_variance_growth(self) -> float:
        """Prior growth of the variance of terrain heights with distance, m^2/m.

        0 if the terrain is modelled as horizontal.
        """
        return self._terrain_prior.growth if self.state.has(TERRAIN) else 0.0

    @property
    def terrain_height_below(self) -> float:
        """Estimated height of the terrain below the lander, local frame, m."""
        below = sum(float(self.state.value(name)[at]) for name, at in self._height_blocks())
        return self._terrain_prior.elevation + below

    def _height_blocks(self) -> list[tuple[str, int]]:
        """Return names and indices of the errors that add up to the terrain height.

        The height is that below the lander in the local frame: the errors are those of the terrain
        elevation in the site frame, and of the vertical offset between the frames.
        """
        parts = ((TERRAIN, 0), (MAP, 2))
        return [(name, at) for name, at in parts if self.state.has(name)]

    def terrain_height_at(self, xy: ArrayLike) -> Array:
        """Return the estimated terrain height (b,), m, at points `xy` (b, 2), m.

        If another sensor has measured the terrain, its heights are used, shifted by the median
        offset of the rocks. Elsewhere, heights are interpolated between the rocks.
        """
        at = np.atleast_2d(np.asarray(xy, np.float64))
        if self.measured_terrain is None:
            return self._interpolate_height(at)
        height = self.measured_terrain.heights(at) + self._median_offset(self.measured_terrain)
        unknown = np.isnan(height)
        if unknown.any():
            height[unknown] = self._interpolate_height(at[unknown])
        return height

    def _median_offset(self, measured: TerrainHeights) -> float:
        """Return the median height of the rocks above the measured terrain, m.

        With fewer than five rocks on measured terrain it is 0. The heights of the lander and its
        rocks drift in the local frame by decimetres, while the measured terrain is fixed, so only
        its shape is used.
        """
        if self.count < _MIN_ROCKS:
            return 0.0
        above = self.xyz[:, 2] - measured.heights(self.xy)
        above = above[np.isfinite(above)]
        return float(np.median(above)) if len(above) >= _MIN_ROCKS else 0.0

    @property
    def can_interpolate_height(self) -> bool:
        """Whether terrain heights can be interpolated between rocks."""
        return self.count > 0 and self.state.has(TERRAIN)

    def _interpolate_height(self, xy: Array) -> Array:
        """Interpolate the terrain height (b,), m, at points `xy` (b, 2), m, between rocks.

        Without rocks, or on terrain modelled as horizontal, it is the height below the lander.
        """
        if not self.can_interpolate_height:
            return np.full(len(xy), self.terrain_height_below)
        return interpolate_heights(*self._known_heights(), xy, self._terrain_prior.growth)

    def _known_heights(self) -> tuple[Array, Array]:
        """Return horizontal positions and terrain heights at the lander and the rocks.

        They are (n, 2), m, and (n,), m.
        """
        places = np.vstack((self.state.inertial.position[:2], self.xy))
        return places, np.append(self.terrain_height_below, self.xyz[:, 2])

    def update_radii(
        self,
        index: IntArray,
        radius: Array,
        radius_variance: Array,
        min_variance_ratio: float = 0.0,
    ) -> None:
        """Update the radii of observed rocks by independent scalar Kalman filters.

        `index` (n,) are the rocks; `radius` and `radius_variance` (n,) are the measured radii, m,
        and their variances, m^2. A radius that is not finite, or whose variance is not positive
        and finite, is ignored. `min_variance_ratio` is the minimum variance after the update
        relative to that of the observation.
        """
        radius_variance = np.broadcast_to(radius_variance, np.shape(radius))
        good = np.isfinite(radius) & np.isfinite(radius_variance) & (radius_variance > 0.0)
        index, radius, radius_variance = index[good], radius[good], radius_variance[good]
        r = self._r[index]
        gain = r[:, 1] / (r[:, 1] + radius_variance)
        self._r[index, 0] = r[:, 0] + gain * (radius - r[:, 0])
        self._r[index, 1] = np.maximum((1.0 - gain) * r[:, 1], min_variance_ratio * radius_variance)

    # --- adding and removing --------------------------------------------------------------

    def add_known(self, xy: Array, sigma: Array, radius: Array, radius_variance: Array) -> None:
        """Add rocks with known horizontal positions (n, 2), m, and independent errors.

        `sigma` (n,) are standard deviations per axis, m; `radius` and `radius_variance` (n,) are in
        m and m^2. Heights come from the estimated terrain.
        """
        index = self.append(
            np.column_stack((xy, self.terrain_height_at(xy))), radius, radius_variance
        )
        level = self.state_indices(index)[:, :2].ravel()
        for rock in index:
            self.correlate_height(rock)
        self.state.p[level, level] = np.repeat(np.square(sigma), 2)

    def append(self, points: Array, radius: Array, radius_variance: Array) -> IntArray:
        """Add rocks at points (b, 3), m, with zero covariance; return their indices (b,).

        `radius` and `radius_variance` (b,) are in m and m^2.
        """
        index = np.arange(self.count, self.count + len(points))
        self._reserve(self.count + len(points))
        old = self.state.size
        self._set_count(self.count + len(points))
        p, size = self.state.covariance_for_rows(), self.state.size
        p[old:size, :size] = 0.0
        p[:size, old:size] = 0.0
        self._xyz[index] = points
        self._r[index] = np.column_stack((radius, radius_variance))
        self._frozen[index] = False
        self._update_frozen()
        return index

    def correlate_height(self, rock: int) -> None:
        """Model a rock's height error as a weighted mean of its neighbours' errors.

        The error also has an independent part. `rock` is the index of the rock; its neighbours are
        rocks that were added before, and the terrain below the lander. If the terrain at the rock
        was measured by another sensor, only neighbours on measured terrain are used. Nothing is
        done on terrain modelled as horizontal.
        """
        if not self.state.has(TERRAIN):
            return
        if self.measured_terrain is not None:
            known = np.isfinite(self.measured_terrain.heights(self._xyz[: rock + 1, :2]))
            if known[rock]:
                self._correlate_with_measured(rock, np.flatnonzero(known[:rock]))
                return
        at = self._xyz[rock, :2]
        neighbours = self._nearest(rock, np.arange(rock))
        places = np.vstack((self.state.inertial.position[:2], self._xyz[neighbours, :2]))
        weights, variance = kriging_weights(places[None], at[None], self._terrain_prior.growth)
        below = [self.state.block(name).start + at for name, at in self._height_blocks()]
        sources = np.concatenate((below, self.state_indices(neighbours)[:, 2]))
        weights = np.concatenate((np.full(len(below), weights[0, 0]), weights[0, 1:]))
        self._set_height_error(rock, sources, weights, float(variance[0]))

    def _correlate_with_measured(self, rock: int, others: IntArray) -> None:
        """Model a rock's height error as a mean over neighbours on measured terrain.

        `others` (k,) are the indices of all rocks on measured terrain that were added before.
        Without any, the error depends on the lander's pose, from which the terrain was measured.
        """
        neighbours = self._nearest(rock, others)
        if len(neighbours):
            weights = np.full(len(neighbours), 1.0 / len(neighbours))
            self._set_height_error(
                rock, self.state_indices(neighbours)[:, 2], weights, INDIVIDUAL_SIGMA_M**2
            )
        else:
            weights = height_jacobian(self.state, self._xyz[rock])
            self._set_height_error(rock, POSE, weights, INDIVIDUAL_SIGMA_M**2 + COMMON_SIGMA_M**2)

    def _set_height_error(
        self, rock: int, sources: IntArray, weights: Array, variance: float
    ) -> None:
        self.state.replace_by_sum(
            int(self.state_indices(np.array([rock]))[0, 2]), sources, weights, variance
        )

    def _nearest(self, rock: int, others: IntArray) -> IntArray:
        """Return the five nearest rocks to a rock among `others` (k,), nearest first.

        `rock` and the elements of `others` and of the result are indices of rocks; all are
        returned if there are fewer than five.
        """
        distance = np.hypot(*(self._xyz[others, :2] - self._xyz[rock, :2]).T)
        if len(distance) > NEIGHBOUR_COUNT:
            # Keep all at the same distance as the last one: the stable sort takes the first ones.
            neighbours = np.flatnonzero(
                ~(distance > np.partition(distance, NEIGHBOUR_COUNT - 1)[NEIGHBOUR_COUNT - 1])
            )
            distance, others = distance[neighbours], others[neighbours]
        return others[np.argsort(distance, kind="stable")[:NEIGHBOUR_COUNT]]

    def correct_heights_by_terrain(self) -> UpdateOutcome:
        """Update rock heights with terrain heights measured by another sensor.

        Nothing is done, and the outcome has no degrees of freedom, if there are no rocks, no
        measured terrain, or terrain modelled as horizontal.
        """
        if self.measured_terrain is None or not self.state.has(TERRAIN) or self.count == 0:
            return UpdateOutcome(0.0, 0, False)
        return correct_heights(self, self.measured_terrain)

    def remove(self, index: IntArray) -> IntArray:
        """Remove rocks from the error state and fill the gaps with the last rocks.

        `index` are the removed rocks. The result is the old index of each remaining rock (n,), in
        the new order.
        """
        is_missing = np.zeros(self.count, bool)
        is_missing[index] = True
        remaining = self.count - int(is_missing.sum())
        holes = np.flatnonzero(is_missing[:remaining])
        movers = remaining + np.flatnonzero(~is_missing[remaining:])
        old = np.arange(remaining)
        old[holes] = movers
        self.state.move_and_truncate(
            ROCK_DIM * remaining,
            self.state_indices(holes).ravel(),
            self.state_indices(movers).ravel(),
        )
        self._xyz[holes] = self._xyz[movers]
        self._r[holes] = self._r[movers]
        self._frozen[holes] = self._frozen[movers]
        self._set_count(remaining)
        self._update_frozen()
        return old

    def add_process_noise(self, radius_rate: float, seconds: float) -> None:
        """Add process noise to the rock radii, because the sides of a rock differ.

        `radius_rate` is relative to the radius, per sqrt(s); `seconds` is the elapsed time, s.
        """
        self._r[: self.count, 1] += (radius_rate * self.radius) ** 2 * seconds

    def _reserve(self, count: int) -> None:
        capacity = len(self._r)
        if count <= capacity:
            return
        capacity = max(count, 2 * capacity)
        self.state.reserve(ROCK_DIM * capacity)
        for name in ("_xyz", "_r", "_frozen"):
            old = getattr(self, name)
            more = np.zeros((capacity, *old.shape[1:]), old.dtype)
            more[: self.count] = old[: self.count]
            setattr(self, name, more)

    def _set_count(self, count: int) -> None:
        self.count, self.state.tail = count, ROCK_DIM * count
