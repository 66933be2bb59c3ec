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
        Navigation filter, which estimates by how much the mapped terrain must be rotated.
    """

    def __init__(self, mappers: Mapping[str, HazardMapper], navigation: Navigation) -> None:
        self._mappers, self._navigation = mappers, navigation
        self._applied_rotation = np.eye(3)

    def apply(self, time: float, mass: float) -> None:
        """Rotate all maps by the change of the tilt estimate since the last rotation.

        Nothing happens if the navigation filter estimates no rotation, or if the angle is less than
        `NEGLIGIBLE_TILT_RAD`.

        Parameters
        ----------
        time, mass
            Current time (s) and mass (kg), which the navigation filter needs for its estimate.
        """
        rotation = self._navigation.map_rotation
        if rotation is None:
            return
        turn, angle = rotation.rotation_since(self._applied_rotation)
        if angle < NEGLIGIBLE_TILT_RAD:
            return
        self._applied_rotation = rotation.rotation
        sigma = self._navigation.estimate(time, mass).tilt_sigma
        for mapper in self._mappers.values():
            mapper.correct_tilt(turn, rotation.pivot, sigma)
