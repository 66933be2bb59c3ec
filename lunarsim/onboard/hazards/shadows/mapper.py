"""Shadow mapper: computes a `HazardMap` from camera images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.measurements import CameraImage
from lunarsim.models.camera import CameraModel
from lunarsim.models.pose import Pose
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.map_evidence import RockEvidence
from lunarsim.onboard.hazards.mapper import HazardMapper, is_off_centre
from lunarsim.onboard.hazards.shadows.association import is_rock_count_too_low
from lunarsim.onboard.hazards.shadows.probability_map import (
    ProbabilityMap,
    rock_tracks,
)
from lunarsim.onboard.hazards.shadows.terrain_errors import (
    MeasuredTerrain,
    height_sigma,
    position_sigma,
)
from lunarsim.onboard.hazards.shadows.tracker import RockTracker
from lunarsim.onboard.hazards.shadows.viewing_geometry import (
    blind_regions,
    cell_centres,
    sharpness_and_area_of_cells,
)
from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.estimate import Estimate, NavigationEvent
from lunarsim.onboard.navigation.rock_filter import MapRegion
from lunarsim.onboard.perception.detector import (
    Detections,
    detect_rocks,
)
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.onboard.perception.image_quality import (
    ImageQuality,
    ImageQualityCheck,
    ImageRejection,
)
from lunarsim.onboard.perception.plane_models import model_on_plane
from lunarsim.onboard.perception.shadow_direction import measure_shadow_angle
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.perception.sun_angle import SunAngle
from lunarsim.onboard.perception.sun_direction import unit_vector
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import check_time

# Margin around the map within which rocks are tracked, m.
_TRACKING_MARGIN_M = 3.0
# Minimum interval between two updates of the Sun monitor, s, and systematic error of the shadow
# direction, rad.
_SUN_CHECK_INTERVAL_S = 0.5
_SHADOW_DIRECTION_SIGMA_RAD = float(np.deg2rad(5.0))
# If no observed cell has p_safe below this value, the map shows no hazard.
_MIN_P_SAFE_WITHOUT_HAZARD = 0.5
# Maximum difference of Sun elevation between the shadow model and the Sun direction, rad.
_MAX_SUN_ELEVATION_ERROR_RAD = float(np.deg2rad(1.0))


@dataclass
class _CameraState:
    """Image quality check of one camera, its last fault and its last recorded image.

    Attributes
    ----------
    health
        Quality check of the images.
    fault
        Reason for rejecting the last image; None: it was accepted.
    recorded_at
        Time of the last image from which clear terrain was recorded, s.
    """

    health: ImageQualityCheck
    fault: ImageRejection | None = None
    recorded_at: float = -np.inf


class ShadowMapper(HazardMapper):
    """Hazard mapper that detects and tracks rocks by their shadows in camera images.

    Parameters
    ----------
    tracker
        Rock tracker; its filter is part of the navigation filter.
    probability
        Map of the hazard probability from tracked and undetected rocks.
    sun
        Assumed direction towards the Sun (3,), ENU of the site frame.
    footprint
        Radius of the disc under the lander that must be free of rocks, m.
    interval
        Minimum time between two evaluations of the map, s.
    clear_terrain_interval
        Minimum time between two images of a camera from which clear terrain is recorded, s.
    health
        Image quality checks by sensor name, or one for all cameras; default: one for the default
        point spread.
    terrain_mapper
        Elevation mapper whose terrain is used: rocks stand at its heights and shadows fall on its
        plane. None: horizontal terrain.

    Attributes
    ----------
    rejected_images
        Number of rejected images by fault.

    Raises
    ------
    InputError
        If the Sun direction is not a unit vector, or its elevation differs from that of the model.
    """

    def __init__(
        self,
        tracker: RockTracker,
        probability: ProbabilityMap,
        sun: Array,
        footprint: float,
        *,
        interval: float = 1.0,
        clear_terrain_interval: float = 0.0,
        health: ImageQualityCheck | Mapping[str, ImageQualityCheck] | None = None,
        terrain_mapper: HazardMapper | None = None,
    ) -> None:
        _check_sun(sun, tracker.model.elevation)
        self.tracker = tracker
        self.probability = probability
        self.grid = probability.grid
        self.sun = np.asarray(sun, dtype=np.float64)
        self.footprint = footprint
        self.interval, self.clear_terrain_interval = interval, clear_terrain_interval
        self._terrain = MeasuredTerrain(terrain_mapper)
        tracker.filter.measured_terrain = None if terrain_mapper is None else self._terrain
        checks = (
            dict(health) if isinstance(health, Mapping) else {"": health or ImageQualityCheck()}
        )
        self._cameras = {name: _CameraState(one) for name, one in checks.items()}
        self._camera = next(iter(self._cameras))
        self.rejected_images: Counter[ImageRejection] = Counter()
        self.seen: Detections | None = None
        self._map = HazardMap.unobserved(self.grid)
        # Probability of untracked rocks; None if it must be computed again.
        self._residual: Array | None = None
        self._displayed: tuple[HazardMap, np.float32, HazardMap] | None = None
        self._map_time = -np.inf
        self._time = -np.inf
        self._sun_check_time = -np.inf
        self._renewals = 0
        # Name of the last event about the complete map; empty for none.
        self._reported_event = ""

    @property
    def health(self) -> ImageQualityCheck:
        """Image quality check of the camera that took the last image."""
        return self._cameras[self._camera].health

    def update_from_sensor(self, sensor: str, measurement: CameraImage, estimate: Estimate) -> None:
        """Process one image of a named camera.

        With several cameras, an image taken before the last one of another camera is dropped and
        reported as the event "out-of-order".
        """
        if sensor in self._cameras:
            self._camera = sensor
        if len(self._cameras) > 1 and measurement.time < self._time:
            details = {"sensor": sensor, "stamp": measurement.time, "last": self._time}
            self.tracker.filter.events.append(NavigationEvent(self._time, "out-of-order", details))
            return
        self.update(measurement, estimate)

    def update(self, measurement: CameraImage, estimate: Estimate) -> None:
        """Process one image taken at the estimated pose, if it passes the quality check.

        A rejected image changes only the count `rejected_images`. The event "image-rejected" is
        recorded when images start to fail for a reason, "image-accepted" when they pass again.

        Raises
        ------
        InputError
            If the image is older than the last one.
        """
        image, rocks = measurement, self.tracker.filter
        check_time("image.time", image.time, self._time)
        self._time = image.time
        self.refresh(image.time)
        health = self.health.before_detection(image.counts, image.camera, estimate)
        if health.good:
            sun = rocks.rotate_to_local(self.sun)
            detections = detect_rocks(
                image.counts, image.camera, estimate, sun,
                terrain=self._detection_plane(image.camera), model=self.tracker.model,
            )  # fmt: skip
            was_confirmed = self.health.sun.confirmed
            health = self._check_shadows(detections, image, estimate, sun, health)
            if was_confirmed and not self.health.sun.confirmed:
                # Terrain evaluated with a wrong Sun direction cannot be trusted.
                self.probability.forget()
                self._residual = None
        if health.good and not self._process_image(detections, image, sun):
            health = ImageQuality(ImageRejection.MISPLACED, health.metrics)
        self._report(image.time, health)

    def refresh(self, time: float) -> None:
        """Move rocks to the measured terrain if it has changed since the last call.

        `time` is the current time, s. Terrain that does not fit the rocks is reported as the event
        "measured-terrain-rejected".
        """
        if not self._terrain.has_changed():
            return
        rocks = self.tracker.filter
        outcome = rocks.correct_heights_by_terrain()
        if outcome.dof and not outcome.is_accepted:
            details = {"rocks": outcome.dof, "nis": outcome.nis}
            rocks.events.append(NavigationEvent(time, "measured-terrain-rejected", details))

    def _process_image(self, detections: Detections, image: CameraImage, sun: Array) -> bool:
        """Update tracker and map with an accepted image; return whether its rocks fit.

        If the image does not show the tracked rocks, it belongs to another place or time, or rocks
        and lander are not where they are estimated. The tracker is then updated, but no terrain is
        recorded as clear. `sun` (3,) is the direction towards the Sun, ENU.
        """
        self.seen, self._residual = detections, None
        if isinstance(self.tracker.model, ShapeMixture):
            self.tracker.model.update_fractions(detections.shapes, detections.q)
        plane = self._terrain.plane() or LEVEL
        is_recorded = (
            image.time
            >= self._cameras[self._camera].recorded_at + self.clear_terrain_interval - 1e-9
        )
        blind = self._blind_pixels(detections, image, sun, plane) if is_recorded else None
        self.tracker.update(detections, image.camera, sun, image.time, plane)
        self._forget_lost_rocks()
        self.probability.move_with_rocks(*self.tracker.moved())
        if not self.tracker.as_expected:
            return False
        self.probability.terrain_height = self._height_in_view(image.camera)
        if blind is not None:
            self._record_visible_terrain(detections.with_invalid(blind), image, sun, plane)
        return True

    def _record_visible_terrain(
        self, detections: Detections, image: CameraImage, sun: Array, plane: GroundPlane
    ) -> None:
        """Record the terrain that an image shows lit and therefore without rocks.

        `sun` (3,) is the direction towards the Sun, ENU, and `plane` the plane on which shadows
        fall.
        """
        self._cameras[self._camera].recorded_at = image.time
        # The pose is the one corrected by the rocks, which moved with it.
        rocks = self.tracker.filter
        self.probability.add_image(
            image.camera.view(rocks.inertial), sun, detections, rocks.terrain_height_at,
            self.tracker.explained, self._place_sigma, plane, self._height_sigma,
            self.health.blur_sigma,
        )  # fmt: skip

    def _blind_pixels(
        self, detections: Detections, image: CameraImage, sun: Array, plane: GroundPlane
    ) -> BoolArray:
        """Return the pixels in which rocks would not be visible (height, width).

        `sun` (3,) is the direction towards the Sun, ENU, and `plane` the plane on which shadows
        fall.
        """
        camera, rocks = image.camera, self.tracker.filter
        points = rocks.terrain_points(camera, cell_centres(camera.width, camera.height))
        sharpness, area = sharpness_and_area_of_cells(
            camera, points, rocks.inertial.position, sun, plane, self.tracker.model
        )
        counts = np.asarray(image.counts)
        return blind_regions(counts, detections, sharpness, area, self.probability.prior.cover)

    def _place_sigma(self, xy: Array) -> Array:
        """Return the error of positions (n, 2) relative to the lander (n,), m.

        The error is 1 sigma per axis.
        """
        return position_sigma(self.tracker.filter, xy, self.tracker.settings.min_radius)

    def _height_sigma(self, xy: Array) -> Array:
        """Return the error of the terrain height at points (n, 2), 1 sigma (n,), m.

        Where the terrain is measured, the error is 0; elsewhere it follows from the tracked rocks.
        """
        sigma = np.zeros(len(xy))
        unknown = np.isnan(self._terrain.heights(xy))
        if unknown.any():
            sigma[unknown] = height_sigma(self.tracker.filter, xy[unknown])
        return sigma

    def _forget_lost_rocks(self) -> None:
        """Discard terrain recorded as clear of rocks if the tracker has dropped all rocks.

        Recorded terrain moves with the tracked rocks, so its position is unknown without them.
        Nothing happens if they have not been dropped since the last call.
        """
        if self.tracker.renewals > self._renewals:
            self._renewals = self.tracker.renewals
            self.probability.forget()
            self._residual = None

    def _check_shadows(
        self,
        detections: Detections,
        image: CameraImage,
        pose: Pose,
        sun: Array,
        previous: ImageQuality,
    ) -> ImageQuality:
        """Check an image by its shadows, and the Sun direction by the shadow directions.

        `sun` (3,) is the assumed direction towards the Sun, ENU, and `previous` the result of the
        check before detection.
        """
        rocks = self.tracker.filter
        noise = previous.metrics["noise"]
        turn = self._shadow_direction_error(detections, image.camera, pose, sun, noise)
        after = self.health.after_detection(detections, turn, noise)
        if (
            self.health.is_conclusive(turn)
            and image.time >= self._sun_check_time + _SUN_CHECK_INTERVAL_S
        ):
            self._sun_check_time = image.time
            nis = turn.angle**2 / (turn.sigma**2 + _SHADOW_DIRECTION_SIGMA_RAD**2)
            is_sun_in_place = after.fault is not ImageRejection.SUN_ELSEWHERE
            rocks.monitor_image("shadows", image.time, UpdateOutcome(nis, 1, is_sun_in_place))
        return ImageQuality(after.fault, previous.metrics | after.metrics)

    def _shadow_direction_error(
        self,
        detections: Detections,
        camera: CameraModel,
        pose: Pose,
        sun: Array,
        pixel_noise: float,
    ) -> SunAngle:
        """Measure the angle between shadows and their direction under the assumed Sun.

        `sun` (3,) is the assumed direction, ENU; `pixel_noise` is the noise of a pixel as a
        fraction of the brightness of lit terrain.
        """
        view, model, plane = camera.view(pose), self.tracker.model, self._terrain.plane()
        if plane is None:
            points = self.tracker.filter.terrain_points(camera, detections.pixel)
            return measure_shadow_angle(detections, view, points, sun, model, pixel_noise)
        points = np.column_stack((detections.terrain_xy, np.zeros(len(detections))))
        return measure_shadow_angle(
            detections,
            plane.level_view(view),
            points,
            plane.level_direction(sun),
            model_on_plane(model, plane, sun),
            pixel_noise,
        )

    def _detection_plane(self, camera: CameraModel) -> float | GroundPlane:
        """Return the terrain for detection: the measured plane or a horizontal height, m."""
        plane = self._terrain.plane()
        return self._height_in_view(camera) if plane is None else plane

    def _report(self, time: float, health: ImageQuality) -> None:
        """Count a rejected image, and record an event when the reason changes.

        `health` is the result of the quality check and `time` that of the image, s. An event is
        also recorded when images are accepted again.
        """
        state = self._cameras[self._camera]
        fault, previous, state.fault = health.fault, state.fault, health.fault
        if fault is not None:
            self.rejected_images[fault] += 1
        if fault is previous:
            return
        details: dict[str, Any] = {"rejected_images": self.rejected_images.total()}
        if len(self._cameras) > 1:
            details["camera"] = self._camera
        name = "image-accepted"
        if fault is not None:
            name = "image-rejected"
            details |= {"reason": fault.value, "alarm": health.alarm}
            details |= {k: v for k, v in health.metrics.items() if np.isfinite(v)}
        self.tracker.filter.events.append(NavigationEvent(time, name, details))

    def _height_in_view(self, camera: CameraModel) -> float:
        """Return the terrain height at the centre of the image, local frame, m.

        If the centre does not show terrain, it is the terrain height below the lander.
        """
        rocks = self.tracker.filter
        middle = np.array([[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]])
        height = float(rocks.terrain_points(camera, middle)[0, 2])
        return height if np.isfinite(height) else rocks.terrain_height_below

    def hazard_map(self) -> HazardMap:
        """Return the hazard map, recomputed if it is older than `interval`.

        While shadows contradict the Sun direction, the map is unobserved.
        """
        if self.tracker.filter.image_monitor.monitors["shadows"].lost:
            return self._with_flat_elevation(HazardMap.unobserved(self.grid))
        self._forget_lost_rocks()
        if not self.is_empty and self._time >= self._map_time + self.interval - 1e-9:
            self.probability.move_with_rocks(*self.tracker.moved())
            self._residual = self.probability.untracked_rock_probability(self.footprint)
            hazard_map = self.probability.hazard_map(self.tracker, self.footprint, self._residual)
            self._map, self._map_time = self._with_plausibility(hazard_map), self._time
        return self._with_flat_elevation(self._map)

    def evidence(self) -> RockEvidence | None:
        """Return tracked and expected undetected rocks, for fusion; None without images.

        The result is also None while shadows contradict the Sun direction. If the map has
        implausibly few rocks, tracked rocks still count but clear terrain does not.
        """
        hazard_map = self.hazard_map()
        if self.is_empty or self.tracker.filter.image_monitor.monitors["shadows"].lost:
            return None
        ratio = self.probability.untracked_rock_ratios()
        if hazard_map.in_domain is not None and not hazard_map.in_domain.any():
            ratio = np.maximum(ratio, np.float32(1.0))
        if self._residual is None:
            self._residual = self.probability.untracked_rock_probability(self.footprint)
        return RockEvidence(
            hazard_map, self.probability.evidence.size_class_diameters, ratio,
            rock_tracks(self.tracker),
            partial(self.probability.clear_of, footprint=self.footprint),
            self._residual.astype(np.float32), self.probability.expected_rocks(),
        )  # fmt: skip

    def _with_plausibility(self, hazard_map: HazardMap) -> HazardMap:
        """Mark a map with too few rocks as uncalibrated, and report maps without hazards.

        If far fewer rocks were found than the prior predicts, either the terrain has fewer, or they
        are not detected. `in_domain` is then false everywhere.
        """
        prior = self.probability.prior
        expected = self.probability.expected_rocks()
        found = int(self.tracker.count_large_rocks(prior.min_diameter, self.grid))
        is_too_few = is_rock_count_too_low(found, expected)
        unsafe = hazard_map.observed & (hazard_map.p_safe < _MIN_P_SAFE_WITHOUT_HAZARD)
        all_safe = bool(hazard_map.observed.any() and not unsafe.any())
        name = "too-few-rocks" if is_too_few else "no-hazard-found" if all_safe else ""
        if name and name != self._reported_event:
            area = float(np.count_nonzero(hazard_map.observed)) * self.grid.posting**2
            details = {"observed_m2": area, "rocks": found, "expected": expected}
            self.tracker.filter.events.append(NavigationEvent(self._time, name, details))
        self._reported_event = name
        return (
            replace(hazard_map, in_domain=np.zeros_like(hazard_map.observed))
            if is_too_few
            else hazard_map
        )

    def terrain_height(self, xy: Array) -> float:
        """Return the terrain height at a point (2,), local frame, m.

        The height is measured by the elevation mapper or interpolated between tracked rocks.
        """
        return float(self.tracker.filter.terrain_height_at(xy)[0])

    def recentre(self, centre: Array) -> None:
        """Move the map to another centre (3,), local frame, m, if it is too far from it.

        An empty map is always moved. Rocks outside the moved map remain tracked, but no rocks are
        added there.
        """
        if not (self.is_empty or is_off_centre(self.grid, centre)):
            return
        self.probability.recentre(centre)
        self.grid, self._residual = self.probability.grid, None
        tracker = self.tracker
        tracker.settings = replace(tracker.settings, region=tracked_region(self.grid))
        self._map, self._map_time = HazardMap.unobserved(self.grid), -np.inf

    def _with_flat_elevation(self, hazard_map: HazardMap) -> HazardMap:
        """Return a map whose elevation is the terrain height at its centre everywhere."""
        middle = np.array([np.mean(self.grid.x), np.mean(self.grid.y)])
        height = np.float32(self.terrain_height(middle))
        if (
            self._displayed is None
            or self._displayed[0] is not hazard_map
            or self._displayed[1] != height
        ):
            level = np.full(self.grid.shape, height, np.float32)
            self._displayed = hazard_map, height, replace(hazard_map, elevation=level)
        return self._displayed[2]

    @property
    def is_empty(self) -> bool:
        """Whether no image has been accepted yet."""
        return self.seen is None

    def record_tables(self) -> dict[str, dict[str, Array]]:
        """Return the tracked rocks as a table: centres and radii, m, and existence."""
        f = self.tracker.filter
        return {
            "rocks": {
                "x": f.xy[:, 0].copy(), "y": f.xy[:, 1].copy(), "radius": f.radius.copy(),
                "existence": self.tracker.existence.copy(),
            }
        }  # fmt: skip


def tracked_region(grid: Grid) -> MapRegion:
    """Return the area in which rocks are tracked: the map with a margin.

    The result is west, east, south and north, m.
    """
    west, east, south, north = grid.extent
    return (
        west - _TRACKING_MARGIN_M,
        east + _TRACKING_MARGIN_M,
        south - _TRACKING_MARGIN_M,
        north + _TRACKING_MARGIN_M,
    )


def _check_sun(sun: ArrayLike, elevation: float) -> None:
    """Raise InputError if the Sun elevation differs from that of the shadow model.

    `sun` (3,) is the direction towards the Sun, a unit vector, and `elevation` the Sun elevation of
    the model, rad. A difference below 1 deg is accepted.
    """
    direction = unit_vector(sun)
    given = float(np.arcsin(direction[2]))
    if not abs(given - elevation) < _MAX_SUN_ELEVATION_ERROR_RAD:
        raise InputError(
            "sun", sun,
            f"must have the elevation of the shadow model, {np.rad2deg(elevation):.2f} deg, "
            f"not {np.rad2deg(given):.2f} deg", show_value=False,
        )  # fmt: skip
