"""The order in which measurements come: time that runs on, and stamps that do too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.measurements import InertialSamples

# A stamp may lie this far ahead of the clock: rounding of sums of steps, s.
_ROUNDING = 1e-6
# Samples missing for longer than this are not filled in: the lander has long been lost, s.
_LONGEST_GAP = 60.0


class Arrivals:
    """Lets measurements through in the order of their own times.

    A measurement that was made before the last one of its sensor, in the future, or at no time at
    all, is left out and reported as "out-of-order": to take it for one of now would be wrong, and
    to take it back in time is more than any filter here can do. Inertial samples that never came
    are put in as missing ones, so that state and covariance are carried over the gap.

    Parameters
    ----------
    step
        Between inertial samples, s.
    report
        Called with time (s), name and details of what is left out or filled in.
    """

    def __init__(self, step: float, report: Callable[[float, str, dict[str, Any]], None]) -> None:
        self._step = step
        self._report = report
        self._now = -np.inf
        self._last: dict[str, float] = {}

    def admit(self, sensor: str, measurement: Any, time: float) -> Any:
        """Return the measurement, inertial samples whole; None if it comes out of order.

        Parameters
        ----------
        sensor, measurement
            Its name, and what it gave; what bears no time is taken for one of now.
        time
            Now, s.

        Raises
        ------
        InputError
            If the clock itself runs backwards, or is no number.
        """
        self.advance(time)
        stamp = float(getattr(measurement, "time", time))
        last = self._last.get(sensor, -np.inf)
        inertial = isinstance(measurement, InertialSamples)
        # The same increments twice would be flown twice.
        again = inertial and stamp <= last and len(np.atleast_1d(measurement.angle)) > 0
        if again or not last <= stamp <= time + _ROUNDING:
            self._report(time, "out-of-order", {"sensor": sensor, "stamp": stamp, "last": last})
            return None
        self._last[sensor] = stamp
        return self._filled(sensor, measurement, stamp - last, time) if inertial else measurement

    def advance(self, time: float) -> None:
        """Let it be `time` (s).

        Raises
        ------
        InputError
            If that is before what it was, or no number.
        """
        if not (np.isfinite(time) and time >= self._now):
            raise InputError("time", time, f"at least {self._now} s: time does not run backwards")
        self._now = time

    def _filled(
        self, sensor: str, samples: InertialSamples, elapsed: float, time: float
    ) -> InertialSamples:
        """Put samples that never came before those that did, as missing ones."""
        shape = np.shape(samples.angle)
        if not np.isfinite(elapsed) or len(shape) != 2 or shape != np.shape(samples.velocity):
            return samples  # the first ones; or of no good shape, which is refused where it counts
        missing = round(min(elapsed, _LONGEST_GAP) / self._step) - shape[0]
        if missing <= 0:
            return samples
        self._report(time, "samples-missing", {"sensor": sensor, "count": missing})
        gap = np.full((missing, shape[1]), np.nan)
        return replace(
            samples,
            angle=np.concatenate((gap, samples.angle)),
            velocity=np.concatenate((gap, samples.velocity)),
        )
