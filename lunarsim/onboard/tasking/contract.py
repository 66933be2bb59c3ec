"""Interface of sensor tasking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import SensorTask
from lunarsim.onboard.navigation.estimate import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Situation:
    """Input of a schedule.

    Attributes
    ----------
    time
        Time of the measurement, s.
    altitude
        Altitude of the pads above the site at that time, m.
    site
        Site that the lander flies to (3,), m.
    estimate
        Predicted state at that time, the end of the next cycle.
    """

    time: float
    altitude: float
    site: Array
    estimate: Estimate


@dataclass(frozen=True)
class MeasurementAltitudes:
    """Altitudes of the pads above the site at which a schedule measures.

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
    """Part of the registry that builds a schedule: a frozen dataclass of settings.

    Attributes
    ----------
    looks
        Optional: the altitudes at which it measures (`MeasurementAltitudes`), for planners.
        Default: all altitudes.
    """

    def build(self, sensor: str, briefing: Briefing) -> Tasking:
        """Return the schedule of one flight.

        Raises
        ------
        InputError
            If the sensor cannot follow the schedule.
        """
        ...


class Tasking(Protocol):
    """Interface of a schedule that points and triggers one sensor."""

    def task(self, situation: Situation) -> SensorTask | None:
        """Return the task of the sensor, None for no measurement; called once per cycle."""
        ...

    def stop(self) -> None:
        """Stop all further measurements."""
        ...
