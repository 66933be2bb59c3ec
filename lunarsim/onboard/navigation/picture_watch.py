"""Whether what pictures show of rocks can still be explained.

Three things are watched: where rocks are seen against where they were expected, how many of those
that should be seen are, and whether shadows fall away from where the Sun is taken to be.
"""

from __future__ import annotations

from enum import Enum

from lunarsim.onboard.navigation.error_state import Outcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.onboard.navigation.watch import Verdict, Watch, WatchSettings

# Errors of rocks' places last over many pictures, so innovations are alike for some 40 of them.
# Rocks may be begun anew once; a Sun that is elsewhere cannot be explained.
_WATCHED = {
    "places": WatchSettings(correlation=40.0, patience=2),
    "expected": WatchSettings(patience=2),
    "shadows": WatchSettings(patience=None, window_s=3.0),
}


class Remedy(Enum):
    """What is to be done about rocks."""

    NONE = "none"
    DOUBT = "doubt"
    RENEW = "renew"


class PictureWatch:
    """Watches pictures, and says when they cannot be believed.

    Parameters
    ----------
    events
        To which "doubted", "renewed", "lost" and "believed" are added.
    """

    def __init__(self, events: list[NavigationEvent]) -> None:
        self._events = events
        self.watches = {kind: Watch(settings) for kind, settings in _WATCHED.items()}
        self._doubted = {kind: -float("inf") for kind in _WATCHED}

    @property
    def lost(self) -> bool:
        """Whether what was seen cannot be explained."""
        return any(watch.lost for watch in self.watches.values())

    def note(self, kind: str, time: float, outcome: Outcome) -> Remedy:
        """Note what came of a picture at a time (s); return what is to be done.

        Parameters
        ----------
        kind
            "places", "expected" or "shadows".
        time
            s.
        outcome
            What came of it.
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
        # First the state may be wider than was thought; what is doubted again soon is begun anew.
        again = time - self._doubted[kind] < 3.0 * watch.settings.window_s
        self._doubted[kind] = time
        self._note(time, "renewed" if again else "doubted", kind)
        return Remedy.RENEW if again else Remedy.DOUBT

    def _note(self, time: float, name: str, kind: str) -> None:
        self._events.append(NavigationEvent(time, name, {"measurement": f"rocks' {kind}"}))
