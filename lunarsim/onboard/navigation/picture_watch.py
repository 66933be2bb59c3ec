"""Monitor whether observations of rocks in camera images agree with the estimate.

Three quantities are monitored: the innovations of rock positions, the detected fraction of the
rocks that are expected in view, and whether the shadows point away from the assumed Sun direction.
"""

from __future__ import annotations

from enum import Enum

from lunarsim.onboard.navigation.error_state import Outcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.innovation_monitor import Verdict, Watch, WatchSettings

# Errors of rock positions persist over many images, so about 40 innovations count as one. The rocks
# may be reset once; a wrong Sun direction cannot be explained.
_WATCHED = {
    "places": WatchSettings(correlation=40.0, patience=2),
    "expected": WatchSettings(patience=2),
    "shadows": WatchSettings(patience=None, window_s=3.0),
}


class Remedy(Enum):
    """Corrective action for the tracked rocks."""

    NONE = "none"
    DOUBT = "doubt"
    RENEW = "renew"


class PictureWatch:
    """Monitor the rock observations of camera images.

    Parameters
    ----------
    events
        List that receives the events "doubted", "renewed", "lost" and "believed".
    """

    def __init__(self, events: list[NavigationEvent]) -> None:
        self._events = events
        self.watches = {kind: Watch(settings) for kind, settings in _WATCHED.items()}
        self._doubted = {kind: -float("inf") for kind in _WATCHED}

    @property
    def lost(self) -> bool:
        """Whether the observations contradict the estimate."""
        return any(watch.lost for watch in self.watches.values())

    def note(self, kind: str, time: float, outcome: Outcome) -> Remedy:
        """Add the outcome of an image; return the corrective action.

        Parameters
        ----------
        kind
            "places", "expected" or "shadows".
        time
            s.
        outcome
            Outcome of the update.
        """
        watch = self.watches[kind]
        before, verdict = watch.lost, watch.note(time, outcome)
        if verdict is Verdict.WELL:
            if before and not watch.lost:
                self._note(time, "believed", kind)
            return Remedy.NONE
        if verdict is Verdict.LOST:
            if not before:
                self._note(time, "lost", kind)
            return Remedy.RENEW
        # The first alarm inflates the covariance; another one soon after it resets the rocks.
        again = time - self._doubted[kind] < 3.0 * watch.settings.window_s
        self._doubted[kind] = time
        self._note(time, "renewed" if again else "doubted", kind)
        return Remedy.RENEW if again else Remedy.DOUBT

    def _note(self, time: float, name: str, kind: str) -> None:
        self._events.append(NavigationEvent(time, name, {"measurement": f"rocks' {kind}"}))
