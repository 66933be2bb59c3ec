"""Strap-down inertial measurement unit: increments of angle and velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.frames import quat_conjugate, quat_multiply, quat_rotate, quat_to_rotation_vector
from lunarsim.messages.measurements import InertialSamples
from lunarsim.models.inertial_unit import ACCELEROMETERS, GYROSCOPES, InertialErrors

Array = NDArray[np.float64]


class _Triad:
    """Three axes with errors drawn once, and a bias that walks."""

    def __init__(self, errors: InertialErrors, step: float, rng: np.random.Generator) -> None:
        self.errors = errors
        self.step = step
        self.rng = rng
        self.bias = errors.bias * rng.standard_normal(3)
        mixed = errors.misalignment * rng.standard_normal((3, 3))
        np.fill_diagonal(mixed, errors.scale_factor * rng.standard_normal(3))
        self.matrix = np.eye(3) + mixed
        self.remainder = np.zeros(3)

    def increments(self, truth: Array) -> Array:
        """Return increments (n, 3) for the mean rates `truth` (n, 3) of n samples."""
        e, dt = self.errors, self.step
        n = len(truth)
        walk = e.bias_walk * np.sqrt(dt) * self.rng.standard_normal((n, 3))
        noise = e.random_walk * np.sqrt(dt) * self.rng.standard_normal((n, 3))
        bias = self.bias + np.cumsum(walk, axis=0)
        self.bias = bias[-1].copy()
        steps = (truth @ self.matrix.T + bias) * dt + noise
        if e.quantum == 0.0:
            return np.asarray(steps)
        # The sum is rounded, not the increments, so that no angle or velocity is lost.
        total = self.remainder + np.cumsum(steps, axis=0)
        whole = e.quantum * np.rint(total / e.quantum)
        self.remainder = total[-1] - whole[-1]
        return np.diff(whole, axis=0, prepend=np.zeros((1, 3)))


class Imu:
    """Gyroscopes and accelerometers of one power-on.

    Parameters
    ----------
    rng
        Source of the constants of this power-on and of all noise.
    rate
        Samples a second, Hz.
    gyroscopes, accelerometers
        Their errors; left out: a tactical unit.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        rate: float = 100.0,
        gyroscopes: InertialErrors = GYROSCOPES,
        accelerometers: InertialErrors = ACCELEROMETERS,
    ) -> None:
        if not (np.isfinite(rate) and rate > 0.0):
            raise InputError("imu.rate", rate, "a positive number of samples a second")
        self.step = 1.0 / rate
        first, second = rng.spawn(2)
        self._gyroscopes = _Triad(gyroscopes, self.step, first)
        self._accelerometers = _Triad(accelerometers, self.step, second)

    def measure(self, rate: ArrayLike, specific_force: ArrayLike) -> tuple[Array, Array]:
        """Return what the unit gives for consecutive samples.

        Parameters
        ----------
        rate
            Mean angular velocity of each sample (n, 3) or (3,), body axes, rad/s.
        specific_force
            Mean acceleration less gravity (n, 3) or (3,), body axes, m/s^2; in flight thrust over
            mass along body z.

        Returns
        -------
        angle, velocity
            Increments, in the shape of the input, rad and m/s.
        """
        shape = np.shape(rate)
        rate = np.atleast_2d(np.asarray(rate, dtype=np.float64))
        force = np.atleast_2d(np.asarray(specific_force, dtype=np.float64))
        if rate.shape != force.shape or rate.shape[1:] != (3,):
            raise InputError("imu.specific_force", force.shape, f"the shape of rate, {rate.shape}")
        angle = self._gyroscopes.increments(rate)
        velocity = self._accelerometers.increments(force)
        return angle.reshape(shape), velocity.reshape(shape)

    def sense(self, rows: Array, step: float, gravity: float, time: float) -> InertialSamples:
        """Return the samples of a stretch of true motion.

        Parameters
        ----------
        rows
            State vectors (n + 1, 15), the first that before the stretch.
        step
            Between them, s; that of the unit.
        gravity
            Downward acceleration, m/s^2.
        time
            Of the last row, s.
        """
        q = rows[:, 6:10]
        turn = quat_to_rotation_vector(quat_multiply(quat_conjugate(q[:-1]), q[1:]))
        middle = q[:-1] + np.where((q[:-1] * q[1:]).sum(1) < 0.0, -1.0, 1.0)[:, None] * q[1:]
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        force = np.diff(rows[:, 3:6], axis=0) / step + [0.0, 0.0, gravity]
        angle, velocity = self.measure(turn / step, quat_rotate(quat_conjugate(middle), force))
        return InertialSamples(time, angle, velocity)
