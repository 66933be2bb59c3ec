"""Interfaces of sensors and of their settings."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.vehicle.state import State
from lunarsim.world import World


class Sensor(Protocol):
    """Interface of sensors, which convert the truth to a measurement with noise."""

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
            True world and state, and the time, s.
        rng
            Random stream of the sensor.
        mount
            Rotation (3, 3), sensor to body, of the gimbal; None: the sensor's default mounting.
        """
        ...


class SensorPart(Protocol):
    """Interface of sensor parts: frozen dataclasses of sensor parameters.

    A part with state between measurements also has a method ``build(rng, step) -> Sensor``; a part
    without it is itself the sensor.

    Attributes
    ----------
    gives
        Type of its measurements.
    tasked
        Whether it measures only when tasked; otherwise it measures once per control cycle.
    """

    gives: ClassVar[type]
    tasked: ClassVar[bool]

    def calibration(self) -> Any:
        """Return what the onboard computer knows of the sensor and its gimbal."""
        ...
