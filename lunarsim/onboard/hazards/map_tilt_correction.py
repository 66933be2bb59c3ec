"""Rotation of maps that were built with a wrong tilt estimate, and of which scans."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lunarsim.onboard.hazards.mapper import NEGLIGIBLE_TILT_RAD, HazardMapper
from lunarsim.onboard.navigation.estimate import Navigation
from lunarsim.typing import Array


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


class UnleveledScans:
    """Decide which scans must be rotated when navigation corrects the tilt estimate.

    These are all scans before the first scan whose tilt is known to `NEGLIGIBLE_TILT_RAD`. They
    share one tilt error; later scans are placed correctly.
    """

    def __init__(self) -> None:
        self._open = True

    def includes(self, tilt_sigma: float) -> bool:
        """Return whether a scan with this tilt uncertainty must be rotated later.

        After the first scan with a known tilt, the result is False for all scans.

        Parameters
        ----------
        tilt_sigma
            Standard deviation of the tilt, rad; NaN if unknown.
        """
        return not self.is_tilt_known(tilt_sigma) and self._open

    def is_tilt_known(self, tilt_sigma: float) -> bool:
        """Return whether the tilt is known, so that rotated scans become final.

        If it is, `includes` returns False for all later scans.

        Parameters
        ----------
        tilt_sigma
            Standard deviation of the tilt, rad; NaN if unknown.
        """
        is_known = tilt_sigma <= NEGLIGIBLE_TILT_RAD
        self._open = self._open and not is_known
        return is_known


def rotate_about(points: Array, turn: Array, pivot: Array) -> Array:
    """Rotate points (..., 3), m, about a pivot (3,) by the rotation matrix `turn`."""
    return np.asarray((points - pivot) @ turn.T + pivot)
