"""The order in which measurements come: time that runs on, and stamps that do too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import InertialSamples, Picture
from lunarsim.models.instruments import InertialInstrument

# A stamp may lie this far ahead of the clock: rounding of sums of steps, s.
_ROUNDING = 1e-6
# Samples missing for longer than this are not filled in: the lander has long been lost, s.
_LONGEST_GAP = 60.0
# What was measured longer ago tells of another place, s: at 30 m/s a metre off.
_STALE = 0.03


class Arrivals:
    """Lets measurements through in the order of their own times.

    A measurement that was made before the last one of its sensor, in the future, or at no time at
    all, is left out and reported as "out-of-order": to take it for one of now would be wrong, and
    to take it back in time is more than any filter here can do. So is what was made more than
    0.03 s before the time until which inertial samples have come ("stale"), pictures apart, which
    are stamped with the middle of their exposure. Inertial samples that never came are put in as
    missing ones ("samples-missing"), so that state and covariance are carried over the gap; of more
    than time has passed for, the last ones are kept ("samples-surplus").

    Inertial samples are to come before what else was measured by their end: see `overdue`.

    Parameters
    ----------
    step
        Between inertial samples, s.
    report
        Called with time (s), name and details of what is left out or filled in.
    begin
        Time of the state that samples carry, s: those of a unit that starts later are missing. Left
        out: it is that at which the first ones begin.
    unit
        Whose samples are missing before any came.
    """

    def __init__(
        self,
        step: float,
        report: Callable[[float, str, dict[str, Any]], None],
        *,
        begin: float = -np.inf,
        unit: str = "",
    ) -> None:
        self._step = step
        self._report = report
        self._now = -np.inf
        self._last: dict[str, float] = {}
        # The inertial unit, and until when its samples have been let through.
        self._unit, self._flown = unit, begin

    @classmethod
    def of(
        cls, briefing: Briefing, report: Callable[[float, str, dict[str, Any]], None]
    ) -> Arrivals:
        """Return those of a descent, which begins at 0 s: a unit may start late, and the first."""
        of = briefing.instruments
        units = [name for name, unit in of.items() if isinstance(unit, InertialInstrument)]
        if not units:
            return cls(briefing.step, report)
        return cls(briefing.step, report, begin=0.0, unit=units[0])

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
            If the clock itself runs backwards, or is no number, or if inertial samples are not
            three numbers each, as many of both.
        """
        self.advance(time)
        stamp = float(getattr(measurement, "time", time))
        last = self._last.get(sensor, -np.inf)
        inertial = isinstance(measurement, InertialSamples)
        if inertial:
            measurement = _whole(measurement)
        # The same increments twice would be flown twice.
        again = inertial and stamp <= last and len(measurement.angle) > 0
        if again or not last <= stamp <= time + _ROUNDING:
            self._report(time, "out-of-order", {"sensor": sensor, "stamp": stamp, "last": last})
            return None
        self._last[sensor] = stamp
        if not inertial:
            now = min(time, self._flown) if np.isfinite(self._flown) else time
            if stamp < now - _STALE and not isinstance(measurement, Picture):
                self._report(time, "stale", {"sensor": sensor, "stamp": stamp})
                return None
            return measurement
        # Samples of another unit may end earlier: what has been flown stays flown.
        elapsed, self._unit, self._flown = stamp - self._flown, sensor, max(self._flown, stamp)
        return self._filled(sensor, measurement, elapsed, time)

    def carried(
        self, sensor: str, measurement: Any, time: float, propagate: Callable[[Any, Any], None]
    ) -> Any:
        """Return a measurement that is to correct a state, which has been carried to its time.

        None if it was inertial samples, by which the state has been carried, or was left out.

        Parameters
        ----------
        sensor, measurement, time
            See `admit`.
        propagate
            Carries the state over increments of angle and velocity (n, 3), (n, 3).
        """
        given = self.admit(sensor, measurement, time)
        if isinstance(given, InertialSamples):
            propagate(given.angle, given.velocity)
            return None
        overdue = None if given is None else self.overdue(float(getattr(given, "time", time)))
        if overdue is not None:
            propagate(overdue[1].angle, overdue[1].velocity)
        return given

    def overdue(self, time: float) -> tuple[str, InertialSamples] | None:
        """Return inertial samples that should have come by `time` (s) as missing ones, if any.

        With the name of their unit. What is measured then corrects the state of that time, and not
        one that stood still. Should the samples come after all they are out of order. None before
        any came, where it is not said when they begin, or if `time` is no number.
        """
        if not (np.isfinite(self._flown) and time - self._flown >= 0.5 * self._step):
            return None
        none = InertialSamples(time, np.zeros((0, 3)), np.zeros((0, 3)))
        elapsed, self._flown = time - self._flown, time
        self._last[self._unit] = time
        return self._unit, self._filled(self._unit, none, elapsed, time)

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
        """Put samples that never came before those that did, as missing ones; drop what is more."""
        if not np.isfinite(elapsed):
            return samples  # the first ones
        surplus = len(samples.angle) - round(elapsed / self._step)
        if surplus > 0:
            self._report(time, "samples-surplus", {"sensor": sensor, "count": surplus})
            return replace(
                samples, angle=samples.angle[surplus:], velocity=samples.velocity[surplus:]
            )
        missing = round(min(elapsed, _LONGEST_GAP) / self._step) - len(samples.angle)
        if missing <= 0:
            return samples
        self._report(time, "samples-missing", {"sensor": sensor, "count": missing})
        gap = np.full((missing, 3), np.nan)
        return replace(
            samples,
            angle=np.concatenate((gap, samples.angle)),
            velocity=np.concatenate((gap, samples.velocity)),
        )


def _whole(samples: InertialSamples) -> InertialSamples:
    """Return inertial samples as arrays (n, 3), checked."""
    angle, velocity = (np.asarray(of, np.float64) for of in (samples.angle, samples.velocity))
    for name, of in (("angle", angle), ("velocity", velocity)):
        if of.ndim != 2 or of.shape[1] != 3:
            shape = of.shape
            raise InputError(f"inertial.{name}", shape, "samples (n, 3), NaN for a missing one")
    if len(angle) != len(velocity):
        lengths = (len(angle), len(velocity))
        raise InputError("inertial.samples", lengths, "as many of angle as of velocity")
    return replace(samples, angle=angle, velocity=velocity)
