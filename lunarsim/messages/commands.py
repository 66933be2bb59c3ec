"""What the onboard computer asks of the vehicle and its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SensorTask:
    """One measurement that a pointed sensor is to make.

    Attributes
    ----------
    sensor
        Its name on the lander.
    mount
        Rotation (3, 3), sensor to body, that its gimbal is to hold.
    """

    sensor: str
    mount: NDArray[np.float64]


@dataclass(frozen=True)
class Command:
    """What is asked for one control cycle.

    Attributes
    ----------
    thrust
        N; 0 shuts the engine down, other values are held in the throttle range.
    attitude
        Wanted attitude, quaternion, body to ENU (4,).
    tasks
        Measurements to make at the end of the cycle.
    abort
        Whether the lander has given up its landing and climbs away.
    """

    thrust: float
    attitude: NDArray[np.float64]
    tasks: tuple[SensorTask, ...] = ()
    abort: bool = False
