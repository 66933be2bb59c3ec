"""Monitor innovations, and declare when the filter has lost track.

A filter with a wrong state rejects correct measurements. Each kind of measurement is therefore
monitored in two ways. The first uses a window of seconds: the rejection rate, and the mean
normalised innovation squared, which is 1 for a consistent filter. The second uses a longer time
scale: the mean of the whitened innovations, which is 0 for a consistent filter. Another mean shows
a drift that is small in each single measurement.

Three quantities are monitored: the innovations of rock positions, the detected fraction of the
rocks that are expected in view, and whether the shadows point away from the assumed Sun direction.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from scipy.special import chdtrc

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.estimate import NavigationEvent
from lunarsim.typing import Array

# Fraction of the alarm thresholds below which a monitor is calm: a half plus a small margin.
_CALM_FRACTION = 0.55


class MonitorResult(Enum):
    """Result of an innovation monitor: filter consistent, or how it must respond."""

    CONSISTENT = "well"
    INFLATE = "inflate"
    DRIFT = "drift"
    LOST = "lost"


@dataclass(frozen=True)
class InnovationMonitorSettings:
    """Thresholds of an innovation monitor.

    Attributes
    ----------
    window_s
        Length of the window, s.
    min_count
        Minimum number of measurements in the window; older measurements are kept to reach this
        number.
    max_rejected_share
        Maximum fraction of rejected measurements.
    false_alarm_probability
        False-alarm probability of the innovation test for a consistent filter.
    correlated_count
        Number of correlated measurements that count as one. Errors that last longer than one cycle
        correlate the innovations.
    max_inflations
        Number of covariance inflations within three windows that are tolerated, for instance
        because the terrain height changes. One more declares the filter lost. If None, the first
        alarm declares it lost for good, since the filter has then already followed the wrong
        measurements.
    drift_time_scale_s
        Time constant of the mean of the whitened innovations, s; None disables the drift test.
    drift_threshold
        Threshold of the drift test, in standard deviations of the mean.
    max_drifts, drift_window_s
        Number of drifts within a window (s) that a bias can explain. One more declares the filter
        lost. The filter finds a bias that jumped within one or two time constants. With 0, each
        drift is a contradiction between two sensors.
    """

    window_s: float = 2.0
    min_count: int = 6
    max_rejected_share: float = 0.5
    false_alarm_probability: float = 1e-6
    correlated_count: float = 4.0
    max_inflations: int | None = 3
    drift_time_scale_s: float | None = None
    drift_threshold: float = 5.5
    max_drifts: int = 3
    drift_window_s: float = 30.0

    def __post_init__(self) -> None:
        for name in (
            "window_s",
            "min_count",
            "correlated_count",
            "drift_time_scale_s",
            "drift_threshold",
            "drift_window_s",
        ):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"monitor.{name}", value, "must be positive and finite")
        for name in ("max_rejected_share", "false_alarm_probability"):
            value = getattr(self, name)
            if not 0.0 < value < 1.0:
                raise InputError(f"monitor.{name}", value, "must be more than 0 and less than 1")
        for name in ("max_inflations", "max_drifts"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < np.inf:
                raise InputError(f"monitor.{name}", value, "must be 0 or more, and finite")


@dataclass
class InnovationMonitor:
    """Monitor that tests the innovations of one kind of measurement for consistency.

    Attributes
    ----------
    settings
        Thresholds.
    lost
        Whether the measurements contradict the filter.
    nis_ratio
        Normalised innovation squared per degree of freedom in the last evaluated window.
    nis_sum, dof
        Sum of the normalised innovations squared, and of the degrees of freedom, of all accepted
        measurements.
    rejected_count
        Number of rejected measurements.
    """

    settings: InnovationMonitorSettings = field(default_factory=InnovationMonitorSettings)
    lost: bool = False
    nis_ratio: float = 1.0
    nis_sum: float = 0.0
    dof: int = 0
    rejected_count: int = 0
    _recent: deque[tuple[float, UpdateOutcome]] = field(default_factory=deque)
    _inflations: deque[float] = field(default_factory=deque)
    _drifts: deque[float] = field(default_factory=deque)
    _mean: Array | None = None
    _weight: Array = field(default_factory=lambda: np.zeros(0))
    _last: float = -np.inf

    def record(self, time: float, outcome: UpdateOutcome) -> MonitorResult:
        """Add the outcome of an update at `time` (s); return the result of the tests.

        Outcomes without information (`nis` is NaN) are not counted. If there are more drifts than
        `max_drifts`, the result is still a drift, and `lost` is set.
        """
        if outcome.dof == 0 or not outcome.nis >= 0.0:
            return MonitorResult.CONSISTENT
        if outcome.is_accepted:
            self.nis_sum, self.dof = self.nis_sum + outcome.nis, self.dof + outcome.dof
        else:
            self.rejected_count += 1
        result = self._test_window(time, outcome)
        if not self._has_drift(time, outcome) or result is not MonitorResult.CONSISTENT:
            return result
        s = self.settings
        self._drifts.append(time)
        while self._drifts[0] < time - s.drift_window_s:
            self._drifts.popleft()
        if len(self._drifts) > s.max_drifts:
            self._drifts.clear()
            self.lost = True
        return MonitorResult.DRIFT

    def is_calm(self, time: float) -> bool:
        """Return whether enough recent measurements show no sign of a fault.

        There must be at least `min_count` measurements in the window, with a rejected fraction and
        a drift below about half of the alarm thresholds. `time` is the current time, s.
        """
        s = self.settings
        recent = [outcome.is_accepted for at, outcome in self._recent if at >= time - s.window_s]
        is_enough = len(recent) >= s.min_count and recent.count(
            False
        ) <= _CALM_FRACTION * s.max_rejected_share * len(recent)
        return is_enough and bool(
            (self._drift_levels() <= _CALM_FRACTION * s.drift_threshold).all()
        )

    def _drift_levels(self) -> Array:
        """Return the absolute mean of each whitened component, in standard deviations.

        Components with too few recent measurements are omitted; the result is empty without any.
        """
        if self._mean is None:
            return np.zeros(0)
        is_frequent = self._weight >= self.settings.min_count
        return np.asarray(np.abs(self._mean[is_frequent]) / np.sqrt(self._weight[is_frequent]))

    def _test_window(self, time: float, outcome: UpdateOutcome) -> MonitorResult:
        s = self.settings
        self._recent.append((time, outcome))
        # The last few measurements count at any age, so that slow sensors are monitored too.
        while len(self._recent) > s.min_count and self._recent[0][0] < time - s.window_s:
            self._recent.popleft()
        while self._inflations and self._inflations[0] < time - 3.0 * s.window_s:
            self._inflations.popleft()
        if len(self._recent) < s.min_count:
            return MonitorResult.CONSISTENT
        if not self._has_alarm():
            if s.max_inflations is not None and not self._inflations:
                self.lost = False
            return MonitorResult.CONSISTENT
        self._recent.clear()
        self._mean = None
        self._inflations.append(time)
        if s.max_inflations is None or len(self._inflations) > s.max_inflations:
            self.lost = True
            return MonitorResult.LOST
        return MonitorResult.INFLATE

    def _has_alarm(self) -> bool:
        s = self.settings
        recent = [o for _, o in self._recent]
        self.nis_ratio = sum(o.nis for o in recent) / sum(o.dof for o in recent)
        refused = sum(not o.is_accepted for o in recent)
        if refused > s.max_rejected_share * len(recent):
            return True
        taken = [o for o in recent if o.is_accepted]
        degrees = sum(o.dof for o in taken) / s.correlated_count
        total = sum(o.nis for o in taken) / s.correlated_count
        return degrees > 0.0 and bool(chdtrc(degrees, total) < s.false_alarm_probability)

    def _has_drift(self, time: float, outcome: UpdateOutcome) -> bool:
        """Return whether the fading mean of whitened innovations exceeds the threshold.

        `outcome` is the outcome of an update at `time` (s), which is first added to the mean. The
        result is False for a rejected outcome or if the drift test is disabled. After a drift, the
        mean starts again.
        """
        s = self.settings
        if s.drift_time_scale_s is None or not outcome.is_accepted:
            return False
        parts = len(outcome.whitened)
        if self._mean is None:
            self._mean, self._weight = np.zeros(parts), np.zeros(parts)
            self._last = time
        decay = float(np.exp(-max(time - self._last, 0.0) / s.drift_time_scale_s))
        self._last = time
        # The mean is a weighted sum of independent unit normals, whose variance is the sum of the
        # squared weights. Components can be missing, so each has its own weight.
        is_present = np.isfinite(outcome.whitened)
        self._mean = decay * self._mean + np.where(is_present, outcome.whitened, 0.0)
        self._weight = decay**2 * self._weight + is_present
        if not (self._drift_levels() > s.drift_threshold).any():
            return False
        self._mean = None
        return True


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

    Rock positions, the detected fraction of expected rocks and the shadow direction are monitored
    separately.

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
