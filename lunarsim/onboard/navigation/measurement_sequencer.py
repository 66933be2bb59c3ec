"""Check the time order of measurements, and fill gaps in inertial samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import CameraImage, InertialSamples
from lunarsim.models.instruments import InertialInstrument
from lunarsim.onboard.navigation.inertial import checked_increments
from lunarsim.value_checks import check_time

# Tolerance for time stamps after the current time, from rounding of summed steps, s.
_TIME_TOLERANCE_S = 1e-6
# Longer gaps in the inertial samples are filled only up to this time, s.
_MAX_GAP_S = 60.0
# Maximum age of a measurement, s: at 30 m/s the lander moves about one metre in this time.
_MAX_AGE_S = 0.03


class MeasurementSequencer:
    """Checks the time order of measurements and fills gaps in inertial samples.

    A measurement is rejected with the event "out-of-order" if its time stamp is before the last one
    of its sensor, in the future or NaN; the filters here cannot process delayed measurements. It is
    rejected with "stale" if it is more than 0.03 s older than the last inertial sample. Camera
    images are exempt, since their time stamp is the middle of the exposure. Gaps in the inertial
    samples are filled with NaN samples ("samples-missing"), so that state and covariance are
    propagated over the gap. If there are more samples than time steps, the last ones are kept
    ("samples-surplus").

    Inertial samples must arrive before the other measurements of the same time. If they do not,
    `overdue_samples` returns NaN samples as substitutes.

    Parameters
    ----------
    step
        Time between inertial samples, s.
    report
        Function that is called with time (s), name and details of each rejection or gap.
    begin
        Time of the initial state, s; samples between this time and the first received ones count as
        missing. Default: the time at which the first samples begin.
    unit
        Name of the inertial unit before its first samples arrive.
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
        # Name of the inertial unit, and end time of its admitted samples.
        self._unit, self._propagated_until = unit, begin

    @classmethod
    def of(
        cls, briefing: Briefing, report: Callable[[float, str, dict[str, Any]], None]
    ) -> MeasurementSequencer:
        """Return the sequencer of a descent that begins at 0 s, for the lander's sensors.

        `report` is called with time (s), name and details of each rejection or gap.
        """
        of = briefing.instruments
        units = [name for name, unit in of.items() if isinstance(unit, InertialInstrument)]
        if not units:
            return cls(briefing.step, report)
        return cls(briefing.step, report, begin=0.0, unit=units[0])

    def admit(self, sensor: str, measurement: Any, time: float) -> Any:
        """Return a measurement if its time stamp is valid, else None.

        Inertial samples are returned complete: missing ones are inserted as NaN, surplus ones
        are dropped.

        Parameters
        ----------
        sensor, measurement
            Sensor name and its measurement; without a time stamp it is taken as current.
        time
            Current time, s.

        Raises
        ------
        InputError
            If `time` runs backwards or is NaN, or if inertial samples are not two arrays (n, 3).
        """
        self.advance(time)
        stamp = float(getattr(measurement, "time", time))
        last = self._last.get(sensor, -np.inf)
        inertial = isinstance(measurement, InertialSamples)
        if inertial:
            measurement = _check_samples(measurement)
        # Increments that arrive twice must not be integrated twice.
        is_repeated = inertial and stamp <= last and len(measurement.angle) > 0
        if is_repeated or not last <= stamp <= time + _TIME_TOLERANCE_S:
            self._report(time, "out-of-order", {"sensor": sensor, "stamp": stamp, "last": last})
            return None
        self._last[sensor] = stamp
        if not inertial:
            now = min(time, self._propagated_until) if np.isfinite(self._propagated_until) else time
            if stamp < now - _MAX_AGE_S and not isinstance(measurement, CameraImage):
                self._report(time, "stale", {"sensor": sensor, "stamp": stamp})
                return None
            return measurement
        # Samples of another unit may end earlier; the propagated time does not go back.
        elapsed, self._unit, self._propagated_until = (
            stamp - self._propagated_until,
            sensor,
            max(self._propagated_until, stamp),
        )
        return self._fill_gaps(sensor, measurement, elapsed, time)

    def admit_and_propagate(
        self, sensor: str, measurement: Any, time: float, propagate: Callable[[Any, Any], None]
    ) -> Any:
        """Propagate a filter to the time of a measurement, and return the measurement.

        Returns None for inertial samples, which are used for the propagation, and for rejected
        measurements.

        Parameters
        ----------
        sensor, measurement
            Sensor name and its measurement; without a time stamp it is taken as current.
        time
            Current time, s.
        propagate
            Function that propagates the state with increments of angle (n, 3), rad, and velocity
            (n, 3), m/s.
        """
        given = self.admit(sensor, measurement, time)
        if isinstance(given, InertialSamples):
            propagate(given.angle, given.velocity)
            return None
        overdue = (
            None if given is None else self.overdue_samples(float(getattr(given, "time", time)))
        )
        if overdue is not None:
            propagate(overdue[1].angle, overdue[1].velocity)
        return given

    def overdue_samples(self, time: float) -> tuple[str, InertialSamples] | None:
        """Return NaN samples that replace inertial samples overdue at `time` (s), if any.

        The result is the name of the inertial unit and the samples. With them, the state can be
        propagated to the time of a measurement. If the real samples arrive later, they are out of
        order. Returns None if no samples are overdue, if the start of the samples is unknown, or if
        `time` is not finite.
        """
        if not (
            np.isfinite(self._propagated_until)
            and time - self._propagated_until >= 0.5 * self._step
        ):
            return None
        none = InertialSamples(time, np.zeros((0, 3)), np.zeros((0, 3)))
        elapsed, self._propagated_until = time - self._propagated_until, time
        self._last[self._unit] = time
        return self._unit, self._fill_gaps(self._unit, none, elapsed, time)

    def advance(self, time: float) -> None:
        """Set the current time, s; refuse times before the last one.

        Raises
        ------
        InputError
            If `time` is before the current time, or not finite.
        """
        check_time("time", time, self._now)
        self._now = time

    def _fill_gaps(
        self, sensor: str, samples: InertialSamples, elapsed: float, time: float
    ) -> InertialSamples:
        """Fit inertial samples to the elapsed time: insert NaN samples or drop surplus.

        `elapsed` (s) is the time that the samples should cover. Missing samples, at most 60 s of
        them, are inserted as NaN before the given ones; of too many samples, the oldest are
        dropped. Each case is reported with `sensor` and the current `time` (s). If `elapsed` is
        not finite, the samples are returned unchanged.
        """
        if not np.isfinite(elapsed):
            return samples  # the start of the samples is unknown before the first ones
        surplus = len(samples.angle) - round(elapsed / self._step)
        if surplus > 0:
            self._report(time, "samples-surplus", {"sensor": sensor, "count": surplus})
            return replace(
                samples, angle=samples.angle[surplus:], velocity=samples.velocity[surplus:]
            )
        missing = round(min(elapsed, _MAX_GAP_S) / self._step) - len(samples.angle)
        if missing <= 0:
            return samples
        self._report(time, "samples-missing", {"sensor": sensor, "count": missing})
        gap = np.full((missing, 3), np.nan)
        return replace(
            samples,
            angle=np.concatenate((gap, samples.angle)),
            velocity=np.concatenate((gap, samples.velocity)),
        )


def _check_samples(samples: InertialSamples) -> InertialSamples:
    """Return inertial samples as two float arrays (n, 3) after checking the shapes.

    A wrong shape raises an `InputError`.
    """
    angle, velocity = checked_increments(samples.angle, samples.velocity)
    return replace(samples, angle=angle, velocity=velocity)
