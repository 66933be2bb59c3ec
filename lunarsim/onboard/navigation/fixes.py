"""Navigation that takes the fixes of another system as they come."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lunarsim.frames import Shift
from lunarsim.messages.briefing import Briefing, StartEstimate
from lunarsim.messages.measurements import InertialSamples, NavigationFix
from lunarsim.onboard.navigation.estimate import Estimate, Navigation, NavigationEvent

# Without a fix for so long nobody knows where the lander is, s.
_LONGEST = 2.0


@dataclass(frozen=True)
class Fixes:
    """Takes the fixes of another system as they come."""

    needs: ClassVar[tuple[type, ...]] = (NavigationFix,)
    takes: ClassVar[tuple[type, ...]] = (InertialSamples,)
    needs_prior_map: ClassVar[bool] = False
    uses_prior_map: ClassVar[bool] = False

    def build(self, briefing: Briefing) -> FixNavigation:
        """Return the navigation of one flight."""
        return FixNavigation(briefing.start, briefing.step)


class FixNavigation(Navigation):
    """The last fix is the estimate; before the first it is the start's.

    A fix that is not finite tells nothing. After 2 s without one it is lost.

    Parameters
    ----------
    start
        Where the descent begins.
    step
        Between samples of gyroscopes, if there are any, s.
    """

    def __init__(self, start: StartEstimate, step: float) -> None:
        self._step = step
        self._rate = np.zeros(3)
        self.events: list[NavigationEvent] = []
        sigmas = np.repeat([start.position_sigma, start.velocity_sigma, start.attitude_sigma], 3)
        self._fix = NavigationFix(
            0.0, start.position, start.velocity, start.attitude, np.diag(sigmas**2)
        )

    @property
    def site_to_local(self) -> Shift:
        """Fixes are of the site frame, and so is the local frame."""
        return Shift()

    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Keep a fix, and the rate of gyroscopes."""
        if isinstance(measurement, NavigationFix):
            whole = (measurement.position, measurement.velocity, measurement.attitude,
                     measurement.covariance)  # fmt: skip
            if all(np.isfinite(part).all() for part in whole):
                self._fix = measurement
        elif isinstance(measurement, InertialSamples):
            self._rate = measurement.angle[-1] / self._step

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the last fix with the given mass (kg)."""
        f = self._fix
        lost = time - f.time > _LONGEST
        return Estimate(
            time, f.position, f.velocity, f.attitude, self._rate, mass, f.covariance, lost
        )
