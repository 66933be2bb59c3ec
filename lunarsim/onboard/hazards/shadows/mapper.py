"""The shadow mapper: pictures in, `HazardMap` out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.measurements import Picture
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.hazards.shadows.probability_map import ProbabilityMap
from lunarsim.onboard.hazards.shadows.tracker import RockTracker
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.perception.detector import Detections, DetectorSettings, detect_rocks

Array = NDArray[np.float64]


class ShadowMapper(HazardMapper):
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
        self.interval = refresh
        self.detector = detector or DetectorSettings()
        self.seen: Detections | None = None
        self._map = HazardMap.unobserved(self.grid)
        self._mapped = -np.inf
        self._time = -np.inf

    def update(self, measurement: Picture, estimate: Estimate) -> None:
        """Take in one picture, seen from the estimated pose."""
        picture = measurement
        ground = self.tracker.filter.ground
        self.seen = detect_rocks(
            picture.counts, picture.camera, estimate, self.sun,
            ground=ground, model=self.tracker.model, settings=self.detector,
        )  # fmt: skip
        view = picture.camera.view(estimate)
        self.tracker.update(self.seen, picture.camera, self.sun, picture.time)
        self.probability.see(picture.camera, view, self.sun, self.seen)
        self._time = picture.time

    def hazard_map(self) -> HazardMap:
        """Return the map, at most `refresh` seconds old."""
        if self._time >= self._mapped + self.interval - 1e-9 or (
            self._time > self._mapped == -np.inf
        ):
            self._map = self.probability.hazard_map(self.tracker, self.footprint)
            self._mapped = self._time
        return self._map

    @property
    def blank(self) -> bool:
        """Whether no picture was taken yet."""
        return self.seen is None
