"""Shadow mapper as a part of a scenario."""

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
    ImageQualityCheck,
    ImageQualitySettings,
    SunConfirmation,
)
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.population import RockExpectation

# Point spread of a camera without a known one, pixels.
_BLUR = ImageQualitySettings().blur_sigma


@dataclass(frozen=True)
class ShadowMapping:
    """Settings of the shadow mapper.

    Attributes
    ----------
    sensor
        Camera whose images are mapped.
    sensors
        Several cameras whose images are mapped, instead of `sensor`.
    posting, size
        Cell size and side of the map, m.
    hazard_diameter
        Minimum diameter of a hazard, m.
    interval
        Time between two evaluations of the map, s.
    look_interval
        Minimum time between two images of a camera whose lit terrain is recorded, s; every image
        corrects the rocks.
    shapes
        Shapes of the shadow model: inferred from the shadows, as the mission expects ("told"), or
        the paper's half spheres.
    ground
        Elevation mapper: rocks stand on its terrain, and shadows fall on its plane; empty:
        horizontal terrain.
    form
        Form of the probability that a rock covers a point, see `cover_probability`.

    Raises
    ------
    InputError
        If a camera is named twice, or `sensor` is not one of `sensors`.
    """

    sensor: str = quantity("camera", help="Camera whose images are mapped")
    sensors: tuple[str, ...] = quantity((), help="Several cameras, instead of sensor")
    posting: float = quantity(0.2, "m", gt=0, help="Cell size of the map")
    size: float = quantity(100.0, "m", gt=0, help="Side of the square map about the target")
    hazard_diameter: float = quantity(0.5, "m", gt=0, lt=4, help="Minimum diameter of a hazard")
    interval: float = quantity(1.0, "s", gt=0, help="Time between two evaluations of the map")
    look_interval: float = quantity(
        0.4, "s", ge=0, le=10, help="Minimum time between images recorded as clear terrain"
    )
    shapes: Literal["inferred", "told", "hemisphere"] = quantity(
        "inferred", help="Rock shapes of the shadow model (paper: hemisphere)"
    )
    ground: str = quantity("", help="Elevation mapper of the terrain; omitted: horizontal terrain")
    form: Literal["rice", "gaussian"] = quantity(
        "rice", help="Form of the cover probability (paper: gaussian)"
    )

    takes: ClassVar[type] = CameraImage
    publishes: ClassVar[type] = RockEvidence
    navigation: ClassVar[type | None] = RockNavigation

    def __post_init__(self) -> None:
        if len(set(self.sensors)) < len(self.sensors):
            raise InputError("sensors", self.sensors, "must name each camera once")
        if self.sensors and self.sensor not in ("camera", *self.sensors):
            raise InputError(
                "sensor", self.sensor, f"must be omitted or one of sensors, {self.sensors}"
            )

    def check_terrain_mapper(self, parts: Mapping[str, Any]) -> None:
        """Check that `ground` names a mapper that publishes elevations.

        Parameters
        ----------
        parts
            All mapper parts by name.

        Raises
        ------
        InputError
            If it does not.
        """
        if not self.ground:
            return
        able = [n for n, p in parts.items() if getattr(p, "publishes", None) is TerrainEvidence]
        if self.ground not in able:
            raise InputError("ground", self.ground, "is unknown", suggestion(self.ground, able))

    def build(
        self,
        briefing: Briefing,
        navigation: Navigation,
        mappers: Mapping[str, HazardMapper] | None = None,
    ) -> ShadowMapper:
        """Return the mapper of one flight.

        Parameters
        ----------
        briefing, navigation
            As for all mappers.
        mappers
            Mappers built before.

        Raises
        ------
        InputError
            If the Sun is too low or too high for shadows, or the map is too small or too coarse.
        """
        if not isinstance(navigation, Navigator) or navigation.rocks is None:
            raise InputError("navigation.kind", type(navigation).__name__, 'must be "rocks"')
        lander = briefing.lander
        grid = map_grid(briefing.target, self.size, self.posting, lander)
        elevation = float(np.arcsin(np.clip(briefing.sun[2], -1.0, 1.0)))
        model = self._model(elevation, briefing.rocks)
        settings = TrackerSettings(
            least_radius=0.42 * self.hazard_diameter,
            landmark_radius=0.2 * self.hazard_diameter,
            region=tracked_region(grid),
        )
        rocks = navigation.rocks
        tracker = RockTracker(rocks, model, settings=settings)
        prior = HazardPrior(briefing.rocks.cover, self.hazard_diameter)
        probability = ProbabilityMap(
            grid, model, prior, terrain_height=rocks.terrain_height_below, form=self.form
        )
        reach = lander.leg_radius + 0.5 * lander.pad_diameter
        proof = SunConfirmation()
        return ShadowMapper(
            tracker, probability, briefing.sun, reach, interval=self.interval,
            look_interval=self.look_interval,
            health={name: _health_of(briefing, name, proof) for name in sensor_names(self)},
            relief=(mappers or {})[self.ground] if self.ground else None,
        )  # fmt: skip

    def _model(self, elevation: float, rocks: RockExpectation) -> ShadowModel | ShapeMixture:
        """Return the shadow model for a Sun elevation, rad."""
        if self.shapes == "inferred":
            return ShapeMixture(elevation, rocks.shape)
        return ShadowModel(elevation, rocks.model() if self.shapes == "told" else None)


def _health_of(briefing: Briefing, camera: str, sun: SunConfirmation) -> ImageQualityCheck:
    """Return the quality check of a camera, with its own point spread."""
    known = briefing.instruments.get(camera)
    blur = known.blur_sigma if isinstance(known, CameraInstrument) else _BLUR
    return ImageQualityCheck(ImageQualitySettings(blur_sigma=blur), sun)
