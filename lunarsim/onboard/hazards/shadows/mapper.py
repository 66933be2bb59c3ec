"""The shadow mapper: pictures in, `HazardMap` out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.measurements import Picture
from lunarsim.models.camera import CameraModel
from lunarsim.models.pose import Pose
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper, is_aside
from lunarsim.onboard.hazards.published import RockEvidence
from lunarsim.onboard.hazards.shadows.blind_regions import (
    blind_regions,
    cell_centres,
    ground_of_cells,
)
from lunarsim.onboard.hazards.shadows.ground_height import height_sigma
from lunarsim.onboard.hazards.shadows.measured_terrain import MeasuredTerrain
from lunarsim.onboard.hazards.shadows.place_errors import position_sigma
from lunarsim.onboard.hazards.shadows.plausible import too_few
from lunarsim.onboard.hazards.shadows.probability_map import (
    ProbabilityMap,
    rock_tracks,
)
from lunarsim.onboard.hazards.shadows.tracker import RockTracker
from lunarsim.onboard.navigation.error_state import Outcome
from lunarsim.onboard.navigation.estimate import Estimate, NavigationEvent
from lunarsim.onboard.navigation.rock_filter import Region
from lunarsim.onboard.perception.along_plane import model_on_plane
from lunarsim.onboard.perception.detector import (
    Detections,
    DetectorSettings,
    detect_rocks,
)
from lunarsim.onboard.perception.direction import turn_from_sun
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.onboard.perception.health import (
    Fault,
    ImageQuality,
    PictureHealth,
)
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.perception.sun_angle import SunAngle
from lunarsim.onboard.perception.sun_direction import unit_vector

Array = NDArray[np.float64]

# Rocks are tracked so far beyond the map, m.
_TRACKING_MARGIN_M = 3.0
# Shadows are compared with the Sun so often, s; even where it is right they point elsewhere by so
# much, rad.
_SUN_CHECK_INTERVAL_S = 0.5
_SHADOW_DIRECTION_SIGMA_RAD = float(np.deg2rad(5.0))
# A map on which nothing is less safe than this calls all of it safe.
_MIN_P_SAFE_WITHOUT_HAZARD = 0.5
# The model of shadows may be made for a Sun so much higher or lower, rad.
_MAX_SUN_ELEVATION_ERROR_RAD = float(np.deg2rad(1.0))


@dataclass
class _CameraState:
    """Who judges the pictures of a camera, why the last did not count, and when one was a look."""

    health: PictureHealth
    fault: Fault | None = None
    recorded_at: float = -np.inf


class ShadowMapper(HazardMapper):
    """Sees rocks by their shadows, tracks them, and maps the probability of hazard.

    Parameters
    ----------
    tracker
        The rocks; its filter is part of the lander's navigation.
    probability
        The map.
    sun
        Direction towards the Sun as the lander believes it (3,), ENU of the site frame.
    footprint
        Radius of the disc into which no rock may reach under the lander, m.
    detector
        What counts as a shadow.
    interval
        Least time between two evaluations of the map, s.
    look_interval
        Least time between two pictures of a camera of which it is noted what ground they show lit,
        s: what others show is nearly the same.
    health
        Judges the pictures of each camera, by the sensor's name; or one that judges all; left out:
        one with default settings.
    relief
        Mapper of elevations on whose ground rocks stand: looks and rocks lie at its heights, and
        shadows along its plane. None: they stand on level ground.

    Attributes
    ----------
    refused
        Pictures that did not count, by why.

    Raises
    ------
    InputError
        If the Sun's direction is no unit vector, or not at the elevation of the tracker's model.
    """

    def __init__(
        self,
        tracker: RockTracker,
        probability: ProbabilityMap,
        sun: Array,
        footprint: float,
        *,
        detector: DetectorSettings | None = None,
        interval: float = 1.0,
        look_interval: float = 0.0,
        health: PictureHealth | Mapping[str, PictureHealth] | None = None,
        relief: HazardMapper | None = None,
    ) -> None:
        _check_sun(sun, tracker.model.elevation)
        self.tracker = tracker
        self.probability = probability
        self.grid = probability.grid
        self.sun = np.asarray(sun, dtype=np.float64)
        self.footprint = footprint
        self.interval, self.look_interval = interval, look_interval
        self._terrain = MeasuredTerrain(relief)
        tracker.filter.measured = None if relief is None else self._terrain
        self.detector = detector or DetectorSettings()
        checks = dict(health) if isinstance(health, Mapping) else {"": health or PictureHealth()}
        self._cameras = {name: _CameraState(one) for name, one in checks.items()}
        self._camera = next(iter(self._cameras))
        self.refused: Counter[Fault] = Counter()
        self.seen: Detections | None = None
        self._map = HazardMap.unobserved(self.grid)
        # Of rocks that are not tracked; None: something was noted since it was worked out.
        self._residual: Array | None = None
        self._displayed: tuple[HazardMap, np.float32, HazardMap] | None = None
        self._map_time = -np.inf
        self._time = -np.inf
        self._sun_check_time = -np.inf
        self._renewals = 0
        # What was last told of the whole map, an event's name; empty: nothing.
        self._reported_event = ""

    @property
    def health(self) -> PictureHealth:
        """That of the camera whose picture was the last."""
        return self._cameras[self._camera].health

    def take(self, sensor: str, measurement: Picture, estimate: Estimate) -> None:
        """Take in one picture of a named camera, see `update`.

        Several cameras stamp their pictures each by itself: one that was taken before the last of
        another's is left out, and reported as "out-of-order".
        """
        if sensor in self._cameras:
            self._camera = sensor
        if len(self._cameras) > 1 and measurement.time < self._time:
            details = {"sensor": sensor, "stamp": measurement.time, "last": self._time}
            self.tracker.filter.events.append(NavigationEvent(self._time, "out-of-order", details))
            return
        self.update(measurement, estimate)

    def update(self, measurement: Picture, estimate: Estimate) -> None:
        """Take in one picture, seen from the estimated pose, if it counts.

        One that does not, see `PictureHealth`, changes nothing but `refused`, and is reported:
        "picture-refused" when pictures begin to fail for a reason, "picture-accepted" when they
        count again.

        Raises
        ------
        InputError
            If time runs backwards.
        """
        image, rocks = measurement, self.tracker.filter
        if not image.time >= self._time:
            raise InputError(
                "picture.time", image.time,
                f"at least {self._time} s: time does not run backwards",
            )  # fmt: skip
        self._time = image.time
        self.refresh(image.time)
        health = self.health.before_detection(image.counts, image.camera, estimate)
        if health.good:
            sun = rocks.in_frame(self.sun)
            seen = detect_rocks(
                image.counts, image.camera, estimate, sun,
                ground=self._ground(image.camera), model=self.tracker.model,
                settings=self.detector,
            )  # fmt: skip
            was_confirmed = self.health.sun.seen
            health = self._check_shadows(seen, image, estimate, sun, health)
            if was_confirmed and not self.health.sun.seen:
                # What was looked at under another Sun may be anything.
                self.probability.forget()
                self._residual = None
        if health.good and not self._process_image(seen, image, sun):
            health = ImageQuality(Fault.MISPLACED, health.figures)
        self._report(image.time, health)

    def refresh(self, time: float) -> None:
        """Lay rocks on ground that was measured since last asked, be there a picture or none.

        Ground that cannot be the one under them is reported: "measured-ground-refused".
        """
        if not self._terrain.has_changed():
            return
        rocks = self.tracker.filter
        outcome = rocks.lay_on_measured()
        if outcome.degrees and not outcome.taken:
            details = {"rocks": outcome.degrees, "nis": outcome.nis}
            rocks.events.append(NavigationEvent(time, "measured-ground-refused", details))

    def _process_image(self, seen: Detections, image: Picture, sun: Array) -> bool:
        """Take in what a picture shows; return whether it shows the rocks that are there.

        If not, it is another's or an older one, or rocks and lander are not where they are taken to
        be: the rocks are told, and clear ground is none.
        """
        self.seen, self._residual = seen, None
        if isinstance(self.tracker.model, ShapeMixture):
            self.tracker.model.learn(seen.shapes, seen.q)
        plane = self._terrain.plane() or LEVEL
        is_recorded = (
            image.time >= self._cameras[self._camera].recorded_at + self.look_interval - 1e-9
        )
        blind = self._blind_pixels(seen, image, sun, plane) if is_recorded else None
        self.tracker.update(seen, image.camera, sun, image.time, plane)
        self._forget_lost_rocks()
        self.probability.follow(*self.tracker.moved())
        if not self.tracker.as_expected:
            return False
        self.probability.ground = self._height_in_view(image.camera)
        if blind is not None:
            self._record_visible_terrain(seen.hiding(blind), image, sun, plane)
        return True

    def _record_visible_terrain(
        self, seen: Detections, image: Picture, sun: Array, plane: GroundPlane
    ) -> None:
        """Note what ground a picture shows lit."""
        self._cameras[self._camera].recorded_at = image.time
        # From where the lander stands by what the rocks told: they moved with it.
        rocks = self.tracker.filter
        self.probability.see(
            image.camera.view(rocks.inertial), sun, seen, rocks.ground_at,
            self.tracker.explained, self._place_sigma, plane, self._height_sigma,
            self.health.settings.blur_sigma,
        )  # fmt: skip

    def _blind_pixels(
        self, seen: Detections, image: Picture, sun: Array, plane: GroundPlane
    ) -> NDArray[np.bool_]:
        """Return in which pixels (height, width) of a picture nothing would show."""
        camera, rocks = image.camera, self.tracker.filter
        points = rocks.ground_points(camera, cell_centres(camera.width, camera.height))
        sharpness, area = ground_of_cells(
            camera, points, rocks.inertial.position, sun, plane, self.tracker.model
        )
        counts = np.asarray(image.counts)
        return blind_regions(counts, seen, sharpness, area, self.probability.prior.cover)

    def _place_sigma(self, xy: Array) -> Array:
        """Return how well places (n, 2) are known from the lander, 1 sigma an axis (n,), m."""
        return position_sigma(self.tracker.filter, xy, self.tracker.settings.least_radius)

    def _height_sigma(self, xy: Array) -> Array:
        """Return what the ground's height errs by at points (n, 2), 1 sigma (n,), m.

        How well the rocks tell it matters where nobody else has measured it.
        """
        sigma = np.zeros(len(xy))
        unknown = np.isnan(self._terrain.heights(xy))
        if unknown.any():
            sigma[unknown] = height_sigma(self.tracker.filter, xy[unknown])
        return sigma

    def _forget_lost_rocks(self) -> None:
        """Take back what was seen if rocks that were mapped there are no longer tracked."""
        if self.tracker.renewals > self._renewals:
            self._renewals = self.tracker.renewals
            self.probability.forget()
            self._residual = None

    def _check_shadows(
        self, seen: Detections, image: Picture, pose: Pose, sun: Array, previous: ImageQuality
    ) -> ImageQuality:
        """Judge a picture by its shadows, and the Sun by where they fall."""
        rocks = self.tracker.filter
        noise = previous.figures["noise"]
        turn = self._shadow_direction_error(seen, image.camera, pose, sun, noise)
        after = self.health.after_detection(seen, turn, noise)
        if self.health.judges(turn) and image.time >= self._sun_check_time + _SUN_CHECK_INTERVAL_S:
            self._sun_check_time = image.time
            nis = turn.angle**2 / (turn.sigma**2 + _SHADOW_DIRECTION_SIGMA_RAD**2)
            is_sun_in_place = after.fault is not Fault.SUN_ELSEWHERE
            rocks.judge("shadows", image.time, Outcome(nis, 1, is_sun_in_place))
        return ImageQuality(after.fault, previous.figures | after.figures)

    def _shadow_direction_error(
        self, seen: Detections, camera: CameraModel, pose: Pose, sun: Array, noise: float
    ) -> SunAngle:
        """Measure by what angle shadows fall beside where the Sun should throw them."""
        view, model, plane = camera.view(pose), self.tracker.model, self._terrain.plane()
        if plane is None:
            points = self.tracker.filter.ground_points(camera, seen.pixel)
            return turn_from_sun(seen, view, points, sun, model, noise)
        points = np.column_stack((seen.ground, np.zeros(len(seen))))
        return turn_from_sun(
            seen,
            plane.view(view),
            points,
            plane.direction(sun),
            model_on_plane(model, plane, sun),
            noise,
        )

    def _ground(self, camera: CameraModel) -> float | GroundPlane:
        """Return the ground on which rocks are read: as it was measured, or a level plane."""
        plane = self._terrain.plane()
        return self._height_in_view(camera) if plane is None else plane

    def _report(self, time: float, health: ImageQuality) -> None:
        """Count pictures that do not count, and say when that begins and ends."""
        state = self._cameras[self._camera]
        fault, previous, state.fault = health.fault, state.fault, health.fault
        if fault is not None:
            self.refused[fault] += 1
        if fault is previous:
            return
        details: dict[str, Any] = {"refused": self.refused.total()}
        if len(self._cameras) > 1:
            details["camera"] = self._camera
        name = "picture-accepted"
        if fault is not None:
            name = "picture-refused"
            details |= {"why": fault.value, "alarm": health.alarm}
            details |= {k: v for k, v in health.figures.items() if np.isfinite(v)}
        self.tracker.filter.events.append(NavigationEvent(time, name, details))

    def _height_in_view(self, camera: CameraModel) -> float:
        """Return the height of the ground in the middle of the image, m."""
        rocks = self.tracker.filter
        middle = np.array([[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]])
        height = float(rocks.ground_points(camera, middle)[0, 2])
        return height if np.isfinite(height) else rocks.ground

    def hazard_map(self) -> HazardMap:
        """Return the map, at most `interval` seconds old.

        Where shadows do not fall away from the Sun nothing is known of any rock.
        """
        if self.tracker.filter.pictures.watches["shadows"].lost:
            return self._with_flat_elevation(HazardMap.unobserved(self.grid))
        self._forget_lost_rocks()
        if not self.blank and self._time >= self._map_time + self.interval - 1e-9:
            self.probability.follow(*self.tracker.moved())
            self._residual = self.probability.residual(self.footprint)
            drawn = self.probability.hazard_map(self.tracker, self.footprint, self._residual)
            self._map, self._map_time = self._with_plausibility(drawn), self._time
        return self._with_flat_elevation(self._map)

    def evidence(self) -> RockEvidence | None:
        """Return what pictures say of rocks; None where they say nothing.

        Of a map that cannot be believed, see `_plausible`, rocks count and clear ground does not.
        """
        drawn = self.hazard_map()
        if self.blank or self.tracker.filter.pictures.watches["shadows"].lost:
            return None
        ratio = self.probability.ratios()
        if drawn.in_domain is not None and not drawn.in_domain.any():
            ratio = np.maximum(ratio, np.float32(1.0))
        if self._residual is None:
            self._residual = self.probability.residual(self.footprint)
        return RockEvidence(
            drawn, self.probability.evidence.tested, ratio, rock_tracks(self.tracker),
            partial(self.probability.clear_of, footprint=self.footprint),
            self._residual.astype(np.float32), self.probability.expected_rocks(),
        )  # fmt: skip

    def _with_plausibility(self, drawn: HazardMap) -> HazardMap:
        """Return a map that says whether it can be believed, and report where all of it is safe.

        Where far fewer rocks were found than ground like this should have, either it has fewer or
        they do not show: `in_domain` is then false everywhere.
        """
        prior = self.probability.prior
        expected = self.probability.expected_rocks()
        found = int(self.tracker.large_rocks(prior.least_diameter, self.grid))
        is_too_few = too_few(found, expected)
        unsafe = drawn.observed & (drawn.p_safe < _MIN_P_SAFE_WITHOUT_HAZARD)
        all_safe = bool(drawn.observed.any() and not unsafe.any())
        name = "few-rocks" if is_too_few else "all-safe" if all_safe else ""
        if name and name != self._reported_event:
            area = float(np.count_nonzero(drawn.observed)) * self.grid.posting**2
            details = {"observed_m2": area, "rocks": found, "expected": expected}
            self.tracker.filter.events.append(NavigationEvent(self._time, name, details))
        self._reported_event = name
        return replace(drawn, in_domain=np.zeros_like(drawn.observed)) if is_too_few else drawn

    def ground_height(self, xy: Array) -> float:
        """Return the local height of the ground at a point (2,), measured or by the rocks, m."""
        return float(self.tracker.filter.ground_at(xy)[0])

    def recentre(self, centre: Array) -> None:
        """Lay the map about another point (3,), local frame, m.

        Rocks that lie off it are tracked as before; no more of them are begun.
        """
        if not (self.blank or is_aside(self.grid, centre)):
            return
        self.probability.recentre(centre)
        self.grid, self._residual = self.probability.grid, None
        tracker = self.tracker
        tracker.settings = replace(tracker.settings, region=tracked_region(self.grid))
        self._map, self._map_time = HazardMap.unobserved(self.grid), -np.inf

    def _with_flat_elevation(self, drawn: HazardMap) -> HazardMap:
        """Return a map with level ground where its middle now lies in the local frame."""
        middle = np.array([np.mean(self.grid.x), np.mean(self.grid.y)])
        height = np.float32(self.ground_height(middle))
        if (
            self._displayed is None
            or self._displayed[0] is not drawn
            or self._displayed[1] != height
        ):
            level = np.full(self.grid.shape, height, np.float32)
            self._displayed = drawn, height, replace(drawn, elevation=level)
        return self._displayed[2]

    @property
    def blank(self) -> bool:
        """Whether no picture has counted yet."""
        return self.seen is None

    def tables(self) -> dict[str, dict[str, Array]]:
        """Return the rocks tracked: centres, radii (m) and existence."""
        f = self.tracker.filter
        return {
            "rocks": {
                "x": f.xy[:, 0].copy(), "y": f.xy[:, 1].copy(), "radius": f.radius.copy(),
                "existence": self.tracker.existence.copy(),
            }
        }  # fmt: skip


def tracked_region(grid: Grid) -> Region:
    """Return the west, east, south and north limits of where rocks are tracked for a map, m."""
    west, east, south, north = grid.extent
    return (
        west - _TRACKING_MARGIN_M,
        east + _TRACKING_MARGIN_M,
        south - _TRACKING_MARGIN_M,
        north + _TRACKING_MARGIN_M,
    )


def _check_sun(sun: ArrayLike, elevation: float) -> None:
    """Refuse a Sun that is not where the model of shadows has it."""
    direction = unit_vector(sun)
    if not abs(float(np.arcsin(direction[2])) - elevation) < _MAX_SUN_ELEVATION_ERROR_RAD:
        raise InputError(
            "sun", sun, f"a direction {np.rad2deg(elevation):.1f} deg high, as the model of shadows"
        )
