"""Kinds of navigation: position fixes, and the error-state filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lunarsim.errors import InputError
from lunarsim.frames import SiteToLocal, is_rotation
from lunarsim.messages.briefing import Briefing, InitialStateEstimate
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
    LidarScan,
    NavigationFix,
)
from lunarsim.onboard.navigation.estimate import Estimate, Navigation, NavigationEvent
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.onboard.navigation.measurement_sequencer import MeasurementSequencer
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.value_checks import check_shape

# Maximum age of a fix before navigation is lost, s.
_MAX_FIX_AGE_S = 2.0


@dataclass(frozen=True)
class ExternalFixes:
    """Settings of navigation by position fixes of an external navigation system."""

    needs: ClassVar[tuple[type, ...]] = (NavigationFix,)
    accepts: ClassVar[tuple[type, ...]] = (InertialSamples,)
    needs_prior_map: ClassVar[bool] = False
    uses_prior_map: ClassVar[bool] = False

    def build(self, briefing: Briefing) -> FixNavigation:
        """Return the navigation of one flight, built from its briefing."""
        return FixNavigation(briefing.start, briefing.step)


class FixNavigation(Navigation):
    """Navigation that returns the last fix of an external navigation system.

    A fix is not propagated; the angular rate is that of the last gyroscope sample, if any. Before
    the first fix, the estimate is the initial one. A fix is ignored if it is not finite, its
    attitude is not a unit quaternion or a variance is negative. `MeasurementSequencer` rejects
    fixes that are out of order. Navigation is lost if there is no fix for 2 s.

    Parameters
    ----------
    start
        Initial estimate.
    step
        Time between gyroscope samples, s; without gyroscopes it has no effect.
    """

    has_position_steps: ClassVar[bool] = False

    def __init__(self, start: InitialStateEstimate, step: float) -> None:
        self._step = step
        self._arrivals = MeasurementSequencer(step, self._add_event)
        self._rate = np.zeros(3)
        self.events: list[NavigationEvent] = []
        sigmas = np.repeat([start.position_sigma, start.velocity_sigma, start.attitude_sigma], 3)
        self._fix = NavigationFix(
            0.0, start.position, start.velocity, start.attitude, np.diag(sigmas**2)
        )

    @property
    def is_drifting(self) -> bool:
        """False, since fixes do not drift."""
        return False

    @property
    def site_to_local(self) -> SiteToLocal:
        """The identity: the local frame is the site frame of the fixes."""
        return SiteToLocal()

    def _add_event(self, time: float, name: str, details: dict[str, Any]) -> None:
        self.events.append(NavigationEvent(time, name, details))

    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Store a position fix, or the angular rate measured by the gyroscopes.

        `time` is the current time, s. Other measurements, late ones and invalid fixes are ignored.

        Raises
        ------
        InputError
            If `time` runs backwards, or an array has a wrong shape.
        """
        measurement = self._arrivals.admit(sensor, measurement, time)
        if isinstance(measurement, NavigationFix):
            if _is_valid(measurement):
                self._fix = measurement
        elif isinstance(measurement, InertialSamples):
            angle = measurement.angle[np.isfinite(measurement.angle).all(axis=1)]
            if len(angle):
                self._rate = angle[-1] / self._step

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the last fix as the estimate at `time` (s), with the given mass (kg)."""
        f = self._fix
        lost = time - f.time > _MAX_FIX_AGE_S
        return Estimate(
            time, f.position, f.velocity, f.attitude, self._rate, mass, f.covariance, lost
        )


def _is_valid(fix: NavigationFix) -> bool:
    """Return whether a fix is finite, with a unit quaternion and valid variances.

    An `InputError` is raised if an array has a wrong shape.
    """
    shapes = {"position": (3,), "velocity": (3,), "attitude": (4,), "covariance": (9, 9)}
    for name, shape in shapes.items():
        check_shape(f"fix.{name}", getattr(fix, name), shape)
    finite = all(np.isfinite(getattr(fix, name)).all() for name in shapes)
    return bool(finite and is_rotation(fix.attitude) and (np.diag(fix.covariance) >= 0.0).all())


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
