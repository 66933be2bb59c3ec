"""Maps turned once the tilt with which they were drawn is known to have been wrong."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lunarsim.onboard.hazards.mapper import SURE_TILT, HazardMapper
from lunarsim.onboard.navigation.estimate import Navigation


class Levelling:
    """Keeps maps level with the ground as navigation has it.

    Parameters
    ----------
    mappers
        By name.
    navigation
        Tells by what mapped ground has turned.
    """

    def __init__(self, mappers: Mapping[str, HazardMapper], navigation: Navigation) -> None:
        self._mappers, self._navigation = mappers, navigation
        self._levelled = np.eye(3)

    def follow(self, time: float, mass: float) -> None:
        """Turn what was mapped; time (s) and mass (kg) are what an estimate is asked with."""
        found = self._navigation.ground_turn
        if found is None:
            return
        turn, angle = found.since(self._levelled)
        if angle < SURE_TILT:
            return
        self._levelled = found.rotation
        sigma = self._navigation.estimate(time, mass).tilt_sigma
        for mapper in self._mappers.values():
            mapper.level(turn, found.pivot, sigma)
