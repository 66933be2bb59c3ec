"""Whether a filter still believes what it measures, and when it must say that it is lost.

A filter that is wrong refuses what is right. Each kind of measurement is watched over a window: its
share of refusals, and the mean of its normalised innovations, which is 1 while the filter errs as
it says. Where they are not what chance allows the gate opens by widening the state once; where
that does not help either, something is wrong that the filter cannot explain.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum

from scipy.stats import chi2

from lunarsim.onboard.navigation.error_state import Outcome


class Verdict(Enum):
    """What a watch has seen."""

    WELL = "well"
    WIDEN = "widen"
    LOST = "lost"


@dataclass(frozen=True)
class WatchSettings:
    """When measurements are doubted.

    Attributes
    ----------
    window_s
        Over which they are watched, s.
    least
        Fewest measurements by which to judge.
    most_refused
        Greatest share of them that may be refused.
    chance
        Of a filter that errs as it says to be doubted for its innovations.
    correlation
        Measurements are taken for this many times fewer: errors that last longer than a cycle make
        innovations alike.
    patience
        Widenings of one kind within three windows after which the filter is lost.
    """

    window_s: float = 2.0
    least: int = 6
    most_refused: float = 0.5
    chance: float = 1e-6
    correlation: float = 4.0
    patience: int = 3


@dataclass
class Watch:
    """Watches one kind of measurement.

    Attributes
    ----------
    settings
        When it is doubted.
    lost
        Whether it has not been explained for good.
    excess
        Mean normalised innovation squared a degree of freedom of the last window judged.
    total, degrees
        Of all measurements taken: sum of their normalised innovations squared and of their degrees
        of freedom.
    refused
        How many were not.
    """

    settings: WatchSettings = field(default_factory=WatchSettings)
    lost: bool = False
    excess: float = 1.0
    total: float = 0.0
    degrees: int = 0
    refused: int = 0
    _seen: deque[tuple[float, Outcome]] = field(default_factory=deque)
    _widened: deque[float] = field(default_factory=deque)

    def note(self, time: float, outcome: Outcome) -> Verdict:
        """Note what came of a measurement at a time (s), and judge the window.

        What told nothing (a `nis` of NaN) is not counted.
        """
        if outcome.degrees == 0 or not outcome.nis >= 0.0:
            return Verdict.WELL
        s = self.settings
        if outcome.taken:
            self.total, self.degrees = self.total + outcome.nis, self.degrees + outcome.degrees
        else:
            self.refused += 1
        self._seen.append((time, outcome))
        while self._seen[0][0] < time - s.window_s:
            self._seen.popleft()
        while self._widened and self._widened[0] < time - 3.0 * s.window_s:
            self._widened.popleft()
        if len(self._seen) < s.least or not self._doubtful():
            if self.lost and not self._widened:
                self.lost = False
            return Verdict.WELL
        self._seen.clear()
        self._widened.append(time)
        if len(self._widened) > s.patience:
            self.lost = True
            return Verdict.LOST
        return Verdict.WIDEN

    def _doubtful(self) -> bool:
        s = self.settings
        every = [o for _, o in self._seen]
        self.excess = sum(o.nis for o in every) / sum(o.degrees for o in every)
        refused = sum(not o.taken for _, o in self._seen)
        if refused > s.most_refused * len(self._seen):
            return True
        taken = [o for _, o in self._seen if o.taken]
        degrees = sum(o.degrees for o in taken) / s.correlation
        total = sum(o.nis for o in taken) / s.correlation
        return degrees > 0.0 and bool(chi2.sf(total, degrees) < s.chance)
