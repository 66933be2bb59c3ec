"""Interface of sensor tasking: schedules that point and trigger a sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import SensorTask
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array


@dataclass(frozen=True)
class Situation:
    """Predicted state of the descent for which a schedule decides about a measurement.

    Attributes
    ----------
    time
        Time of the measurement, the end of the next cycle, s.
    altitude
        Altitude of the pads above the site at that time, m.
    site
        Site that the lander flies to (3,), m.
    estimate
        Predicted navigation state at that time.
    """

    time: float
    altitude: float
    site: Array
    estimate: Estimate


@dataclass(frozen=True)
class MeasurementAltitudes:
    """Altitudes of the pads above the site at which a sensor measures.

    Attributes
    ----------
    highest, lowest
        Limits of the altitude range with repeated measurements, m.
    at
        Altitudes of single measurements, m; empty for repeated measurements.
    """

    highest: float = np.inf
    lowest: float = 0.0
    at: tuple[float, ...] = ()


class TaskingPart(Protocol):
    """Settings of a sensor's measurement schedule in the scenario: a frozen dataclass.

    Attributes
    ----------
    measurement_altitudes
        Optional: the altitudes at which the sensor measures (`MeasurementAltitudes`), for planners.
        Default: all altitudes.
    """

    def build(self, sensor: str, briefing: Briefing) -> Tasking:
        """Return the measurement schedule of one flight for a named sensor.

        Raises
        ------
        InputError
            If the sensor cannot follow the schedule.
        """
        ...


class Tasking(Protocol):
    """Interface of a schedule that points and triggers one sensor."""

    def task(self, situation: Situation) -> SensorTask | None:
        """Return the sensor's next measurement task, or None for no measurement.

        The method is called once per control cycle; the task applies to the end of the next cycle.
        """
        ...

    def stop(self) -> None:
        """Stop all further measurements."""
        ...
