"""The kinds of navigation that stand on one error state."""

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
from lunarsim.onboard.navigation.aids import LevelGround
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class InertialNavigation:
    """Inertial unit, scans against each other, ranges, speeds and stars: whatever there is."""

    relief: float = quantity(5.0, "deg", ge=0, le=45, help="slopes of the ground flown over")

    needs: ClassVar[tuple[type, ...]] = (InertialSamples,)
    takes: ClassVar[tuple[type, ...]] = (
        LidarScan, AltimeterReading, DopplerReading, AttitudeReading,
    )  # fmt: skip
    uses_prior_map: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_bounds(self, "navigation")

    def build(self, briefing: Briefing) -> Navigator:
        """Return the filter of one flight."""
        state, sigmas = StrapdownState.of(briefing)
        ground = LevelGround.of(briefing, float(np.tan(self.relief)))
        return Navigator(state, sigmas, None, instruments=briefing.instruments, ground=ground)


@dataclass(frozen=True)
class PriorMapNavigation:
    """Inertial unit and LiDAR scans that find their place on a prior map (quadtree paper)."""

    needs: ClassVar[tuple[type, ...]] = (InertialSamples, LidarScan)
    takes: ClassVar[tuple[type, ...]] = (AltimeterReading, DopplerReading, AttitudeReading)
    uses_prior_map: ClassVar[bool] = True

    def build(self, briefing: Briefing) -> Navigator:
        """Return the filter of one flight.

        Raises
        ------
        InputError
            If there is no prior map.
        """
        if briefing.prior_map is None:
            raise InputError("prior_map", None, "a table: this navigation finds its place on it")
        state, sigmas = StrapdownState.of(briefing)
        return Navigator(
            state, sigmas, briefing.prior_map, instruments=briefing.instruments,
            ground=LevelGround.of(briefing, LevelGround().relief),
        )  # fmt: skip


@dataclass(frozen=True)
class RockNavigation:
    """Inertial unit, rocks by their shadows, scans against each other, ranges, speeds, stars."""

    ground_sigma: float = quantity(
        10.0, "m", gt=0, le=1000, help="of the ground's height under the start, 1 sigma"
    )
    relief: float = quantity(6.0, "deg", ge=0, le=45, help="slopes of the ground flown over")

    needs: ClassVar[tuple[type, ...]] = (InertialSamples,)
    takes: ClassVar[tuple[type, ...]] = (
        LidarScan, AltimeterReading, DopplerReading, AttitudeReading,
    )  # fmt: skip
    uses_prior_map: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_bounds(self, "navigation")

    def build(self, briefing: Briefing) -> RockFilter:
        """Return the filter of one flight."""
        state, sigmas = StrapdownState.of(briefing)
        ground = LevelGround(
            float(briefing.target[2]), self.ground_sigma, float(np.tan(self.relief))
        )
        return RockFilter.of(state, sigmas, ground=ground, instruments=briefing.instruments)
