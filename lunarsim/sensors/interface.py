"""Interfaces of sensors and of their settings."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

import numpy as np

from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World


class Sensor(Protocol):
    """Interface of simulated sensors, which measure the true world with errors."""

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> Any:
        """Return one measurement of the true world.

        A sensor that is not tasked may return None in a control cycle without a measurement.

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
    """Interface of sensor settings: frozen dataclasses that a scenario selects.

    Settings of a sensor with state between measurements also have a method
    ``build(rng, step) -> Sensor``; settings without `build` are themselves the sensor. Settings may
    also have ``is_recorded = True``, which stores all readings in the flight record
    (`Flight.readings`) and permits a sensor that no onboard function uses, and
    ``needs_sunlight = False`` if light does not matter. Readings that are recorded are dataclasses
    with a field `time` and numbers or vectors.

    Attributes
    ----------
    measurement_type
        Type of the measurements.
    is_tasked
        Whether the sensor measures only on request; otherwise it measures every control cycle.
    """

    measurement_type: ClassVar[type]
    is_tasked: ClassVar[bool]

    def calibration(self) -> Any:
        """Return the data on sensor and gimbal that the onboard computer has.

        The result is None if the onboard computer needs none.
        """
        ...
