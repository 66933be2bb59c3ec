"""Strapdown inertial navigation and its error state (shadow EKF paper, Eqs. 1-8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.frames import is_rotation, normalised, quat_multiply, quat_to_matrix
from lunarsim.messages.briefing import Briefing
from lunarsim.models.gravity import GravityModel
from lunarsim.models.inertial_unit import TACTICAL_ACCELEROMETERS, TACTICAL_GYROSCOPES, TriadErrors
from lunarsim.models.instruments import InertialInstrument
from lunarsim.onboard.navigation import _inertial_kernels as kernels
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.navigation.imu_outlier_rejection import (
    CONFIRMATION_COUNT,
    ImuOutlierDetector,
    ImuSampleLimits,
)
from lunarsim.typing import Array
from lunarsim.value_checks import check_elements, check_finite, check_shape

# Positions in the error state (shadow EKF paper, Eq. 1).
POSITION, VELOCITY, ACCELEROMETER = slice(0, 3), slice(3, 6), slice(6, 9)
ATTITUDE, GYROSCOPE = slice(9, 12), slice(12, 15)
INERTIAL = 15
# Plausibility limits of the initial state: distance from the terrain centre (m), speed (m/s) and
# gravity (m/s^2).
_MAX_DISTANCE_M, _MAX_SPEED_M_S, _MAX_GRAVITY_M_S2 = 1e6, 2e4, 100.0


@dataclass(frozen=True)
class StartSigmas:
    """Standard deviations of the initial state of the lander, per axis.

    Attributes
    ----------
    position, velocity
        Standard deviations of position (m) and velocity (m/s).
    attitude
        Standard deviation of the attitude, rad.
    """

    position: float = 5.0
    velocity: float = 0.1
    attitude: float = np.deg2rad(0.05)

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "attitude"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"navigation.{name}", value, "must be positive and finite")


def _check_start(
    position: Array, velocity: Array, attitude: Array, gravity: float, step: float
) -> Array:
    """Check the initial state; return it as one array (10,).

    The array contains position, velocity and quaternion. `position` (ENU) is in m, `velocity` in
    m/s, `gravity` in m/s^2 and `step` in s. An `InputError` is raised if a value is not finite or
    out of range.
    """
    for name, value, limit, unit in (
        ("position", position, _MAX_DISTANCE_M, "m"), ("velocity", velocity, _MAX_SPEED_M_S, "m/s")
    ):  # fmt: skip
        check_shape(f"navigation.{name}", value, (3,))
        check_finite(f"navigation.{name}", value)
        is_valid = np.abs(value) <= limit
        problem = f"must be between {-limit:g} and {limit:g} {unit}"
        check_elements(f"navigation.{name}", value, is_valid, problem)
    if not is_rotation(attitude):
        raise InputError("navigation.attitude", attitude, "must be a unit quaternion (4,)")
    if not 0.0 < gravity <= _MAX_GRAVITY_M_S2:
        raise InputError(
            "navigation.gravity",
            gravity,
            f"must be positive and at most {_MAX_GRAVITY_M_S2:g} m/s^2",
        )
    if not (np.isfinite(step) and step > 0.0):
        raise InputError("navigation.step", step, "must be positive and finite")
    return np.concatenate((position, velocity, attitude)).astype(np.float64)


def checked_increments(angle: ArrayLike, velocity: ArrayLike) -> tuple[Array, Array]:
    """Return increments of angle, rad, and velocity, m/s, as two arrays (n, 3).

    Raises
    ------
    InputError
        If an array has another shape or the lengths differ.
    """
    out = np.asarray(angle, np.float64), np.asarray(velocity, np.float64)
    for name, values in zip(("angle", "velocity"), out, strict=True):
        if values.ndim != 2 or values.shape[1] != 3:
            raise InputError(
                f"inertial.{name}", values.shape, "must have shape (n, 3), one row per sample",
                "If a sample is missing, set its row to NaN.",
            )  # fmt: skip
    check_shape("inertial.velocity", out[1], out[0].shape, "like inertial.angle")
    return out


class StrapdownState:
    """Strapdown inertial navigation: state propagated with inertial samples.

    The state consists of position, velocity, attitude and the biases of the inertial unit.

    Parameters
    ----------
    position, velocity, attitude
        Initial estimate: ENU (3,) m and (3,) m/s, quaternion body to ENU (4,).
    gravity
        Downward acceleration, m/s^2.
    step
        Time between inertial samples, s.
    gyroscopes, accelerometers
        Error models of the inertial unit.
    limits
        Limits of the lander's dynamics, to reject outliers; default: limits of any lander.
    gravity_model
        Central gravity of a round Moon in its rotating frame; omitted: uniform `gravity`. The
        change of gravity with the error of the position is neglected.

    Raises
    ------
    InputError
        If a value is not finite, the attitude is not a unit quaternion, gravity or the step is not
        positive, or a value exceeds the plausibility limits (1,000 km, 20 km/s, 100 m/s^2).
    """

    def __init__(
        self,
        position: Array,
        velocity: Array,
        attitude: Array,
        gravity: float,
        *,
        step: float = 0.01,
        gyroscopes: TriadErrors = TACTICAL_GYROSCOPES,
        accelerometers: TriadErrors = TACTICAL_ACCELEROMETERS,
        limits: ImuSampleLimits | None = None,
        gravity_model: GravityModel | None = None,
    ) -> None:
        start = _check_start(position, velocity, attitude, gravity, step)
        self._gravity_model = gravity_model
        self._x = np.concatenate((start[:6], np.zeros(3), normalised(start[6:]), np.zeros(3)))
        self._gravity = np.array([0.0, 0.0, -gravity])
        self.step = step
        self._outlier_detector = ImuOutlierDetector(limits or ImuSampleLimits.unknown(), step)
        self._pending_events: list[tuple[str, dict[str, Any]]] = []
        self._density = np.array(
            [
                accelerometers.random_walk,
                gyroscopes.random_walk,
                accelerometers.total_bias_walk,
                gyroscopes.total_bias_walk,
            ]
        )
        # Random walk while samples are missing: 1 m/s^2 of thrust and 2 deg of rotation in 1 s.
        self._missing_density = np.array([1.0, 0.035])
        self._last_sample = np.concatenate((np.zeros(3), [0.0, 0.0, gravity]))
        # Variance of the attitude per squared rotation, by scale factors and misalignments.
        variance = np.full((3, 3), gyroscopes.misalignment**2)
        np.fill_diagonal(variance, gyroscopes.scale_factor**2)
        self._variance_per_rotation = variance
        self._rotation_since_start = np.zeros(3)
        # Scale factor and misalignment act as biases under constant thrust, here 3 m/s^2.
        self._bias_sigma = (
            float(
                np.hypot(
                    accelerometers.total_bias_sigma,
                    3.0 * np.hypot(accelerometers.scale_factor, accelerometers.misalignment),
                )
            ),
            gyroscopes.total_bias_sigma,
        )

    @classmethod
    def of(cls, briefing: Briefing) -> tuple[StrapdownState, StartSigmas]:
        """Return the initial state stated in a briefing, and its standard deviations.

        Raises
        ------
        InputError
            If there is no inertial unit.
        """
        unit = next(
            (i for i in briefing.instruments.values() if isinstance(i, InertialInstrument)), None
        )
        if unit is None:
            raise InputError(
                "sensors",
                sorted(briefing.instruments),
                "must include an inertial unit",
                "Add an inertial unit, or choose another navigation.kind.",
            )
        s = briefing.start
        sigmas = StartSigmas(
            max(s.position_sigma, 1e-3), max(s.velocity_sigma, 1e-4), max(s.attitude_sigma, 1e-6)
        )
        control = briefing.software.control
        limits = ImuSampleLimits.of(
            briefing.lander, briefing.step, unit.gyroscopes, unit.accelerometers,
            slew=0.0 if control.torques else control.slew_limit,
        )  # fmt: skip
        state = cls(
            s.position, s.velocity, s.attitude, briefing.surface_gravity, step=briefing.step,
            gyroscopes=unit.gyroscopes, accelerometers=unit.accelerometers, limits=limits,
            gravity_model=briefing.nonuniform_gravity,
        )  # fmt: skip
        return state, sigmas

    def covariance(self, errors: StartSigmas) -> Array:
        """Return the initial error covariance (15, 15) for given standard deviations.

        It is diagonal, in the order position, velocity, accelerometer bias, attitude, gyroscope
        bias. The standard deviations of the biases follow from the sensor specification.
        """
        sigmas = (
            errors.position, errors.velocity, self._bias_sigma[0], errors.attitude,
            self._bias_sigma[1],
        )  # fmt: skip
        return np.diag(np.repeat(np.square(sigmas), 3))

    @property
    def position(self) -> Array:
        """Estimated position, ENU (3,), m."""
        return self._x[0:3]

    @property
    def velocity(self) -> Array:
        """Estimated velocity, ENU (3,), m/s."""
        return self._x[3:6]

    @property
    def attitude(self) -> Array:
        """Estimated attitude, quaternion from body axes to ENU (4,)."""
        return self._x[9:13]

    @property
    def biases(self) -> tuple[Array, Array]:
        """Estimated biases of accelerometers (3,), m/s^2, and gyroscopes (3,), rad/s."""
        return self._x[6:9], self._x[13:16]

    @property
    def bias_sigma(self) -> tuple[float, float]:
        """Specified accelerometer and gyroscope bias, 1 sigma per axis, m/s^2 and rad/s.

        The accelerometer bias includes the effect of scale factor and misalignment under thrust.
        """
        return self._bias_sigma

    @property
    def rate(self) -> Array:
        """Body rate of the last valid sample, without the estimated bias (3,), rad/s."""
        return np.asarray(self._last_sample[:3] - self._x[13:16])

    def estimate(self, covariance: Array, time: float, mass: float) -> Estimate:
        """Return the current state as an `Estimate`.

        Parameters
        ----------
        covariance
            Covariance (n, n) of an error state whose first 15 errors are those of this state.
        time, mass
            Time (s) and mass (kg) of the estimate.
        """
        keep = np.r_[0:6, 9:12]
        # The error state has attitude errors in body axes, `Estimate` has them in ENU.
        turn = np.eye(9)
        turn[6:, 6:] = quat_to_matrix(self.attitude)
        return Estimate(
            time, self.position.copy(), self.velocity.copy(), self.attitude.copy(), self.rate, mass,
            turn @ covariance[np.ix_(keep, keep)] @ turn.T,
        )  # fmt: skip

    def propagate(self, angle: Array, velocity: Array) -> tuple[Array, Array]:
        """Propagate the state with inertial samples; NaN marks missing samples.

        `angle` (n, 3), rad, and `velocity` (n, 3), m/s, are the increments of gyroscopes and
        accelerometers. Samples that exceed the lander's dynamics count as missing
        (`ImuOutlierDetector`). If rate or specific force jump beyond these limits and stay there,
        the bias variances are increased by the squared jump.

        Returns
        -------
        transition, noise
            Transition matrix and process noise of the error state over all samples (15, 15).
        """
        angle, velocity = np.atleast_2d(angle), np.atleast_2d(velocity)
        screened = self._outlier_detector.screen(angle, velocity)
        if screened.rejected:
            self._pending_events.append(("samples-rejected", {"count": screened.rejected}))
        is_missing = screened.is_missing.reshape(-1, 1)
        if is_missing.any():
            angle, velocity = (
                np.where(is_missing, np.nan, angle),
                np.where(is_missing, np.nan, velocity),
            )
        if self._gravity_model is not None:
            middle = self.position + 0.5 * len(angle) * self.step * self.velocity
            self._gravity = self._gravity_model.free_fall_acceleration(middle, self.velocity)
        self._x, transition, noise = kernels.propagate(
            self._x, self._last_sample, angle, velocity, self.step,
            self._gravity, self._density, self._missing_density,
        )  # fmt: skip
        turn = np.nansum(angle, axis=0)
        before, self._rotation_since_start = (
            self._rotation_since_start,
            self._rotation_since_start + turn,
        )
        # A reverse rotation would cancel the error; the filter conservatively neglects this.
        growth = np.maximum(
            self._variance_per_rotation @ (self._rotation_since_start**2 - before**2), 0.0
        )
        noise[ATTITUDE, ATTITUDE] += np.diag(growth)
        if screened.jump.any():
            rate, force = float(screened.jump[:3].max()), float(screened.jump[3:].max())
            self._pending_events.append(("samples-jump", {"rate": rate, "force": force}))
            self._add_bias_jump(noise, screened.jump, len(angle))
        return transition, noise

    def _add_bias_jump(self, noise: Array, jump: Array, samples: int) -> None:
        """Add a jump of rate and specific force (6,) to the process noise (15, 15).

        `noise` is changed in place: the variances of the biases grow by the squared jump, those of
        attitude and velocity by the square of what the jump integrates to. `samples` is the number
        of samples of the propagation in which the jump was confirmed.
        """
        seconds = (samples + CONFIRMATION_COUNT) * self.step
        for bias, columns, of in (
            (GYROSCOPE, ATTITUDE, jump[:3]), (ACCELEROMETER, VELOCITY, jump[3:])
        ):  # fmt: skip
            noise[bias, bias] += np.diag(of**2)
            noise[columns, columns] += np.diag((seconds * of) ** 2)

    def pop_events(self) -> list[tuple[str, dict[str, Any]]]:
        """Return name and details of new events (rejected samples, jumps), and clear them."""
        events, self._pending_events = self._pending_events, []
        return events

    def correct(self, error: Array) -> None:
        """Add an estimated error (15,) to the state.

        The attitude is corrected by Eq. 8 of the shadow EKF paper, which preserves the norm of the
        quaternion.

        Raises
        ------
        InputError
            If the error is not 15 finite numbers; the state is then unchanged.
        """
        error = np.asarray(error, np.float64)
        check_shape("navigation.error", error, (INERTIAL,))
        check_finite("navigation.error", error)
        self._x[0:9] += error[0:9]
        gibbs = np.concatenate((0.5 * error[ATTITUDE], [1.0]))
        self._x[9:13] = normalised(quat_multiply(self._x[9:13], gibbs))
        self._x[13:16] += error[GYROSCOPE]
