"""Whether a filter still believes what it measures, and when it must say that it is lost.

A filter that is wrong refuses what is right. Each kind of measurement is watched in two ways. Over
a window of seconds: the share of refusals, and the mean of the normalised innovations, which is 1
while the filter errs as it says. And over a longer time: the mean of the whitened innovations,
which is 0; where it is not, something drifts that is small in every single measurement.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.error_state import Outcome

Array = NDArray[np.float64]

# Half of what is doubted, and a little: so far a watch is calm.
_CALM = 0.55


class Verdict(Enum):
    """What a watch has seen."""

    WELL = "well"
    WIDEN = "widen"
    DRIFT = "drift"
    LOST = "lost"


@dataclass(frozen=True)
class WatchSettings:
    """When measurements are doubted.

    Attributes
    ----------
    window_s
        Over which they are watched, s.
    least
        Fewest measurements by which to judge, however long they took.
    most_refused
        Greatest share of them that may be refused.
    chance
        Of a filter that errs as it says to be doubted for its innovations.
    correlation
        Measurements are taken for this many times fewer: errors that last longer than a cycle make
        innovations alike.
    patience
        Widenings of one kind within three windows that may be explained, by ground that rises for
        instance; with one more the filter is lost. None: a jump cannot be explained at all, and
        what is lost by it stays so, since the filter has by then gone along with what is wrong.
    drift_s
        Time over which the mean of whitened innovations is watched, s; None: it is not.
    drift_level
        Standard deviations of that mean beyond which something drifts.
    drift_patience, drift_window_s
        Drifts within so many seconds that a bias may explain; with one more it does not, and the
        filter is lost. A bias that jumps is found within one or two memories of the mean. 0: a
        drift is a contradiction, and which of two sensors drifts cannot be told.
    """

    window_s: float = 2.0
    least: int = 6
    most_refused: float = 0.5
    chance: float = 1e-6
    correlation: float = 4.0
    patience: int | None = 3
    drift_s: float | None = None
    drift_level: float = 5.5
    drift_patience: int = 3
    drift_window_s: float = 30.0

    def __post_init__(self) -> None:
        for name in (
            "window_s",
            "least",
            "correlation",
            "drift_s",
            "drift_level",
            "drift_window_s",
        ):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"watch.{name}", value, "a positive number")
        for name in ("most_refused", "chance"):
            value = getattr(self, name)
            if not 0.0 < value < 1.0:
                raise InputError(f"watch.{name}", value, "between 0 and 1")
        for name in ("patience", "drift_patience"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < np.inf:
                raise InputError(f"watch.{name}", value, "a number that is not negative")


@dataclass
class Watch:
    """Watches one kind of measurement.

    Attributes
    ----------
    settings
        When it is doubted.
    lost
        Whether it has not been explained.
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
    _drifted: deque[float] = field(default_factory=deque)
    _mean: Array | None = None
    _weight: Array = field(default_factory=lambda: np.zeros(0))
    _last: float = -np.inf

    def note(self, time: float, outcome: Outcome) -> Verdict:
        """Note what came of a measurement at a time (s), and judge.

        What told nothing (a `nis` of NaN) is not counted. A drift beyond patience is judged to be
        one, and `lost` is set besides.
        """
        if outcome.degrees == 0 or not outcome.nis >= 0.0:
            return Verdict.WELL
        if outcome.taken:
            self.total, self.degrees = self.total + outcome.nis, self.degrees + outcome.degrees
        else:
            self.refused += 1
        verdict = self._judge_window(time, outcome)
        if not self._drifts(time, outcome) or verdict is not Verdict.WELL:
            return verdict
        s = self.settings
        self._drifted.append(time)
        while self._drifted[0] < time - s.drift_window_s:
            self._drifted.popleft()
        if len(self._drifted) > s.drift_patience:
            self._drifted.clear()
            self.lost = True
        return Verdict.DRIFT

    def calm(self, time: float) -> bool:
        """Tell whether enough was measured of late, and nothing of it looks like a fault."""
        s = self.settings
        late = [outcome.taken for at, outcome in self._seen if at >= time - s.window_s]
        few = len(late) >= s.least and late.count(False) <= _CALM * s.most_refused * len(late)
        return few and bool((self._levels() <= _CALM * s.drift_level).all())

    def _levels(self) -> Array:
        """Return by how many of its deviations the mean of each part lies off 0."""
        if self._mean is None:
            return np.zeros(0)
        often = self._weight >= self.settings.least
        return np.asarray(np.abs(self._mean[often]) / np.sqrt(self._weight[often]))

    def _judge_window(self, time: float, outcome: Outcome) -> Verdict:
        s = self.settings
        self._seen.append((time, outcome))
        # The last few count however long ago: a slow sensor is to be judged too.
        while len(self._seen) > s.least and self._seen[0][0] < time - s.window_s:
            self._seen.popleft()
        while self._widened and self._widened[0] < time - 3.0 * s.window_s:
            self._widened.popleft()
        if len(self._seen) < s.least:
            return Verdict.WELL
        if not self._doubtful():
            if s.patience is not None and not self._widened:
                self.lost = False
            return Verdict.WELL
        self._seen.clear()
        self._mean = None
        self._widened.append(time)
        if s.patience is None or len(self._widened) > s.patience:
            self.lost = True
            return Verdict.LOST
        return Verdict.WIDEN

    def _doubtful(self) -> bool:
        s = self.settings
        every = [o for _, o in self._seen]
        self.excess = sum(o.nis for o in every) / sum(o.degrees for o in every)
        refused = sum(not o.taken for o in every)
        if refused > s.most_refused * len(every):
            return True
        taken = [o for o in every if o.taken]
        degrees = sum(o.degrees for o in taken) / s.correlation
        total = sum(o.nis for o in taken) / s.correlation
        return degrees > 0.0 and bool(chdtrc(degrees, total) < s.chance)

    def _drifts(self, time: float, outcome: Outcome) -> bool:
        """Tell whether innovations lie to one side: a mean that forgets, in its own deviations."""
        s = self.settings
        if s.drift_s is None or not outcome.taken:
            return False
        parts = len(outcome.white)
        if self._mean is None:
            self._mean, self._weight = np.zeros(parts), np.zeros(parts)
            self._last = time
        keep = float(np.exp(-max(time - self._last, 0.0) / s.drift_s))
        self._last = time
        # Each part by itself, as often as it was measured: sums of independent unit normals, whose
        # variance is the sum of the squared weights.
        seen = np.isfinite(outcome.white)
        self._mean = keep * self._mean + np.where(seen, outcome.white, 0.0)
        self._weight = keep**2 * self._weight + seen
        if not (self._levels() > s.drift_level).any():
            return False
        self._mean = None
        return True
