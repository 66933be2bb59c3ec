"""Settings of the shadow mapper, which a scenario selects by its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from lunarsim.errors import InputError, suggestion
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import CameraImage
from lunarsim.models.instruments import CameraInstrument
from lunarsim.onboard.hazards.map_evidence import RockEvidence, TerrainEvidence
from lunarsim.onboard.hazards.mapper import HazardMapper, map_grid, sensor_names
from lunarsim.onboard.hazards.shadows.mapper import ShadowMapper, tracked_region
from lunarsim.onboard.hazards.shadows.probability_map import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows.tracker import RockTracker
from lunarsim.onboard.hazards.shadows.tracker_settings import TrackerSettings
from lunarsim.onboard.navigation.estimate import Navigation
from lunarsim.onboard.navigation.navigation_kinds import RockNavigation
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.perception.image_quality import (
    DEFAULT_BLUR_SIGMA,
    ImageQualityCheck,
    SunConfirmation,
)
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.population import RockExpectation


@dataclass(frozen=True)
class ShadowMapping:
    """Settings of a hazard mapper that detects rocks by their shadows.

    Attributes
    ----------
    sensor
        Camera whose images are mapped.
    sensors
        Several cameras whose images are mapped, instead of `sensor`.
    posting, size
        Cell size and side of the map, m.
    min_hazard_diameter
        Minimum diameter of a hazard, m.
    interval
        Time between two evaluations of the map, s.
    clear_terrain_interval
        Minimum time between two images of a camera from which clear terrain is recorded, s. Every
        image updates the tracked rocks.
    shapes
        Rock shapes of the shadow model: ``"inferred"`` from the shadows, ``"expected"`` by the
        mission, or ``"hemisphere"`` as in the paper.
    terrain_mapper
        Name of an elevation mapper: rocks stand on its terrain, and shadows fall on its plane;
        empty: horizontal terrain.
    cover_model
        Model of the probability that the outline of a rock contains a point, as in
        `cover_probability`: ``"rice"`` or ``"gaussian"``.

    Raises
    ------
    InputError
        If a camera is named twice, or if `sensors` is given and `sensor` is neither one of them nor
        the default.
    """

    sensor: str = quantity("camera", help="Name of the camera whose images are mapped")
    sensors: tuple[str, ...] = quantity(
        (),
        help="Names of the cameras whose images are mapped, if there are several; empty: only the "
        "camera given by the key sensor",
    )
    posting: float = quantity(0.2, "m", gt=0, help="Cell size of the map")
    size: float = quantity(100.0, "m", gt=0, help="Side of the square map centred on the target")
    min_hazard_diameter: float = quantity(
        0.5, "m", gt=0, lt=4, help="Minimum diameter at which a rock counts as a hazard"
    )
    interval: float = quantity(1.0, "s", gt=0, help="Minimum time between two updates of the map")
    clear_terrain_interval: float = quantity(
        0.4,
        "s",
        ge=0,
        le=10,
        help="Minimum time between two images of a camera that are used to mark terrain as free of "
        "rocks; every image is used to track rocks",
    )
    shapes: Literal["inferred", "expected", "hemisphere"] = quantity(
        "inferred",
        help="Rock shapes that the shadow model assumes: inferred (from the shadows), expected "
        "(those of the table expected_rocks) or hemisphere",
    )
    terrain_mapper: str = quantity(
        "",
        help="Name of the mapper that measures the terrain on which rocks stand and shadows fall; "
        "omitted: the terrain is assumed to be horizontal",
    )
    cover_model: Literal["rice", "gaussian"] = quantity(
        "rice",
        help="Distribution of the distance between a point and a rock's true centre, for the "
        "probability that the rock covers the point: rice (exact for round rocks) or gaussian "
        "(approximation of the shadow EKF paper)",
    )

    accepts: ClassVar[type] = CameraImage
    publishes: ClassVar[type] = RockEvidence
    navigation: ClassVar[type | None] = RockNavigation

    def __post_init__(self) -> None:
        if len(set(self.sensors)) < len(self.sensors):
            raise InputError("sensors", self.sensors, "must name each camera once")
        if self.sensors and self.sensor not in ("camera", *self.sensors):
            raise InputError(
                "sensor", self.sensor, "must be omitted or name one of the cameras in sensors"
            )

    def check_terrain_mapper(self, parts: Mapping[str, Any]) -> None:
        """Raise InputError if `terrain_mapper` is not a mapper that provides elevations.

        An empty `terrain_mapper` is valid.

        Parameters
        ----------
        parts
            Settings of all mappers by name.

        Raises
        ------
        InputError
            If no mapper has this name or it does not provide elevations.
        """
        if not self.terrain_mapper:
            return
        able = [n for n, p in parts.items() if getattr(p, "publishes", None) is TerrainEvidence]
        if self.terrain_mapper not in able:
            raise InputError(
                "terrain_mapper",
                self.terrain_mapper,
                "must name a mapper that provides elevations",
                suggestion(self.terrain_mapper, able),
            )

    def build(
        self,
        briefing: Briefing,
        navigation: Navigation,
        mappers: Mapping[str, HazardMapper] | None = None,
    ) -> ShadowMapper:
        """Build the shadow mapper of one flight.

        Parameters
        ----------
        briefing, navigation
            Data known before the flight, and the navigation filter, which must estimate rocks.
        mappers
            Mappers that were built before, by name; `terrain_mapper` must be among them.

        Raises
        ------
        InputError
            If the navigation filter does not estimate rocks, the Sun is too low or too high for
            shadows, or the map is too small or too coarse.
        """
        if not isinstance(navigation, Navigator) or navigation.rocks is None:
            raise InputError(
                "navigation.kind", type(navigation),
                "must be 'rocks' if a mapper is of kind 'shadow'", show_value=False,
            )  # fmt: skip
        lander = briefing.lander
        grid = map_grid(briefing.target, self.size, self.posting, lander)
        elevation = float(np.arcsin(np.clip(briefing.sun[2], -1.0, 1.0)))
        model = self._model(elevation, briefing.rocks)
        settings = TrackerSettings(
            min_radius=0.42 * self.min_hazard_diameter,
            min_landmark_radius=0.2 * self.min_hazard_diameter,
            region=tracked_region(grid),
        )
        rocks = navigation.rocks
        tracker = RockTracker(rocks, model, settings=settings)
        prior = HazardPrior(briefing.rocks.cover, self.min_hazard_diameter)
        probability = ProbabilityMap(
            grid, model, prior, terrain_height=rocks.terrain_height_below, form=self.cover_model
        )
        reach = lander.leg_radius + 0.5 * lander.pad_diameter
        proof = SunConfirmation()
        return ShadowMapper(
            tracker, probability, briefing.sun, reach, interval=self.interval,
            clear_terrain_interval=self.clear_terrain_interval,
            health={name: _health_of(briefing, name, proof) for name in sensor_names(self)},
            terrain_mapper=(mappers or {})[self.terrain_mapper] if self.terrain_mapper else None,
        )  # fmt: skip

    def _model(self, elevation: float, rocks: RockExpectation) -> ShadowModel | ShapeMixture:
        """Return the shadow model for a Sun elevation (rad) and the expected rocks."""
        if self.shapes == "inferred":
            return ShapeMixture(elevation, rocks.shape)
        return ShadowModel(elevation, rocks.model() if self.shapes == "expected" else None)


def _health_of(briefing: Briefing, camera: str, sun: SunConfirmation) -> ImageQualityCheck:
    """Return the image quality check of a camera, with its point spread.

    `camera` is the name of the sensor; `sun` is the confirmation of the Sun direction, shared by
    all cameras.
    """
    known = briefing.instruments.get(camera)
    blur = known.blur_sigma if isinstance(known, CameraInstrument) else DEFAULT_BLUR_SIGMA
    return ImageQualityCheck(blur, sun)
