"""Navigation that takes the fixes of another system as they come."""

from __future__ import annotations

from typing import Any

from lunarsim.messages.measurements import NavigationFix
from lunarsim.onboard.navigation.estimate import Estimate, NavigationEvent


class FixNavigation:
    """The last fix is the estimate."""

    def __init__(self) -> None:
        self.events: list[NavigationEvent] = []
        self._fix: NavigationFix | None = None

    def take(self, measurement: Any, time: float) -> None:
        """Keep a fix; other measurements tell nothing."""
        if isinstance(measurement, NavigationFix):
            self._fix = measurement

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the last fix with the given mass (kg)."""
        fix = self._fix
        if fix is None:
            raise RuntimeError("no fix has come in yet")
        return Estimate(
            time, fix.position, fix.velocity, fix.attitude, fix.rate, mass, fix.covariance
        )
