"""Settings of the navigation kinds that use the error-state filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
    LidarScan,
)
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.terrain_prior import TerrainPrior
from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class InertialNavigation:
    """Settings of navigation with IMU, LiDAR, altimeter, velocimeter and star tracker.

    All sensors but the IMU are optional. Scans are matched with each other and, if there is one,
    with a prior map.
    """

    terrain_slope: float = quantity(
        5.0,
        "deg",
        ge=0,
        le=45,
        help="typical slope of the terrain below the flight path, from which the filter computes "
        "the uncertainty of terrain height",
    )

    needs: ClassVar[tuple[type, ...]] = (InertialSamples,)
    accepts: ClassVar[tuple[type, ...]] = (
        LidarScan, AltimeterReading, DopplerReading, AttitudeReading,
    )  # fmt: skip
    needs_prior_map: ClassVar[bool] = False
    uses_prior_map: ClassVar[bool] = True
    rocks: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_bounds(self, "navigation")

    def build(self, briefing: Briefing) -> Navigator:
        """Return the navigation filter of one flight, built from its briefing."""
        return _navigator(briefing, float(np.tan(self.terrain_slope)), rocks=self.rocks)


@dataclass(frozen=True)
class PriorMapNavigation:
    """Settings of navigation by LiDAR scans matched with a prior map, and the IMU.

    A prior map and a LiDAR are required (quadtree paper).
    """

    needs: ClassVar[tuple[type, ...]] = (InertialSamples, LidarScan)
    accepts: ClassVar[tuple[type, ...]] = (AltimeterReading, DopplerReading, AttitudeReading)
    needs_prior_map: ClassVar[bool] = True
    uses_prior_map: ClassVar[bool] = True

    def build(self, briefing: Briefing) -> Navigator:
        """Return the navigation filter of one flight, built from its briefing.

        Raises
        ------
        InputError
            If there is no prior map.
        """
        if briefing.prior_map is None:
            raise InputError(
                "prior_map", None, "is required for this navigation",
                "Add a table [prior_map], or choose another navigation.kind.", show_value=False,
            )  # fmt: skip
        return _navigator(briefing, TerrainPrior().relief)


@dataclass(frozen=True)
class RockNavigation(InertialNavigation):
    """Settings of inertial navigation that also uses rocks as landmarks.

    The camera detects the rocks by their shadows.
    """

    terrain_slope: float = quantity(
        6.0,
        "deg",
        ge=0,
        le=45,
        help="typical slope of the terrain below the flight path, from which the filter computes "
        "the uncertainty of terrain height",
    )

    rocks: ClassVar[bool] = True


def _navigator(briefing: Briefing, relief: float, *, rocks: bool = False) -> Navigator:
    state, sigmas = StrapdownState.of(briefing)
    return Navigator(
        state, sigmas, briefing.prior_map, instruments=briefing.instruments,
        terrain_prior=TerrainPrior.of(briefing, relief), rocks=rocks,
    )  # fmt: skip
