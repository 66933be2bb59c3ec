"""The shadow mapper as a scenario chooses it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from lunarsim.errors import InputError, suggestion
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import Picture
from lunarsim.models.instruments import CameraInstrument
from lunarsim.onboard.hazards.mapper import HazardMapper, map_grid, sensors_of
from lunarsim.onboard.hazards.published import ReliefEvidence, RockEvidence
from lunarsim.onboard.hazards.shadows.mapper import ShadowMapper, tracked_region
from lunarsim.onboard.hazards.shadows.probability_map import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows.tracker import RockTracker
from lunarsim.onboard.hazards.shadows.tracker_settings import TrackerSettings
from lunarsim.onboard.navigation.estimate import Navigation
from lunarsim.onboard.navigation.kinds import RockNavigation
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.perception.health import HealthSettings, PictureHealth, SunConfirmation
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.population import RockExpectation

# Point spread of a camera of which nothing is known, pixels.
_BLUR = HealthSettings().blur_sigma


@dataclass(frozen=True)
class ShadowMapping:
    """Rocks by their shadows, tracked, as a map of the probability of hazard.

    Attributes
    ----------
    sensor
        Whose pictures it maps.
    sensors
        Names of several cameras whose pictures it maps, in place of `sensor`.
    posting, size
        Of the map, m.
    hazard_diameter
        Least diameter of a hazard, m.
    interval
        Between two evaluations of the map, s.
    look_interval
        Least time between two pictures of a camera of which it is noted what ground they show lit,
        s; each corrects the rocks.
    shapes
        Of the rocks by which shadows are read: inferred from them, as the mission expects them, or
        the paper's half spheres.
    ground
        Name of a mapper of elevations: rocks stand on the ground that it maps, and shadows are
        measured along its plane; empty: level ground.
    form
        Of the probability that a tracked rock covers a place, see `cover_probability`.

    Raises
    ------
    InputError
        If a camera is named twice, or `sensor` is none of several.
    """

    sensor: str = quantity("camera", help="whose pictures it maps")
    sensors: tuple[str, ...] = quantity((), help="several cameras, in place of sensor")
    posting: float = quantity(0.2, "m", gt=0, help="side of a cell of the map")
    size: float = quantity(100.0, "m", gt=0, help="side of the square about the target")
    hazard_diameter: float = quantity(0.5, "m", gt=0, lt=4, help="least diameter of a hazard")
    interval: float = quantity(1.0, "s", gt=0, help="between two evaluations of the map")
    look_interval: float = quantity(
        0.4, "s", ge=0, le=10, help="least time between pictures that tell of clear ground"
    )
    shapes: Literal["inferred", "told", "hemisphere"] = quantity(
        "inferred", help="rocks by which shadows are read; the paper's are half spheres"
    )
    ground: str = quantity(
        "", help="mapper of elevations whose ground rocks stand on; left out: level ground"
    )
    form: Literal["rice", "gaussian"] = quantity(
        "rice", help="of the probability that a rock covers a place; the paper's is gaussian"
    )

    takes: ClassVar[type] = Picture
    publishes: ClassVar[type] = RockEvidence
    navigation: ClassVar[type | None] = RockNavigation

    def __post_init__(self) -> None:
        if len(set(self.sensors)) < len(self.sensors):
            raise InputError("sensors", self.sensors, "each camera once")
        if self.sensors and self.sensor not in ("camera", *self.sensors):
            raise InputError("sensor", self.sensor, f"left out, or one of sensors, {self.sensors}")

    def check_ground(self, parts: Mapping[str, Any]) -> None:
        """Refuse a mapper of the ground that there is not, or that publishes no elevations.

        Parameters
        ----------
        parts
            Those of all mappers, by name.

        Raises
        ------
        InputError
            Naming the field.
        """
        if not self.ground:
            return
        able = [n for n, p in parts.items() if getattr(p, "publishes", None) is ReliefEvidence]
        if self.ground not in able:
            raise InputError("ground", self.ground, suggestion(self.ground, able))

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
            Those that were built before.

        Raises
        ------
        InputError
            If the Sun is too low or too high for shadows, or the map too small or too coarse.
        """
        if not isinstance(navigation, Navigator) or navigation.rocks is None:
            raise InputError("navigation.kind", type(navigation).__name__, "rocks")
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
        probability = ProbabilityMap(grid, model, prior, ground=rocks.ground, form=self.form)
        reach = lander.leg_radius + 0.5 * lander.pad_diameter
        proof = SunConfirmation()
        return ShadowMapper(
            tracker, probability, briefing.sun, reach, interval=self.interval,
            look_interval=self.look_interval,
            health={name: _health_of(briefing, name, proof) for name in sensors_of(self)},
            relief=(mappers or {})[self.ground] if self.ground else None,
        )  # fmt: skip

    def _model(self, elevation: float, rocks: RockExpectation) -> ShadowModel | ShapeMixture:
        """Return what shadows are read by, the Sun at an elevation, rad."""
        if self.shapes == "inferred":
            return ShapeMixture(elevation, rocks.shape)
        return ShadowModel(elevation, rocks.model() if self.shapes == "told" else None)


def _health_of(briefing: Briefing, camera: str, sun: SunConfirmation) -> PictureHealth:
    """Return what judges the pictures of a camera, by its own point spread."""
    known = briefing.instruments.get(camera)
    blur = known.blur_sigma if isinstance(known, CameraInstrument) else _BLUR
    return PictureHealth(HealthSettings(blur_sigma=blur), sun)
