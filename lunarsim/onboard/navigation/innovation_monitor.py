"""Monitor the innovations of a filter, and declare when the filter has lost track.

A filter with a wrong state rejects correct measurements. Each kind of measurement is therefore
monitored in two ways. The first uses a window of seconds: the rejection rate, and the mean
normalised innovation squared, which is 1 for a consistent filter. The second uses a longer time
scale: the mean of the whitened innovations, which is 0 for a consistent filter. Another mean shows
a drift that is small in each single measurement.
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

# Fraction of the alarm thresholds below which a monitor is calm: a half plus a small margin.
_CALM = 0.55


class Verdict(Enum):
    """Result of an innovation monitor."""

    WELL = "well"
    WIDEN = "widen"
    DRIFT = "drift"
    LOST = "lost"


@dataclass(frozen=True)
class WatchSettings:
    """Thresholds of an innovation monitor.

    Attributes
    ----------
    window_s
        Length of the window, s.
    least
        Minimum number of measurements in the window; older ones are kept to reach it.
    most_refused
        Maximum fraction of rejected measurements.
    chance
        False-alarm probability of the innovation test for a consistent filter.
    correlation
        Number of correlated measurements that count as one. Errors that last longer than one cycle
        correlate the innovations.
    patience
        Number of inflations within three windows that are tolerated, for instance because the
        terrain height changes. One more declares the filter lost. If None, the first alarm declares
        it lost for good, since the filter has then already followed the wrong measurements.
    drift_s
        Time constant of the mean of the whitened innovations, s; None disables the drift test.
    drift_level
        Threshold of the drift test, in standard deviations of the mean.
    drift_patience, drift_window_s
        Number of drifts within a window (s) that a bias can explain. One more declares the filter
        lost. The filter finds a bias that jumped within one or two time constants. With 0, each
        drift is a contradiction between two sensors.
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
                raise InputError(f"watch.{name}", value, "must be a positive number")
        for name in ("most_refused", "chance"):
            value = getattr(self, name)
            if not 0.0 < value < 1.0:
                raise InputError(f"watch.{name}", value, "must be between 0 and 1")
        for name in ("patience", "drift_patience"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < np.inf:
                raise InputError(f"watch.{name}", value, "must be a non-negative number")


@dataclass
class Watch:
    """Monitor the innovations of one kind of measurement.

    Attributes
    ----------
    settings
        Thresholds.
    lost
        Whether the measurements contradict the filter.
    excess
        Normalised innovation squared per degree of freedom in the last evaluated window.
    total, degrees
        Sum of the normalised innovations squared, and of the degrees of freedom, of all accepted
        measurements.
    refused
        Number of rejected measurements.
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
        """Add the outcome of a measurement at a time (s), and evaluate the monitor.

        Outcomes without information (`nis` is NaN) are not counted. If there are more drifts than
        `drift_patience`, the result is still a drift, and `lost` is set.
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
        """Return whether there are enough recent measurements and no sign of a fault."""
        s = self.settings
        late = [outcome.taken for at, outcome in self._seen if at >= time - s.window_s]
        few = len(late) >= s.least and late.count(False) <= _CALM * s.most_refused * len(late)
        return few and bool((self._levels() <= _CALM * s.drift_level).all())

    def _levels(self) -> Array:
        """Return the absolute mean of each component in units of its standard deviation."""
        if self._mean is None:
            return np.zeros(0)
        often = self._weight >= self.settings.least
        return np.asarray(np.abs(self._mean[often]) / np.sqrt(self._weight[often]))

    def _judge_window(self, time: float, outcome: Outcome) -> Verdict:
        s = self.settings
        self._seen.append((time, outcome))
        # The last few measurements count at any age, so that slow sensors are monitored too.
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
        """Return whether the fading mean of whitened innovations exceeds the threshold."""
        s = self.settings
        if s.drift_s is None or not outcome.taken:
            return False
        parts = len(outcome.white)
        if self._mean is None:
            self._mean, self._weight = np.zeros(parts), np.zeros(parts)
            self._last = time
        keep = float(np.exp(-max(time - self._last, 0.0) / s.drift_s))
        self._last = time
        # The mean is a weighted sum of independent unit normals, whose variance is the sum of the
        # squared weights. Components can be missing, so each has its own weight.
        seen = np.isfinite(outcome.white)
        self._mean = keep * self._mean + np.where(seen, outcome.white, 0.0)
        self._weight = keep**2 * self._weight + seen
        if not (self._levels() > s.drift_level).any():
            return False
        self._mean = None
        return True
