"""The contract of sensors."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.vehicle.state import State
from lunarsim.world import World


class Sensor(Protocol):
    """Anything that turns the truth into a measurement with its own noise."""

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: NDArray[np.float64] | None = None,
    ) -> Any:
        """Return one measurement.

        Parameters
        ----------
        world, state, time
            The truth now.
        rng
            The sensor's own stream.
        mount
            Rotation (3, 3), sensor to body, that a gimbal holds.
        """
        ...


class SensorPart(Protocol):
    """What the registry knows of a sensor: a frozen dataclass of its figures.

    A part that keeps something from one measurement to the next has a method
    ``build(rng, step) -> Sensor`` besides; without it the part itself measures.

    Attributes
    ----------
    gives
        Type of its measurements.
    tasked
        Whether it measures only when tasked; else once a control cycle.
    """

    gives: ClassVar[type]
    tasked: ClassVar[bool]

    def calibration(self) -> Any:
        """Return what the onboard computer may know of it; for a tasked one with its gimbal."""
        ...
