"""Multiplicative EKF of the lander and all tracked rocks (shadow EKF paper).

It implements Eqs. 1-11 of the paper.

The error state contains the lander, the states of other measurements, and three coordinates per
rock (`rock_states.py`). An observed rock depends on position, attitude and its own coordinates, so
products with its Jacobian need few rows of the covariance. All rocks of an image are processed in
one update, which equals the sequential updates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim._blas import one_blas_thread
from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.frames import rotation_about_up
from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation._rock_filter_kernels import (
    add_outer_products,
    multiply_pixel_jacobians,
)
from lunarsim.onboard.navigation.aiding_measurements import AidingMeasurements, aiding_blocks
from lunarsim.onboard.navigation.error_state import (
    MAP,
    POSE,
    REFERENCE_POSE,
    ErrorState,
    UpdateOutcome,
)
from lunarsim.onboard.navigation.inertial import ATTITUDE, VELOCITY, StartSigmas, StrapdownState
from lunarsim.onboard.navigation.innovation_monitor import (
    ImageInnovationMonitor,
    RockCorrection,
)
from lunarsim.onboard.navigation.matrix_2x2 import invert_2x2, is_positive_definite_2x2
from lunarsim.onboard.navigation.rock_projection import RockProjection, project_points
from lunarsim.onboard.navigation.rock_states import ROCK_DIM, RockStates
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior, intersect_lines
from lunarsim.typing import Array, BoolArray, IntArray

# Minimum rotation of the view (rad), or relative change of the range, for a process-noise step.
_MIN_VIEW_CHANGE = 0.02
# Minimum distance of a rock from the camera in the process noise, m.
_MIN_RANGE_M = 0.1
# Maximum number of iterations for the intersection of a line of sight with sloping terrain, and the
# height change at which they stop, m.
_MAX_ITERATIONS, _HEIGHT_TOLERANCE_M = 8, 0.01
# Limits of the decrease of the height difference per metre of step, by which a step is divided.
_STEP_LIMITS = (0.2, 3.0)
# Margin around a region for points found on horizontal terrain, m, and maximum slope (tangent) of
# the terrain from the centre of the region.
_REGION_MARGIN_M, _MAX_SLOPE = 10.0, 0.36
# Limits of the factor of a covariance inflation, and maximum standard deviations after it: position
# of rocks and lander (m), velocity (m/s), attitude (rad).
_MIN_GROWTH, _MAX_GROWTH = 4.0, 1e3
_MAX_POSITION_SIGMA_M, _MAX_SPEED_SIGMA_M_S, _MAX_ATTITUDE_SIGMA_RAD = 100.0, 10.0, 0.1

# Limits of a region: west, east, south and north, m.
MapRegion = tuple[float, float, float, float]


class RockFilter(RockStates):
    """Joint Kalman filter of the lander and the positions of tracked rocks.

    Parameters
    ----------
    state
        Error state of the lander; the rocks are appended after its blocks.
    aiding
        Processor of ranges, speeds and attitudes, with the prior terrain height.
    capacity
        Initial number of rocks to allocate; it grows as needed.

    Attributes
    ----------
    image_monitor
        Monitor of the image observations.
    events
        Events of this filter and of `aiding`.
    """

    def __init__(
        self, state: ErrorState, aiding: AidingMeasurements, *, capacity: int = 128
    ) -> None:
        super().__init__(state, aiding.terrain_prior, capacity)
        self.events = aiding.events
        self.image_monitor = ImageInnovationMonitor(self.events)
        self._aiding = aiding
        self._last_camera_position: Array | None = None
        self._pixel = 0.0

    @classmethod
    def of(
        cls,
        inertial: StrapdownState,
        start_sigmas: StartSigmas | None = None,
        *,
        terrain_prior: TerrainPrior | None = None,
        capacity: int = 128,
    ) -> RockFilter:
        """Return a filter of lander and rocks only, in the frame of the initial estimate.

        Parameters
        ----------
        inertial
            Initial state of the lander.
        start_sigmas
            Standard deviations of the initial state.
        terrain_prior
            Prior knowledge of the terrain height; default: horizontal at 0 m, exact.
        capacity
            Initial number of rocks to allocate.
        """
        level = terrain_prior or TerrainPrior(0.0, None)
        state = ErrorState(inertial, start_sigmas, blocks=aiding_blocks({}, level))
        return cls(state, AidingMeasurements(state, {}, level, []), capacity=capacity)

    @property
    def inertial(self) -> StrapdownState:
        """Estimated state of the lander (pose, velocity, biases)."""
        return self.state.inertial

    # --- state ----------------------------------------------------------------------------

    @property
    def covariance(self) -> Array:
        """Covariance of the lander (15), other error blocks, and rock coordinates (3 n)."""
        return self.state.covariance

    def terrain_points(
        self, camera: CameraModel, pixel: Array, region: MapRegion | None = None
    ) -> Array:
        """Intersect lines of sight through undistorted pixels (n, 2) with the terrain.

        `region` is an optional region of interest: west, east, south and north limits, m. Returns
        points (n, 3), m; NaN without an intersection, and for points far outside the region.
        """
        out = np.full((len(pixel), ROCK_DIM), np.nan)
        if len(pixel) == 0:
            return out
        origin, per_drop = self._sight_lines(camera, pixel)
        middle = None if region is None else np.reshape(region, (2, 2)).mean(axis=1)
        out[:, 2] = (
            self.terrain_height_below if middle is None else self.terrain_height_at(middle)[0]
        )
        out[:, :2] = origin[:2] + per_drop * (origin[2] - out[:, 2:])
        is_finite = np.isfinite(out[:, :2]).all(1)
        if region is not None:
            is_finite &= _is_near_region(out[:, :2], per_drop, region)
            out[~is_finite] = np.nan
        out[is_finite] = self._intersect(origin, per_drop[is_finite], out[is_finite, 2])
        return out

    def _intersect(self, origin: Array, per_drop: Array, height: Array) -> Array:
        """Return the intersections (n, 3), m, of lines from one point with the terrain.

        `origin` (3,) is the point, `per_drop` (n, 2) the advance of the lines, east and north, per
        metre of drop, and `height` (n,) the initial heights of the iteration, m. Without
        convergence, the iterate closest to the terrain is returned; heights are NaN where the
        terrain is unknown.
        """
        if self.measured_terrain is None and self.can_interpolate_height:
            # The compiled version of the same iteration.
            search = (_MAX_ITERATIONS, _HEIGHT_TOLERANCE_M, *_STEP_LIMITS)
            known = self._known_heights()
            return intersect_lines(
                *known, origin, per_drop, height, self._terrain_prior.growth, search
            )
        indices, last_height, last_gap = (
            np.arange(len(height)),
            height,
            np.full(len(height), np.nan),
        )
        least, points = np.full(len(height), np.inf), np.empty((len(height), ROCK_DIM))
        for _ in range(_MAX_ITERATIONS):
            xy = origin[:2] + per_drop[indices] * (origin[2] - height)[:, None]
            found = self.terrain_height_at(xy)
            gap = found - height
            # Without convergence, the best iterate counts; NaN: the terrain height is unknown.
            is_better = ~(np.abs(gap) >= least[indices])
            points[indices[is_better]] = np.column_stack((xy, found))[is_better]
            least[indices[is_better]] = np.abs(gap[is_better])
            is_active = np.abs(gap) > _HEIGHT_TOLERANCE_M
            if not is_active.any():
                break
            # Secant step: intersect the line with the terrain slope between the last two iterates.
            with np.errstate(invalid="ignore", divide="ignore"):
                step = gap / np.clip((last_gap - gap) / (height - last_height), *_STEP_LIMITS)
            next_height = np.where(np.isfinite(step), height + step, found)
            indices, last_height, last_gap, height = (
                indices[is_active],
                height[is_active],
                gap[is_active],
                next_height[is_active],
            )
        return points

    def _sight_lines(self, camera: CameraModel, pixel: Array) -> tuple[Array, Array]:
        """Return camera position (3,) and the lines of sight through pixels (n, 2).

        A line is given by its horizontal advance, east and north, per metre of descent (n, 2); NaN
        for lines that do not descend.
        """
        view = camera.view(self.inertial)
        tangent = (pixel - [view.cx, view.cy]) / [view.fx, view.fy]
        ray = np.column_stack((tangent, np.ones(len(tangent)))) @ view.axes.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return view.position, np.where(ray[:, 2:] < 0.0, ray[:, :2] / -ray[:, 2:], np.nan)

    def rotate_to_local(self, direction: Array) -> Array:
        """Return a direction (3,), given in the site frame, in the frame of the filter."""
        if not self.state.has(MAP):
            return direction
        return rotation_about_up(-float(self.state.value(MAP)[3])) @ direction

    @property
    def lost(self) -> bool:
        """Whether measurements or rock observations contradict the estimate."""
        return self._aiding.lost or self.image_monitor.lost

    # --- time -----------------------------------------------------------------------------

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Propagate the filter with inertial samples; NaN marks missing samples.

        `angle` (n, 3), rad, and `velocity` (n, 3), m/s, are the increments of gyroscopes and
        accelerometers.
        """
        self.state.propagate(angle, velocity)
        self._aiding.add_terrain_noise()
        self._aiding.check_sensor_biases()

    # --- rocks ----------------------------------------------------------------------------

    def project_rocks(self, camera: CameraModel, points: Array | None = None) -> RockProjection:
        """Predict the pixels of points (n, 3), m, by default of all tracked rocks.

        This is the projection of the shadow EKF paper (Eqs. 10-11), from the estimated pose.
        """
        return project_points(self.inertial, camera, self.xyz if points is None else points)

    def innovation_covariance(self, predicted: RockProjection) -> Array:
        """Return the covariance of the predicted pixels of all rocks (n, 2, 2).

        `predicted` is the prediction from the current state. The pixel noise is not included.
        """
        p = self.state.covariance_for_rows(POSE)
        pose = p[np.ix_(POSE, POSE)]
        cross = np.moveaxis(p[POSE[:, None, None], self.state_indices()[None]], 0, 1)  # (n, 6, 3)
        own = self.rock_covariance()
        a, b = predicted.jacobian_by_pose, predicted.jacobian_by_rock
        mixed = a @ cross @ np.swapaxes(b, 1, 2)
        return np.asarray(
            a @ pose @ np.swapaxes(a, 1, 2)
            + mixed
            + np.swapaxes(mixed, 1, 2)
            + b @ own @ np.swapaxes(b, 1, 2)
        )

    def update_rocks(
        self,
        index: IntArray,
        predicted: RockProjection,
        pixel: Array,
        pixel_covariance: Array,
        radius: Array,
        radius_variance: Array,
        common_sigma: float = 0.0,
        min_variance_ratio: float = 0.0,
        gate: float = np.inf,
    ) -> UpdateOutcome:
        """Update lander and rocks with the rock observations of one image.

        Observations that are not finite or have no positive variance are ignored.

        Parameters
        ----------
        index
            Indices of the rocks (n,), without repetition.
        predicted
            Predicted pixels of all rocks from the current state.
        pixel, pixel_covariance
            Measured centres (n, 2) and their covariances (n, 2, 2).
        radius, radius_variance
            Measured radii (n,), m and m^2.
        common_sigma
            Standard deviation of an error common to all pixels of the image, per axis, pixels. The
            offset between a rock and its shadow depends on the view, so it does not average out
            over the rocks.
        min_variance_ratio
            Minimum variance of a radius relative to that of one observation, since observations
            from nearly the same place have correlated errors.
        gate
            Maximum normalised innovation squared per degree of freedom; above it all positions of
            the image are rejected.

        Returns
        -------
        outcome
            Outcome for the pixel coordinates, with two degrees of freedom per rock.
        """
        self.update_radii(index, radius, radius_variance, min_variance_ratio)
        good = np.isfinite(pixel).all(1) & is_positive_definite_2x2(pixel_covariance)
        if not good.any():
            return UpdateOutcome(0.0, 0, False)
        with one_blas_thread():
            return self._update_positions(
                index[good], predicted, pixel[good], pixel_covariance[good], common_sigma, gate
            )

    def _update_positions(
        self,
        index: IntArray,
        predicted: RockProjection,
        pixel: Array,
        pixel_covariance: Array,
        common_sigma: float,
        gate: float,
    ) -> UpdateOutcome:
        """Update lander and rock positions with valid pixels; return the outcome.

        `index` (m,), `pixel` (m, 2) and `pixel_covariance` (m, 2, 2) are the valid observations;
        the other parameters are those of `update_rocks`.
        """
        m = len(index)
        a, b = predicted.jacobian_by_pose[index], predicted.jacobian_by_rock[index]
        columns = self.state_indices(index)
        with threads_for(1e-2 * m * self.state.size):
            p = self.state.covariance_for_rows(POSE, columns)
            hp = multiply_pixel_jacobians(p, self.state.size, POSE, a, columns, b)
        s = hp[:, POSE] @ a.reshape(2 * m, 6).T
        own = hp[:, columns.ravel()].reshape(2 * m, m, ROCK_DIM)
        s += np.einsum("kmj,mij->kmi", own, b).reshape(2 * m, 2 * m)
        block = 2 * np.arange(m)[:, None] + np.arange(2)
        s[block[:, :, None], block[:, None, :]] += pixel_covariance
        s[::2, ::2] += common_sigma**2
        s[1::2, 1::2] += common_sigma**2
        innovation = (pixel - predicted.pixel[index]).ravel()
        return self.state.update_with_innovation(hp, s, innovation, 2 * m * gate)

    def add_view_noise(
        self, sun: Array, along_sigma: float, across_sigma: float, common_sigma: float, *,
        scale_sigma: float = 0.0, pixel_size: float = 0.0,
    ) -> None:  # fmt: skip
        """Add process noise to rock positions after a change of view, range or pixel size.

        The offset between a shadow patch and its rock depends on the viewpoint. The error of the
        shadow model has an individual part and a common part; the common part lies along the Sun
        direction. A camera with another pixel size resolves the rocks as if from another range.
        Noise is added once the median line of sight has rotated by 0.02 rad, or range or pixel
        size have changed by 2 %; smaller changes add up until then.

        Parameters
        ----------
        sun
            Direction to the Sun (3,), ENU.
        along_sigma, across_sigma
            Individual standard deviation after the line of sight rotated by 1 rad, along the Sun
            direction and across it, in rock radii.
        common_sigma
            Common standard deviation after a rotation by 1 rad, in rock radii.
        scale_sigma
            Common standard deviation after a change of the pixel footprint by a factor e, by range
            or by camera; in units of the larger footprint.
        pixel_size
            Footprint of a pixel at a range of 1 m, m.
        """
        origin = self.inertial.position.copy()
        other, coarser = 0.0, pixel_size
        if min(pixel_size, self._pixel) > 0.0:
            other, coarser = (
                abs(float(np.log(pixel_size / self._pixel))),
                max(pixel_size, self._pixel),
            )
        if self._last_camera_position is None or self.count == 0:
            self._last_camera_position, self._pixel = origin, pixel_size
            return
        old, new = self.xyz - self._last_camera_position, self.xyz - origin
        angle = np.arctan2(
            np.linalg.norm(np.cross(old, new), axis=1), np.einsum("ij,ij->i", old, new)
        )
        far = np.maximum(np.linalg.norm(new, axis=1), _MIN_RANGE_M)
        is_better = np.abs(np.log(far / np.maximum(np.linalg.norm(old, axis=1), _MIN_RANGE_M)))
        if max(np.median(angle), np.median(is_better), other) < _MIN_VIEW_CHANGE:
            return
        self._last_camera_position, self._pixel = origin, pixel_size
        level = sun[:2] / np.hypot(sun[0], sun[1])
        root = np.sqrt(angle) * self.radius
        range_ = scale_sigma * np.sqrt(is_better + other) * coarser * far
        self._add_common_noise(np.stack((common_sigma * root, range_)), level)
        axes = np.array([[*level, 0.0], [-level[1], level[0], 0.0]])
        i = self.state_indices()
        own = (axes.T * [along_sigma**2, across_sigma**2]) @ axes
        own = 0.5 * (own + own.T)  # symmetric to the last bit
        self.state.covariance_for_rows()[i[:, :, None], i[:, None, :]] += (root**2)[
            :, None, None
        ] * own

    def _add_common_noise(self, sigma: Array, axis: Array) -> None:
        """Add position noise that is common to all rocks along a horizontal axis (2,).

        `sigma` (k, n), m, is the standard deviation by each of k independent sources for each of n
        rocks.
        """
        size = self.state.size
        move = np.zeros((len(sigma), self.count, ROCK_DIM))
        move[..., :2] = sigma[..., None] * axis
        with threads_for(4e-3 * size**2):
            add_outer_products(
                self.state.covariance_for_rows()[self.first : size, self.first : size],
                move.reshape(len(sigma), -1),
            )

    def monitor_image(self, kind: str, time: float, outcome: UpdateOutcome) -> RockCorrection:
        """Monitor the outcome of an image update; inflate the covariance after an alarm.

        `kind` is the monitored quantity: "places", "expected" or "shadows"; an alarm of "shadows"
        inflates nothing. `time` is in s. The caller must reset the rocks if the returned action is
        `RockCorrection.RESET`.
        """
        remedy = self.image_monitor.record(kind, time, outcome)
        if remedy is not RockCorrection.NONE and kind != "shadows":
            nis_ratio = self.image_monitor.monitors[kind].nis_ratio
            growth = float(np.clip(nis_ratio, _MIN_GROWTH, _MAX_GROWTH))
            size = self.state.size
            max_sigma = np.full(size, _MAX_POSITION_SIGMA_M)
            max_sigma[VELOCITY], max_sigma[ATTITUDE] = _MAX_SPEED_SIGMA_M_S, _MAX_ATTITUDE_SIGMA_RAD
            columns = np.r_[0:6, 9:12, self.first : size]
            # If only the pose were inflated, scans would pull it back to the reference pose and to
            # the estimated map offset.
            for name in (REFERENCE_POSE, MAP):
                if self.state.has(name):
                    block = self.state.block(name)
                    max_sigma[block.start + 3 : block.stop] = _MAX_ATTITUDE_SIGMA_RAD
                    columns = np.r_[columns, block]
            self.state.inflate(columns, growth, max_sigma[columns])
        return remedy

    # --- adding and removing --------------------------------------------------------------

    def add(
        self,
        camera: CameraModel,
        points: Array,
        pixel_covariance: Array,
        radius: Array,
        radius_variance: Array,
    ) -> IntArray:
        """Add rocks observed in an image, correlated with the lander and other rocks.

        The rocks are at `points` (b, 3), m; `pixel_covariance` (b, 2, 2) is that of the observed
        pixels; `radius` and `radius_variance` (b,) are in m and m^2. Heights are correlated with
        those of neighbouring rocks.

        Returns
        -------
        index
            Indices of the new rocks (b,).

        Raises
        ------
        InputError
            If a point is not in front of the camera; nothing is changed then.
        """
        jacobians = self._position_jacobians(camera, points, pixel_covariance)
        index = self.append(points, radius, radius_variance)
        for rock in index:
            self.correlate_height(rock)
        self._set_position_covariance(index, *jacobians)
        return index

    def reset_positions(
        self,
        index: IntArray,
        camera: CameraModel,
        pixel: Array,
        pixel_covariance: Array,
        radius: Array,
        radius_variance: Array,
    ) -> None:
        """Reset the positions of rocks (b,) to one image's undistorted pixels (b, 2).

        The information of earlier images is discarded, and the lander is not corrected. The heights
        of the rocks do not change. `pixel_covariance` is (b, 2, 2); `radius` and `radius_variance`
        (b,) are in m and m^2.

        Raises
        ------
        InputError
            If a line of sight does not meet the terrain; nothing is changed then.
        """
        origin, per_drop = self._sight_lines(camera, pixel)
        height = self.xyz[index, 2]
        points = np.column_stack((origin[:2] + per_drop * (origin[2] - height)[:, None], height))
        jacobians = self._position_jacobians(camera, points, pixel_covariance)
        self._xyz[index] = points
        self._r[index] = np.column_stack((radius, radius_variance))
        self._set_position_covariance(index, *jacobians)

    def _position_jacobians(
        self, camera: CameraModel, points: Array, pixel_covariance: Array
    ) -> tuple[Array, Array, Array]:
        """Return Jacobians and covariance of rock positions found by lines of sight.

        The horizontal positions at `points` (b, 3), m, follow from ``by_pose d(pose) + by_rock
        d(rock) = d(pixel)``. The results are the Jacobian with respect to the pose (b, 2, 6), that
        with respect to the rock's height (b, 2), and the covariance from the pixel noise (b, 2,
        2), m^2. An `InputError` is raised for a point without a line of sight.
        """
        sight = self.project_rocks(camera, points)
        back = invert_2x2(sight.jacobian_by_rock[:, :, :2])
        by_pose = -(back @ sight.jacobian_by_pose)
        by_height = -(back @ sight.jacobian_by_rock[:, :, 2:])[:, :, 0]
        own = back @ pixel_covariance @ np.swapaxes(back, 1, 2)
        is_valid = np.isfinite(by_pose).all(axis=(1, 2)) & np.isfinite(own).all(axis=(1, 2))
        if not is_valid.all():
            n = int(np.argmin(is_valid))
            raise InputError(
                f"rocks[{n}]", points[n], "must be a terrain point in front of the camera"
            )
        return by_pose, by_height, own

    def _set_position_covariance(
        self, index: IntArray, by_pose: Array, by_height: Array, noise_covariance: Array
    ) -> None:
        """Set the horizontal covariance of the rocks `index` (b,) in the error state.

        The other parameters are the results of `_position_jacobians`.
        """
        b = len(index)
        size, i = self.state.size, self.state_indices(index)
        p, level = self.state.covariance_for_rows(POSE, i), i[:, :2].ravel()
        rows = by_pose.reshape(2 * b, 6) @ p[POSE, :size]
        rows += (by_height[:, :, None] * p[i[:, 2], :size][:, None, :]).reshape(2 * b, size)
        self.state.set_rows(level, rows)
        block = rows[:, POSE] @ by_pose.reshape(2 * b, 6).T
        block += rows[:, i[:, 2]].repeat(2, 1) * by_height.ravel()
        at = np.arange(2 * b).reshape(b, 2)
        block[at[:, :, None], at[:, None, :]] += noise_covariance
        p[np.ix_(level, level)] = 0.5 * (block + block.T)


def _is_near_region(xy: Array, per_drop: Array, region: MapRegion) -> BoolArray:
    """Return which points (n, 2), m, can lie inside a region or its margin.

    `region` are the west, east, south and north limits of the region, m. The points were found on
    horizontal terrain at the height of the region's centre, along lines with an advance of
    `per_drop` (n, 2) per metre of drop.
    """
    west, east, south, north = region
    rise = _MAX_SLOPE * 0.5 * max(east - west, north - south)
    last_gap = _REGION_MARGIN_M + rise * np.linalg.norm(per_drop, axis=1)
    x, y = xy.T
    return np.asarray(
        (x > west - last_gap)
        & (x < east + last_gap)
        & (y > south - last_gap)
        & (y < north + last_gap)
    )
