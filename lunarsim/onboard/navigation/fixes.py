"""Navigation with the position fixes of an external system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lunarsim.frames import SiteToLocal, is_rotation
from lunarsim.messages.briefing import Briefing, InitialStateEstimate
from lunarsim.messages.measurements import InertialSamples, NavigationFix
from lunarsim.onboard.navigation.estimate import Estimate, Navigation, NavigationEvent
from lunarsim.onboard.navigation.measurement_sequencer import MeasurementSequencer
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

    Before the first fix, the estimate is the initial one. A fix is ignored if it is not finite, its
    attitude is not a unit quaternion or a variance is negative. `MeasurementSequencer` rejects
    fixes that are out of order. Navigation is lost if there is no fix for 2 s.

    Parameters
    ----------
    start
        Initial estimate.
    step
        Time between gyroscope samples, if there are any, s.
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

        `time` is the current time, s. Other measurements are ignored.

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
