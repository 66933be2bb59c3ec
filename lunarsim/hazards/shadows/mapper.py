"""The shadow mapper: pictures in, `HazardMap` out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.hazards.hazard_map import HazardMap
from lunarsim.hazards.shadows.detector import Detections, DetectorSettings, detect_rocks
from lunarsim.hazards.shadows.probability_map import ProbabilityMap
from lunarsim.hazards.shadows.tracker import RockTracker
from lunarsim.navigation.estimate import Estimate
from lunarsim.sensors.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shot:
    """A picture with the camera that took it.

    Attributes
    ----------
    time
        s.
    counts
        What the camera's converter gave (height, width).
    camera
        With the mount as the gimbal's encoders tell.
    """

    time: float
    counts: NDArray[Any]
    camera: Camera


class ShadowMapper:
    """Sees rocks by their shadows, tracks them, and maps the probability of hazard.

    Parameters
    ----------
    tracker
        The rocks; its filter is also the lander's navigation.
    probability
        The map.
    sun
        Direction towards the Sun as the lander believes it (3,), ENU.
    footprint
        Radius of the disc into which no rock may reach under the lander, m.
    detector
        What counts as a shadow.
    refresh
        Least time between two evaluations of the map, s.
    """

    def __init__(
        self,
        tracker: RockTracker,
        probability: ProbabilityMap,
        sun: Array,
        footprint: float,
        *,
        detector: DetectorSettings | None = None,
        refresh: float = 1.0,
    ) -> None:
        self.tracker = tracker
        self.probability = probability
        self.grid = probability.grid
        self.sun = np.asarray(sun, dtype=np.float64)
        self.footprint = footprint
        self.refresh = refresh
        self.detector = detector or DetectorSettings()
        self.seen: Detections | None = None
        self._map = HazardMap.unobserved(self.grid)
        self._mapped = -np.inf
        self._time = -np.inf

    def update(self, measurement: Shot, estimate: Estimate) -> None:
        """Take in one picture, seen from the estimated pose."""
        shot = measurement
        ground = self.tracker.filter.ground
        self.seen = detect_rocks(
            shot.counts, shot.camera, estimate, self.sun,
            ground=ground, model=self.tracker.model, settings=self.detector,
        )  # fmt: skip
        view = shot.camera.view(estimate)
        self.tracker.update(self.seen, shot.camera, self.sun, shot.time)
        self.probability.see(shot.camera, view, self.sun, self.seen)
        self._time = shot.time

    def hazard_map(self) -> HazardMap:
        """Return the map, at most `refresh` seconds old."""
        if self._time >= self._mapped + self.refresh - 1e-9 or (
            self._time > self._mapped == -np.inf
        ):
            self._map = self.probability.hazard_map(self.tracker, self.footprint)
            self._mapped = self._time
        return self._map
