"""Rotation of maps that were built with a wrong tilt estimate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lunarsim.onboard.hazards.mapper import NEGLIGIBLE_TILT_RAD, HazardMapper
from lunarsim.onboard.navigation.estimate import Navigation


class MapTiltCorrection:
    """Rotate maps when navigation corrects the tilt with which they were built.

    Parameters
    ----------
    mappers
        Mappers by name.
    navigation
        Estimates the rotation of the mapped terrain.
    """

    def __init__(self, mappers: Mapping[str, HazardMapper], navigation: Navigation) -> None:
        self._mappers, self._navigation = mappers, navigation
        self._applied_rotation = np.eye(3)

    def follow(self, time: float, mass: float) -> None:
        """Rotate the maps by the tilt correction since the last call.

        Parameters
        ----------
        time, mass
            Time (s) and mass (kg) passed to the navigation estimate.
        """
        rotation = self._navigation.ground_turn
        if rotation is None:
            return
        turn, angle = rotation.since(self._applied_rotation)
        if angle < NEGLIGIBLE_TILT_RAD:
            return
        self._applied_rotation = rotation.rotation
        sigma = self._navigation.estimate(time, mass).tilt_sigma
        for mapper in self._mappers.values():
            mapper.level(turn, rotation.pivot, sigma)
