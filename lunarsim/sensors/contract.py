"""The contract of sensors."""

from __future__ import annotations

from typing import Any, Protocol

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
