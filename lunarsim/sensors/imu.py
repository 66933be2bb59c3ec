"""Strapdown inertial measurement unit: increments of angle and velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.messages.measurements import InertialSamples
from lunarsim.models.inertial_unit import (
    ACCELEROMETER_UNITS,
    GYROSCOPE_UNITS,
    TACTICAL_ACCELEROMETERS,
    TACTICAL_GYROSCOPES,
    TriadErrors,
    in_si_units,
)
from lunarsim.models.instruments import InertialInstrument
from lunarsim.parts.quantity import quantity
from lunarsim.sensors import _imu_kernels as kernels
from lunarsim.typing import Array


@dataclass(frozen=True)
class ImuSettings:
    """Settings of an inertial measurement unit, sampled at every simulation step.

    The default errors are those of a tactical-grade unit.
    """

    gyroscopes: TriadErrors = quantity(
        TACTICAL_GYROSCOPES, help="errors of the gyroscopes; unit u of the errors is rad"
    )
    accelerometers: TriadErrors = quantity(
        TACTICAL_ACCELEROMETERS, help="errors of the accelerometers; unit u of the errors is m/s"
    )

    measurement_type: ClassVar[type] = InertialSamples
    is_tasked: ClassVar[bool] = False

    @staticmethod
    def convert_table(table: Any) -> Any:
        """Return a scenario table with values in datasheet units converted to SI units.

        Raises
        ------
        InputError
            If a text is not a number and a unit that its key allows.
        """
        units = {"gyroscopes": GYROSCOPE_UNITS, "accelerometers": ACCELEROMETER_UNITS}
        out = dict(table)
        for triad in units.keys() & out.keys():
            try:
                out[triad] = in_si_units(out[triad], units[triad])
            except InputError as error:
                raise error.with_field(f"{triad}.{error.field}") from None
        return out

    def build(self, rng: np.random.Generator, step: float) -> Imu:
        """Return the unit of one flight; its constant errors and noise come from `rng`.

        The unit takes one sample every `step` seconds.
        """
        return Imu(rng, 1.0 / step, self.gyroscopes, self.accelerometers)

    def calibration(self) -> InertialInstrument:
        """Return the calibration for the onboard computer: the statistics of all errors.

        The errors that were sampled for the flight are not part of it.
        """
        return InertialInstrument(self.gyroscopes, self.accelerometers)


class _Triad:
    """Three orthogonal gyroscopes or accelerometers with their simulated errors."""

    def __init__(self, errors: TriadErrors, step: float, rng: np.random.Generator) -> None:
        self.errors = errors
        self.step = step
        self.rng = rng
        self.bias = errors.bias * rng.standard_normal(3)
        mixed = errors.misalignment * rng.standard_normal((3, 3))
        np.fill_diagonal(mixed, errors.scale_factor * rng.standard_normal(3))
        self.matrix = np.eye(3) + mixed
        self.remainder = np.zeros(3)
        self.instability = np.zeros(3)
        if errors.bias_instability > 0.0:
            self.instability = errors.instability_sigma * rng.standard_normal(3)

    def offsets(self, n: int) -> Array:
        """Sample the additive errors (n, 3), bias and noise, of the next n increments."""
        e, dt = self.errors, self.step
        walk = e.bias_walk * np.sqrt(dt) * self.rng.standard_normal((n, 3))
        noise = e.random_walk * np.sqrt(dt) * self.rng.standard_normal((n, 3))
        bias = self.bias + np.cumsum(walk, axis=0)
        self.bias = bias[-1].copy()
        if e.bias_instability > 0.0:
            bias += self._instability_errors(n)
        return np.asarray(bias * dt + noise)

    def _instability_errors(self, n: int) -> Array:
        """Sample the Gauss-Markov bias errors (n, 3) of the next n samples, u/s."""
        keep = np.exp(-self.step / self.errors.correlation_time)
        noise = self.errors.instability_sigma * np.sqrt(1.0 - keep**2)
        out = np.empty((n, 3))
        for i, drawn in enumerate(noise * self.rng.standard_normal((n, 3))):
            self.instability = out[i] = keep * self.instability + drawn
        return out

    def increments(self, truth: Array) -> Array:
        """Return measured increments (n, 3) for true increments (n, 3), rad or m/s."""
        return self.with_offsets(truth, self.offsets(len(truth)), self.matrix)

    def with_offsets(self, truth: Array, offsets: Array, matrix: Array) -> Array:
        """Return measured increments (n, 3) with given additive errors and error matrix."""
        return np.asarray(
            kernels.sample_increments(
                np.ascontiguousarray(truth), matrix, offsets, self.errors.quantum, self.remainder
            )
        )


class Imu:
    """Simulated inertial measurement unit of one flight.

    Parameters
    ----------
    rng
        Source of the constant errors of this flight and of all noise.
    rate
        Sampling rate, Hz.
    gyroscopes, accelerometers
        Error parameters; omitted: a tactical-grade unit.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        rate: float = 100.0,
        gyroscopes: TriadErrors = TACTICAL_GYROSCOPES,
        accelerometers: TriadErrors = TACTICAL_ACCELEROMETERS,
    ) -> None:
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError("imu.rate", rate, "must be positive and finite")
        self.step = 1.0 / rate
        first, second = rng.spawn(2)
        self.gyroscopes = _Triad(gyroscopes, self.step, first)
        self.accelerometers = _Triad(accelerometers, self.step, second)

    def measure(self, rate: ArrayLike, specific_force: ArrayLike) -> tuple[Array, Array]:
        """Measure angle and velocity increments of consecutive samples.

        Parameters
        ----------
        rate
            Mean angular velocity of each sample (n, 3) or (3,), body axes, rad/s.
        specific_force
            Mean acceleration minus gravity (n, 3) or (3,), body axes, m/s^2; in flight, thrust
            divided by mass along body z.

        Returns
        -------
        angle, velocity
            Increments, in the shape of the input, rad and m/s.
        """
        shape = np.shape(rate)
        rate = np.atleast_2d(np.asarray(rate, dtype=np.float64))
        force = np.atleast_2d(np.asarray(specific_force, dtype=np.float64))
        if rate.shape != force.shape or rate.shape[1:] != (3,):
            raise InputError(
                "imu.specific_force", force.shape, f"must have the shape of rate, {rate.shape}"
            )
        angle = self.gyroscopes.increments(rate * self.step)
        velocity = self.accelerometers.increments(force * self.step)
        return angle.reshape(shape), velocity.reshape(shape)

    def sample_trajectory(
        self, rows: Array, step: float, gravity: float, time: float, angle: Array | None = None
    ) -> InertialSamples:
        """Measure angle and velocity increments along a true trajectory.

        Parameters
        ----------
        rows
            State vectors (n + 1, 15); the first is the state before the first sample.
        step
            Time between states, s, which must be the sampling time of the unit.
        gravity
            Downward acceleration, m/s^2.
        time
            Time of the last state, s.
        angle
            Increments already measured by the gyroscopes (n, 3), rad; omitted: they are sampled.
        """
        turn, gained = np.empty((2, len(rows) - 1, 3))
        kernels.ideal_increments(np.ascontiguousarray(rows), gravity * step, turn, gained)
        if angle is None:
            angle = self.gyroscopes.increments(turn)
        return InertialSamples(time, angle, self.accelerometers.increments(gained))
