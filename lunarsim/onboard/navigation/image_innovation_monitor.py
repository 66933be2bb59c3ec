"""Monitor whether observations of rocks in camera images agree with the estimate.

Three quantities are monitored: the innovations of rock positions, the detected fraction of the
rocks that are expected in view, and whether the shadows point away from the assumed Sun direction.
"""

from __future__ import annotations

from enum import Enum

from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.innovation_monitor import (
    InnovationMonitor,
    InnovationMonitorSettings,
    MonitorResult,
)

# Errors of rock positions persist over many images, so about 40 innovations count as one. The rocks
# may be reset once; a wrong Sun direction cannot be explained.
_MONITOR_SETTINGS = {
    "places": InnovationMonitorSettings(correlated_count=40.0, max_inflations=2),
    "expected": InnovationMonitorSettings(max_inflations=2),
    "shadows": InnovationMonitorSettings(max_inflations=None, window_s=3.0),
}


class RockCorrection(Enum):
    """Corrective action for the tracked rocks: none, inflate covariance, or reset."""

    NONE = "none"
    INFLATE = "inflate"
    RESET = "reset"


class ImageInnovationMonitor:
    """Monitor of whether rock observations in camera images agree with the estimate.

    Parameters
    ----------
    events
        List that receives the events "covariance-inflated", "rocks-reset", "lost" and "recovered".
    """

    def __init__(self, events: list[NavigationEvent]) -> None:
        self._events = events
        self.monitors = {
            kind: InnovationMonitor(settings) for kind, settings in _MONITOR_SETTINGS.items()
        }
        self._last_alarm = {kind: -float("inf") for kind in _MONITOR_SETTINGS}

    @property
    def lost(self) -> bool:
        """Whether the rock observations contradict the navigation estimate."""
        return any(monitor.lost for monitor in self.monitors.values())

    def record(self, kind: str, time: float, outcome: UpdateOutcome) -> RockCorrection:
        """Add the outcome of a filter update with an image; return the corrective action.

        Parameters
        ----------
        kind
            "places" (rock positions), "expected" (detected fraction of the rocks expected in view)
            or "shadows" (direction of the shadows).
        time
            Time of the image, s.
        outcome
            Outcome of the update.
        """
        monitor = self.monitors[kind]
        before, result = monitor.lost, monitor.record(time, outcome)
        if result is MonitorResult.CONSISTENT:
            if before and not monitor.lost:
                self._add_event(time, "recovered", kind)
            return RockCorrection.NONE
        if result is MonitorResult.LOST:
            if not before:
                self._add_event(time, "lost", kind)
            return RockCorrection.RESET
        # The first alarm inflates the covariance; another one soon after it resets the rocks.
        again = time - self._last_alarm[kind] < 3.0 * monitor.settings.window_s
        self._last_alarm[kind] = time
        self._add_event(time, "rocks-reset" if again else "covariance-inflated", kind)
        return RockCorrection.RESET if again else RockCorrection.INFLATE

    def _add_event(self, time: float, name: str, kind: str) -> None:
        self._events.append(NavigationEvent(time, name, {"measurement": f"rocks' {kind}"}))
