"""Track rocks: association, birth, merging, splitting and deletion."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.camera import CameraModel
from lunarsim.onboard.hazards.shadows.association import TentativeRocks, associate, is_dark_at_patch
from lunarsim.onboard.hazards.shadows.terrain_errors import (
    terrain_position_covariance,
    terrain_position_sigma,
)
from lunarsim.onboard.hazards.shadows.tracker_settings import TrackerSettings
from lunarsim.onboard.hazards.shadows.viewing_geometry import viewing_geometry
from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.innovation_monitor import RockCorrection
from lunarsim.onboard.navigation.matrix_2x2 import is_positive_definite_2x2, squared_mahalanobis_2x2
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.rock_projection import RockProjection
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.onboard.perception.plane_models import model_on_plane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.perception.sun_direction import (
    observation_scatter_factor,
    shadow_length_ratio,
    unit_vector,
)
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import check_elements, check_time

# Observations of the same shadow are not independent: limits of the factor by which one image
# changes the odds of existence, and existence below which a rock is deleted.
_MAX_ODDS_FACTOR = 3.0
_MIN_MISS_FACTOR = 0.6
_MIN_EXISTENCE = 0.05
# Existence and number of images from which a rock is expected in every image.
_ESTABLISHED_EXISTENCE, _ESTABLISHED_HITS = 0.9, 5
# Minimum number of expected rocks, minimum images in which each was found, and minimum fraction of
# them that an image must show.
_MIN_EXPECTED_ROCKS, _MIN_PREVIOUS_HITS, _MIN_DETECTED_FRACTION = 3.0, 2, 0.35
# A rock is deleted below this fraction of the minimum radius.
_DROP_RADIUS_RATIO = 0.85
# Maximum ratio of the position error of the second observation to that allowed for the first.
_MAX_SIGMA_RATIO = 4.0
# 99.7 % quantile of chi-squared with 2 degrees of freedom.
_CHI2_2DOF_997 = 11.6


class RockTracker:
    """Tracker that associates detected shadows with rocks and adds or removes rocks.

    The positions of the rocks are estimated by a filter; the tracker estimates the probability that
    each rock exists.

    Parameters
    ----------
    rocks
        Filter of the rocks; only the tracker adds and removes its rocks.
    model, rates
        Model of the shadows, and rates of missed and false detections.
    settings
        Criteria for adding, deleting, merging and splitting rocks.

    Attributes
    ----------
    existence
        Probability that each rock exists (n,).
    hits
        Number of images in which each rock was found (n,).
    corrected
        Time of the last position update of each rock (n,), s; -inf: never.
    tentative
        Detections of the last image that are not tracked.
    explained
        Whether each detection of the last image is a confirmed rock (d,).
    as_expected
        Whether the last image in which enough rocks were expected showed enough of them.
    renewals
        Number of times that all rocks were dropped because images contradicted them.
    """

    def __init__(
        self,
        rocks: RockFilter,
        model: ShadowModel | ShapeMixture,
        rates: DetectionRates | None = None,
        settings: TrackerSettings | None = None,
    ) -> None:
        self.filter = rocks
        self.model = model
        self.rates = rates or DetectionRates()
        self.settings = settings or TrackerSettings()
        self.existence = np.empty(0)
        self.hits = np.empty(0, np.int64)
        self.tentative = TentativeRocks.none()
        self.explained = np.zeros(0, np.bool_)
        self.as_expected = True
        self.renewals = 0
        self.corrected = np.empty(0)
        self._established = np.empty(0, bool)
        # Rocks seen only in the image that started their track.
        self._seen_once = np.empty(0, bool)
        # Positions at the last call of `moved`; NaN for rocks added since.
        self._last_positions = np.empty((0, 2))
        self._scatter_factor = 1.0
        self._time: float | None = None

    @property
    def _last_time(self) -> float:
        """Time of the last image, s; -inf before the first image."""
        return -np.inf if self._time is None else self._time

    def add_known(
        self, xy: ArrayLike, sigma: ArrayLike, radius: ArrayLike, radius_sigma: ArrayLike
    ) -> None:
        """Add rocks whose positions are known in advance, with an existence of 0.99.

        Parameters
        ----------
        xy, sigma
            Centres (n, 2) and their standard deviation per axis (n,), m.
        radius, radius_sigma
            Radius and its standard deviation (n,), m.

        Raises
        ------
        InputError
            If a radius or a standard deviation is not positive and finite.
        """
        xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
        n = len(xy)
        arrays = [np.broadcast_to(np.asarray(v, float), n) for v in (sigma, radius, radius_sigma)]
        for name, array in zip(("sigma", "radius", "radius_sigma"), arrays, strict=True):
            is_valid = np.isfinite(array) & (array > 0.0)
            check_elements(name, array, is_valid, "must be positive and finite")
        self.filter.add_known(xy, arrays[0], arrays[1], arrays[2] ** 2)
        self.existence = np.concatenate((self.existence, np.full(n, 0.99)))
        self.hits = np.concatenate((self.hits, np.ones(n, np.int64)))
        self.corrected = np.concatenate((self.corrected, np.full(n, -np.inf)))
        self._established = np.concatenate((self._established, np.zeros(n, bool)))
        self._seen_once = np.concatenate((self._seen_once, np.zeros(n, bool)))
        self._last_positions = np.concatenate((self._last_positions, np.full((n, 2), np.nan)))

    def update(
        self, detections: Detections, camera: CameraModel, sun: Array, time: float,
        plane: GroundPlane = LEVEL,
    ) -> UpdateOutcome:  # fmt: skip
        """Update the tracked rocks with the detections of one image.

        The result is the outcome of the position update in the filter.

        Parameters
        ----------
        detections
            Rocks detected in the image.
        camera
            Camera model.
        sun
            Direction towards the Sun (3,), ENU.
        time
            Time of the image, s.
        plane
            Plane on which shadows fall.

        Raises
        ------
        InputError
            If the image is older than the last one, or if `sun` is not a unit vector or is normal
            to the plane.
        """
        s = self.settings
        self._propagate(camera, plane.level_direction(unit_vector(sun)), time)
        variance = detections.radius_sigma**2 + (s.relative_radius_sigma * detections.radius) ** 2
        points = self.filter.terrain_points(camera, detections.pixel, s.region)
        split_count = self._split(detections, points, camera, variance)
        projection = self.filter.project_rocks(camera)
        view = _in_view(projection, camera)
        at = np.flatnonzero(view)
        in_view = len(at)
        large = self.filter.count > s.max_full_update_rocks
        self.filter.freeze(~view & large)
        # Resting rocks do not move until they are seen again.
        self._last_positions[~view & large] = np.nan
        d, rock, is_unambiguous, close = self._associate(detections, projection, at, variance)
        # Rocks just added by splitting must not be updated with the same image.
        known = self.filter.count - split_count
        at, is_old = at[at < known], rock < known
        d, rock, is_unambiguous = d[is_old], rock[is_old], is_unambiguous[is_old]
        self.hits[rock] += 1
        use = np.flatnonzero(is_unambiguous)
        use = use[self._consistent_pairs(detections, projection, d[use], rock[use])]
        is_seen_once = self._seen_once[rock[use]]
        second, use = use[is_seen_once], use[~is_seen_once]
        order = use[np.argsort(self.corrected[rock[use]], kind="stable")]
        position_update, radius_only = np.split(
            order, [s.max_position_updates // 2 if large else s.max_position_updates]
        )
        self.filter.update_radii(
            rock[radius_only], detections.radius[d[radius_only]], variance[d[radius_only]],
            s.radius_floor,
        )  # fmt: skip
        a, b = d[position_update], rock[position_update]
        self.corrected[b] = time
        found = self.filter.update_rocks(
            b, projection, detections.pixel[a], detections.independent_covariance[a],
            detections.radius[a], variance[a],
            s.common_pixels, s.radius_floor, s.max_normalised_innovation,
        )  # fmt: skip
        self._reinitialize(rock[second], d[second], detections, camera, variance)
        expected = self._update_existence(rock, at, detections, d, camera, sun, plane)
        self.explained = np.zeros(len(detections), np.bool_)
        self.explained[d] = self._is_confirmed(rock, in_view)
        if not self._passes_monitors(found, expected, time):
            self.renew()
            self.explained[:] = False
        points = self.filter.terrain_points(camera, detections.pixel, s.region)
        least = s.min_landmark_radius if in_view < s.min_rocks_in_view else s.min_radius
        begins = detections.radius >= least
        born = self._start_tracks(~close & begins, detections, points, camera, variance)
        on_terrain = terrain_position_covariance(
            points, detections.pixel_covariance, self.filter, camera
        )
        self._store_tentative(~close & ~born, detections, points, on_terrain, variance)
        self._merge()
        self._drop(np.flatnonzero(self._too_small(in_view) | (self.existence < _MIN_EXISTENCE)))
        return found

    def _is_confirmed(self, rock: IntArray, in_view: int) -> BoolArray:
        """Return which of the given rocks (n,) exist with p > 0.9 and are large enough.

        `rock` (n,) are indices and `in_view` is the number of rocks in view, on which the minimum
        radius depends. The dark patch of a rock below the minimum radius may be the shadow of a
        hazard with a wrong radius.
        """
        s = self.settings
        least = s.min_radius * (1.0 if in_view < s.min_rocks_in_view else _DROP_RADIUS_RATIO)
        return (self.existence[rock] > _ESTABLISHED_EXISTENCE) & (self.filter.radius[rock] >= least)

    def _too_small(self, in_view: int) -> BoolArray:
        """Return which rocks (n,) are too small to be tracked.

        `in_view` is the number of rocks in view; with few, smaller rocks are kept as landmarks.
        """
        s = self.settings
        least = s.min_landmark_radius if in_view < 2 * s.min_rocks_in_view else s.min_radius
        return self.filter.radius < _DROP_RADIUS_RATIO * least

    def _associate(
        self,
        detections: Detections,
        projection: RockProjection,
        candidates: IntArray,
        radius_variance: Array,
    ) -> tuple[IntArray, IntArray, BoolArray, BoolArray]:
        """Assign detections to candidate rocks, given by their indices.

        `projection` is that of all rocks into the image, and `radius_variance` (d,), m^2, that of
        the detected radii. Returns the detections and the rocks of the pairs, whether each pair is
        unambiguous, and which detections (d,) are within the gate of a rock.
        """
        covariance = self.filter.innovation_covariance(projection)[candidates]
        detection, j, is_unambiguous, close = associate(
            detections.pixel, detections.pixel_covariance, detections.radius, radius_variance,
            projection.pixel[candidates], covariance,
            self.filter.radius[candidates], self.filter.radius_variance[candidates],
        )  # fmt: skip
        return detection, candidates[j], is_unambiguous, close

    def _propagate(self, camera: CameraModel, sun: Array, time: float) -> None:
        """Add the process noise since the last image to the filter.

        It covers the errors of shadow model and radius. `sun` (3,) is the direction to the Sun in
        axes of the terrain plane (third axis: its normal); `time` is that of the image, s.
        """
        s = self.settings
        check_time("image.time", time, self._last_time)
        if not np.hypot(*sun[:2]) > 0.0:
            raise InputError(
                "sun", sun, "must not be normal to the terrain",
                "Shadows then have no direction.",
            )  # fmt: skip
        # Under a low Sun, observations are less accurate along it only, so the limit for new rocks
        # scales with the scatter. The error of the shadow model along the Sun grows with the shadow
        # length.
        self._scatter_factor, longer = observation_scatter_factor(sun), shadow_length_ratio(sun)
        if self._time is not None:
            self.filter.add_process_noise(s.radius_wander, time - self._time)
        self._time = time
        along, across, shared = s.view_wander
        self.filter.add_view_noise(
            sun, longer * along, across, longer * shared,
            scale_sigma=longer * s.range_wander, pixel_size=1.0 / np.sqrt(camera.fx * camera.fy),
        )  # fmt: skip

    def count_large_rocks(self, diameter: float, grid: Grid) -> int:
        """Count the tracked rocks on a grid with at least a given diameter (m).

        Only rocks with an existence probability above 0.5 count.
        """
        f = self.filter
        there = (self.existence > 0.5) & (2.0 * f.radius >= diameter)
        return int(np.count_nonzero(there & grid.contains(f.xy)))

    def moved(self) -> tuple[Array, Array]:
        """Return the positions of rocks and their motion since the last call, (n, 2), m.

        The motion is NaN for rocks that were added since.
        """
        stand = self.filter.xy.copy()
        by, self._last_positions = stand - self._last_positions, stand
        return stand, by

    def renew(self) -> None:
        """Drop all rocks, to start again with those visible from the current state."""
        self._drop(np.arange(self.filter.count))
        self.tentative = TentativeRocks.none()
        self.as_expected = True
        self.renewals += 1

    def _passes_monitors(self, found: UpdateOutcome, expected: UpdateOutcome, time: float) -> bool:
        """Update the innovation monitors; return whether the rocks can be kept.

        `found` is the outcome of the position update, and `expected` that of the test whether
        enough of the expected rocks were found. `time` is that of the image, s.
        """
        remedies = [
            self.filter.monitor_image("places", time, found),
            self.filter.monitor_image("expected", time, expected),
        ]
        return RockCorrection.RESET not in remedies

    def _consistent_pairs(
        self,
        detections: Detections,
        projection: RockProjection,
        detection: IntArray,
        rock: IntArray,
    ) -> BoolArray:
        """Return which pairs (p,) have the image offset that most pairs have in common.

        The offset is that of the detection from the predicted pixel of the rock, compared with the
        median over all pairs. `detection` and `rock` (p,) are the indices of the pairs;
        `projection` is that of all rocks into the image. A pose error moves all rocks of an image
        together, so a wrong pair differs from the others even if its gate is wide. With fewer than
        four pairs, all are accepted.
        """
        if len(detection) < 4:
            return np.ones(len(detection), bool)
        off = detections.pixel[detection] - projection.pixel[rock]
        off = off - np.median(off, axis=0)
        own = projection.jacobian_by_rock[rock]
        # Errors of the rocks minus the part common with the lander's position.
        s = detections.independent_covariance[detection] + own @ self.filter.relative_covariance()[
            rock
        ] @ np.swapaxes(own, 1, 2)
        s = s + self.settings.common_pixels**2 * np.eye(2)
        return np.asarray(squared_mahalanobis_2x2(off, s) < _CHI2_2DOF_997)

    def _update_existence(
        self,
        found_rocks: IntArray,
        rocks_in_view: IntArray,
        detections: Detections,
        detection: IntArray,
        camera: CameraModel,
        sun: Array,
        plane: GroundPlane,
    ) -> UpdateOutcome:
        """Update the existence probability of each rock in view by Bayes' rule.

        `found_rocks` are the rocks that were found by the detections `detection`, and
        `rocks_in_view` all rocks in view (indices). `sun` (3,) is the direction towards the Sun,
        ENU, and `plane` the plane on which shadows fall. Returns the outcome of the test whether
        enough of the established rocks were found, with zero degrees of freedom if too few were
        expected.
        """
        odds = self.existence / (1.0 - self.existence)
        false = self.rates.false_positive(detections.q[detection])
        odds[found_rocks] *= np.clip((1.0 - false) / false, 1.0, _MAX_ODDS_FACTOR)
        lost = np.setdiff1d(rocks_in_view, found_rocks)
        camera_position, focal = (
            self.filter.inertial.position,
            float(np.sqrt(camera.fx * camera.fy)),
        )
        azimuth, depression, pixel = viewing_geometry(
            self.filter.xyz[lost], camera_position, focal, sun, plane
        )
        model = model_on_plane(self.model, plane, sun)
        miss = self.rates.false_negative(
            model.visible_q(self.filter.radius[lost], azimuth, depression, pixel)
        )
        # A rock whose shadow merges with another is not missing.
        unit = model.patch(azimuth, depression)
        miss[is_dark_at_patch(self.filter, lost, unit, detections, camera, sun, plane)] = 1.0
        self._established |= (self.existence > _ESTABLISHED_EXISTENCE) & (
            self.hits >= _ESTABLISHED_HITS
        )
        # A few rocks suffice to reject this image; more are needed to reject the map.
        seen_before = (self.existence > _ESTABLISHED_EXISTENCE) & (self.hits > _MIN_PREVIOUS_HITS)
        shown = float(np.count_nonzero(seen_before[found_rocks]))
        hidden = float(((1.0 - miss) * seen_before[lost]).sum())
        if shown + hidden >= _MIN_EXPECTED_ROCKS:
            self.as_expected = shown > _MIN_DETECTED_FRACTION * (shown + hidden)
        found = float(np.count_nonzero(self._established[found_rocks]))
        missed = float(((1.0 - miss) * self._established[lost]).sum())
        odds[lost] *= np.clip(miss, _MIN_MISS_FACTOR, 1.0)
        self.existence = np.clip(odds / (1.0 + odds), 1e-6, 1.0 - 1e-4)
        if found + missed < self.settings.min_expected_rocks:
            return UpdateOutcome(np.nan, 0, False)
        return UpdateOutcome(1.0, 1, found > self.settings.min_found_fraction * (found + missed))

    def _store_tentative(
        self, is_untracked: BoolArray, detections: Detections, points: Array,
        covariance: Array, radius_variance: Array,
    ) -> None:  # fmt: skip
        """Store untracked detections, so that the map does not declare their places clear.

        `is_untracked` (d,) marks the detections, `points` (d, 3) are their positions on the
        terrain, m, with `covariance` (d, 2, 2), m^2. Detections that do not lie on the terrain,
        such as above the horizon, are dropped.
        """
        sigma = np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2))
        kept = (
            is_untracked & np.isfinite(points[:, :2]).all(1) & np.isfinite(sigma + radius_variance)
        )
        self.tentative = TentativeRocks(
            points[kept, :2],
            sigma[kept],
            detections.radius[kept],
            radius_variance[kept],
            1.0 - self.rates.false_positive(detections.q[kept]),
        )

    def _start_tracks(
        self, is_new: BoolArray, detections: Detections, points: Array, camera: CameraModel,
        radius_variance: Array,
    ) -> BoolArray:  # fmt: skip
        """Start tracks from accurate detections without a rock; return which started (d,).

        `is_new` (d,) marks the detections without a rock, `points` (d, 3) are the positions of all
        detections on the terrain, m, and `radius_variance` (d,), m^2, is that of their radii.
        """
        s = self.settings
        # The position error must be a fraction of the distance between rocks.
        spread = terrain_position_sigma(
            points, detections.independent_covariance, self.filter, camera
        )
        sharp = spread < self._max_birth_sigma(detections.radius)
        is_new = is_new & (detections.q >= s.min_birth_q) & sharp
        is_new &= np.isfinite(points).all(1) & np.isfinite(radius_variance)
        is_new &= is_positive_definite_2x2(detections.independent_covariance)
        if s.region is not None:
            west, east, south, north = s.region
            x, y = points[:, :2].T
            is_new = is_new & (x >= west) & (x <= east) & (y >= south) & (y <= north)
        new = np.flatnonzero(is_new)[: max(s.max_rocks - self.filter.count, 0)]
        born = np.zeros(len(detections), bool)
        born[new] = True
        if new.size == 0:
            return born
        self.filter.add(
            camera,
            points[new],
            detections.independent_covariance[new],
            detections.radius[new],
            radius_variance[new],
        )
        real = 1.0 - self.rates.false_positive(detections.q[new])
        self.existence = np.concatenate((self.existence, np.clip(real, 0.1, 0.99)))
        self.hits = np.concatenate((self.hits, np.ones(new.size, np.int64)))
        self.corrected = np.concatenate((self.corrected, np.full(new.size, self._last_time)))
        self._established = np.concatenate((self._established, np.zeros(new.size, bool)))
        self._seen_once = np.concatenate((self._seen_once, np.ones(new.size, bool)))
        self._last_positions = np.concatenate(
            (self._last_positions, np.full((new.size, 2), np.nan))
        )
        return born

    def _max_birth_sigma(self, radius: Array) -> Array:
        """Return the maximum position error of detections that start a track (n,), m.

        `radius` (n,) is the detected radius, m.
        """
        return np.asarray(
            self._scatter_factor * np.maximum(self.settings.max_birth_sigma, radius / 3)
        )

    def _reinitialize(
        self,
        rock: IntArray,
        detection: IntArray,
        detections: Detections,
        camera: CameraModel,
        radius_variance: Array,
    ) -> None:
        """Replace the position of rocks seen once by that of the second observation.

        `rock` and `detection` (m,) are the rocks and their detections; `radius_variance` (d,), m^2,
        is that of all detections. Rocks with an inaccurate second observation keep their position.
        The first position is biased towards the Sun, because only patches that appear large enough
        start a track. Averaging the two positions would appear as a motion of the lander.
        """
        pixel_covariance = detections.independent_covariance[detection]
        points = self.filter.terrain_points(camera, detections.pixel[detection])
        good = np.isfinite(points).all(1) & is_positive_definite_2x2(pixel_covariance)
        good &= np.isfinite(radius_variance[detection]) & (radius_variance[detection] > 0.0)
        # Inaccurate observations are skipped for all rocks alike, without a selection by accuracy.
        sigma = terrain_position_sigma(points, pixel_covariance, self.filter, camera)
        good &= sigma <= _MAX_SIGMA_RATIO * self._max_birth_sigma(detections.radius[detection])
        rock, detection = rock[good], detection[good]
        self.filter.reset_positions(
            rock,
            camera,
            detections.pixel[detection],
            detections.independent_covariance[detection],
            detections.radius[detection],
            radius_variance[detection],
        )
        self._seen_once[rock] = False
        self._last_positions[rock] = np.nan
        self.corrected[rock] = self._last_time

    def _merge(self) -> None:
        """Merge overlapping rocks: delete the rock that was found in fewer images.

        Rocks overlap if the centre of one is well within the other.
        """
        f = self.filter
        if f.count < 2:
            return
        pairs = cKDTree(f.xy).query_pairs(float(f.radius.max()), output_type="ndarray")
        if len(pairs) == 0:
            return
        a, b = pairs.T
        gap = np.hypot(*(f.xy[a] - f.xy[b]).T)
        double = gap < 0.7 * np.maximum(f.radius[a], f.radius[b])
        a, b = a[double], b[double]
        first = (self.hits[a] > self.hits[b]) | (
            (self.hits[a] == self.hits[b]) & (f.radius[a] >= f.radius[b])
        )
        kept, dropped = np.where(first, a, b), np.where(first, b, a)
        # A chain of duplicates keeps its first member.
        dropped = np.setdiff1d(dropped, np.setdiff1d(kept, dropped))
        self._drop(dropped)

    def _split(
        self, detections: Detections, points: Array, camera: CameraModel, radius_variance: Array
    ) -> int:
        """Replace each rock that a sharper image resolves into smaller rocks by these.

        A rock is replaced if at least two detections lie within it, all smaller than 0.6 of its
        radius. `points` (d, 3) are the positions of the detections on the terrain, m, and
        `radius_variance` (d,), m^2, is that of their radii. Returns the number of rocks added,
        which are the last in the filter.
        """
        f = self.filter
        if f.count == 0 or len(detections) < 2:
            return 0
        where = np.nan_to_num(points[:, :2], nan=1e9)
        inside = cKDTree(where).query_ball_point(f.xy, np.maximum(f.radius, 1e-3))
        parts = [
            (j, np.array(k)) for j, k in enumerate(inside)
            if len(k) >= 2 and (detections.radius[k] < 0.6 * f.radius[j]).all()
        ]  # fmt: skip
        if not parts:
            return 0
        born = np.unique(np.concatenate([k for _, k in parts]))
        self._drop(np.array([j for j, _ in parts]))
        is_new = np.zeros(len(detections), bool)
        is_new[born] = True
        return int(self._start_tracks(is_new, detections, points, camera, radius_variance).sum())

    def _drop(self, index: IntArray) -> None:
        """Remove the rocks with the given indices from filter and tracker."""
        if len(index):
            keep = self.filter.remove(index)
            self.existence = self.existence[keep]
            self.hits = self.hits[keep]
            self.corrected = self.corrected[keep]
            self._established = self._established[keep]
            self._seen_once = self._seen_once[keep]
            self._last_positions = self._last_positions[keep]


def _in_view(projection: RockProjection, camera: CameraModel, margin: float = 4.0) -> BoolArray:
    """Return which rocks are in the image, at least `margin` pixels from its edge.

    `projection` is that of the rocks into the image.
    """
    u, v = projection.pixel.T
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (projection.depth > 0.0)
            & (u > margin)
            & (u < camera.width - 1 - margin)
            & (v > margin)
            & (v < camera.height - 1 - margin)
        )
