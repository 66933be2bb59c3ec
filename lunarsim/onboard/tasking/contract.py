"""The contract of tasking."""

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
    """What tasking is told.

    Attributes
    ----------
    time
        Of the task, s.
    altitude
        Then, of the pads above the site, m.
    site
        Where the lander is going (3,), m.
    estimate
        Where it will be when the task is done: at the end of the cycle that is to come.
    """

    time: float
    altitude: float
    site: Array
    estimate: Estimate


@dataclass(frozen=True)
class Looks:
    """Altitudes of the pads above the site at which a schedule measures.

    Attributes
    ----------
    highest, lowest
        Between which it measures over and over, m.
    at
        Of single measurements, m; empty: over and over.
    """

    highest: float = np.inf
    lowest: float = 0.0
    at: tuple[float, ...] = ()


class TaskingPart(Protocol):
    """What the registry knows of a schedule: a frozen dataclass of its settings.

    Attributes
    ----------
    looks
        May be left out: the altitudes at which it measures (`Looks`), for what plans by them; else
        it is taken to measure all the way down.
    """

    def build(self, sensor: str, briefing: Briefing) -> Tasking:
        """Return the schedule of one flight.

        Raises
        ------
        InputError
            If the sensor cannot do it.
        """
        ...


class Tasking(Protocol):
    """Anything that points and triggers one sensor."""

    def task(self, situation: Situation) -> SensorTask | None:
        """Return what the sensor is to do now, None for nothing; called once a cycle."""
        ...

    def stop(self) -> None:
        """Ask for no more measurements."""
        ...
