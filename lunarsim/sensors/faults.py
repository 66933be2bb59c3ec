"""Timed faults of sensors, which act between the sensor and the onboard computer.

A fault is a part of the scenario: `[sensor_faults.NAME]` with a `kind`. The onboard computer does
not know it. Faults of one sensor act in the order of the scenario file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
    LidarScan,
    NavigationFix,
)
from lunarsim.parts.quantity import check_bounds, check_direction, quantity
from lunarsim.typing import Array

# Measured quantities that an additive fault can change, by type of measurement; the first is the
# default.
_CHANNELS: dict[type, tuple[str, ...]] = {
    AltimeterReading: ("range",),
    DopplerReading: ("speed", "range"),
    AttitudeReading: ("attitude",),
    LidarScan: ("range",),
    InertialSamples: ("rate", "acceleration"),
    NavigationFix: ("position", "velocity", "attitude"),
}
# Quantities that are vectors in space or rotations.
_VECTORS = ("attitude", "rate", "acceleration", "position", "velocity")
# Fields that have no value where a return is lost.
_RETURN_FIELDS = ("range", "sigma", "speed", "speed_sigma", "range_sigma")


def channels_of(measurement_type: type) -> tuple[str, ...]:
    """Return the quantities of a type of measurement that additive faults can change."""
    found = (names for base, names in _CHANNELS.items() if issubclass(measurement_type, base))
    return next(found, ())


@dataclass(frozen=True)
class SensorFault:
    """Settings that all sensor faults have: the sensor, start, end and occurrence.

    Attributes
    ----------
    sensor
        Name of the faulty sensor.
    start, end
        Times in the flight between which the fault acts, s; the end is exclusive, None: never.
    occurs
        Whether the fault occurs; false is a flight without it.
    """

    sensor: str = quantity("", help="name of the faulty sensor")
    start: float = quantity(0.0, "s", ge=0, help="time in the flight at which the fault begins")
    end: float | None = quantity(
        None, "s", ge=0, help="time in the flight at which the fault ends; omitted: never"
    )
    occurs: bool = quantity(
        True, help="whether the fault occurs; campaigns and environments can draw it per flight"
    )

    # Whether the sensor's measurements are lost.
    is_silent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_bounds(self, "sensor_faults")
        if self.end is not None and self.end <= self.start:
            raise InputError(
                "sensor_faults.end", self.end,
                f"must be later than start_s, which is {self.start:g} s",
            )  # fmt: skip

    def is_active(self, time: float) -> bool:
        """Return whether the fault acts at a time, s."""
        is_before_end = self.end is None or time + 1e-9 < self.end
        return self.occurs and self.start <= time + 1e-9 and is_before_end

    @classmethod
    def applies_to(cls, measurement_type: type) -> bool:
        """Return whether sensors with a type of measurement can have this fault.

        By default, all can except inertial units, which the attitude control needs.
        """
        return not issubclass(measurement_type, InertialSamples)

    def apply(self, measurement: Any, held: Any, time: float, rng: np.random.Generator) -> Any:
        """Return the faulty measurement.

        `held` is the last measurement before the fault, with the faults before it in the file, or
        None; `time` is in s, and `rng` the source of the fault's random numbers.
        """
        return measurement


@dataclass(frozen=True)
class AdditiveFault(SensorFault, ABC):
    """Fault that adds an error to one measured quantity.

    Attributes
    ----------
    channel
        Name of the quantity; "": the first of the sensor.
    direction
        Direction of errors of vectors and rotations, unit vector.
    """

    channel: str = quantity(
        "",
        help="faulty quantity: range, speed (velocimeter), rate or acceleration (inertial unit), "
        "position, velocity or attitude; omitted: the first that the sensor has",
    )
    direction: tuple[float, float, float] = quantity(
        (0.0, 0.0, 1.0),
        help="direction of the error of a vector or of a rotation, unit vector in body axes; ENU "
        "for position, velocity and the attitude of a navigation fix",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_direction("sensor_faults.direction", self.direction)

    @classmethod
    def applies_to(cls, measurement_type: type) -> bool:
        """Return whether a measured quantity of the sensor can have an error added."""
        return bool(channels_of(measurement_type))

    @abstractmethod
    def offset(
        self, channel: str, time: float, shape: tuple[int, ...], rng: np.random.Generator
    ) -> Array:
        """Return the error of a quantity with a shape at a time (s), in SI units."""

    def apply(self, measurement: Any, held: Any, time: float, rng: np.random.Generator) -> Any:
        """Return the measurement with the error added to its quantity."""
        channel = self.channel or channels_of(type(measurement))[0]
        if channel == "attitude":
            turn = quat_from_rotation_vector(self.offset(channel, time, (3,), rng))
            pair = (measurement.attitude, turn)
            if isinstance(measurement, NavigationFix):
                pair = (turn, measurement.attitude)
            return replace(measurement, attitude=quat_multiply(*pair))
        value = getattr(measurement, channel)
        error = self.offset(channel, time, np.shape(value), rng)
        if channel == "range":  # a range that is not positive is no return
            value = np.asarray(value + error)
            lost = value <= 0.0
            value = np.where(lost, np.nan, value)
            faulty = replace(measurement, range=value if value.ndim else float(value))
            return _without_returns(faulty, lost)
        return replace(measurement, **{channel: value + error})


class SystematicFault(AdditiveFault):
    """Fault that adds an error of a known size.

    The error of a vector has the direction of the fault; all ranges and all speeds of a sensor have
    the same error.
    """

    @abstractmethod
    def size_at(self, time: float) -> float:
        """Return the size of the error at a time, s, in SI units."""

    def offset(
        self, channel: str, time: float, shape: tuple[int, ...], rng: np.random.Generator
    ) -> Array:
        """Return the error of a quantity with a shape at a time (s), in SI units."""
        size = self.size_at(time)
        return size * np.asarray(self.direction) if channel in _VECTORS else np.full(shape, size)


@dataclass(frozen=True)
class BiasFault(SystematicFault):
    """Constant error of a measured quantity."""

    size: float = quantity(
        0.0,
        ge=-1e4,
        le=1e4,
        help="error in SI units and radians: m, m/s, rad, rad/s or m/s^2",
    )

    def size_at(self, time: float) -> float:
        """Return the constant error, in SI units."""
        return self.size


@dataclass(frozen=True)
class DriftFault(SystematicFault):
    """Error of a measured quantity that grows from zero in proportion to time."""

    rate: float = quantity(
        0.0,
        ge=-1e3,
        le=1e3,
        help="growth of the error in one second, SI units and radians: m/s for a range",
    )

    def size_at(self, time: float) -> float:
        """Return the error at a time, s, in SI units."""
        return self.rate * (time - self.start)


@dataclass(frozen=True)
class NoiseFault(AdditiveFault):
    """Additional white noise of a measured quantity, unknown to the onboard computer."""

    sigma: float = quantity(
        0.0,
        ge=0,
        le=1e4,
        help="noise of each element of a measurement, 1 sigma, SI units and radians",
    )

    def offset(
        self, channel: str, time: float, shape: tuple[int, ...], rng: np.random.Generator
    ) -> Array:
        """Sample the noise of all elements, in SI units; the direction is not used."""
        return np.asarray(self.sigma * rng.standard_normal(shape))


@dataclass(frozen=True)
class DropoutFault(SensorFault):
    """Sensor without measurements."""

    is_silent: ClassVar[bool] = True


@dataclass(frozen=True)
class FrozenFault(SensorFault):
    """Sensor that repeats its last measurement with current time stamps."""

    @classmethod
    def applies_to(cls, measurement_type: type) -> bool:
        """Return True: every sensor can freeze."""
        return True

    def apply(self, measurement: Any, held: Any, time: float, rng: np.random.Generator) -> Any:
        """Return the last measurement with the time stamp and pointing of the new one."""
        if held is None:
            return measurement
        current = ("time", "mount", "camera")
        return replace(held, **{n: getattr(measurement, n) for n in current if hasattr(held, n)})


@dataclass(frozen=True)
class LatencyFault(SensorFault):
    """Measurements that are older than their time stamps."""

    delay: float = quantity(
        0.1, "s", gt=0, le=60, help="age of a measurement, rounded up to control cycles"
    )


@dataclass(frozen=True)
class RangeGateFault(SensorFault):
    """Wrong range gate: returns from outside the gate are lost."""

    gate_min: float = quantity(0.0, "m", ge=0, help="minimum range of the gate")
    gate_max: float = quantity(1e6, "m", gt=0, help="maximum range of the gate")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gate_min >= self.gate_max:
            raise InputError(
                "sensor_faults.gate_min", self.gate_min,
                f"must be less than gate_max_m, which is {self.gate_max:g} m",
            )  # fmt: skip

    @classmethod
    def applies_to(cls, measurement_type: type) -> bool:
        """Return whether the sensor measures ranges."""
        return "range" in channels_of(measurement_type)

    def apply(self, measurement: Any, held: Any, time: float, rng: np.random.Generator) -> Any:
        """Return the measurement without returns from outside the gate."""
        distance = np.asarray(measurement.range)
        return _without_returns(
            measurement, (distance < self.gate_min) | (distance > self.gate_max)
        )


def _without_returns(measurement: Any, lost: Any) -> Any:
    """Return a measurement of ranges with NaN where returns are `lost`."""
    changed = {}
    for name in _RETURN_FIELDS:
        if hasattr(measurement, name):
            value = np.where(lost, np.nan, getattr(measurement, name))
            changed[name] = value if value.ndim else float(value)
    return replace(measurement, **changed)


ActiveFaults = Sequence[tuple[SensorFault, np.random.Generator]]
