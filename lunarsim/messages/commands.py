"""Commands of the onboard computer to the vehicle and its sensors."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.typing import Array


@dataclass(frozen=True)
class SensorTask:
    """Request for one measurement by a sensor on a gimbal.

    Attributes
    ----------
    sensor
        Name of the sensor on the lander.
    mount
        Rotation (3, 3), sensor to body, that the gimbal must hold.
    """

    sensor: str
    mount: Array


@dataclass(frozen=True)
class Command:
    """Commands of the onboard computer for one control cycle.

    Attributes
    ----------
    thrust
        Thrust, N; 0 shuts the engine down, other values are clipped to the throttle range.
    attitude
        Commanded attitude, quaternion, body to ENU (4,).
    tasks
        Measurements to make at the end of the cycle.
    abort
        Whether the lander has aborted its landing and climbs away.
    """

    thrust: float
    attitude: Array
    tasks: tuple[SensorTask, ...] = ()
    abort: bool = False
