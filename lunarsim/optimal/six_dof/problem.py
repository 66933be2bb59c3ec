"""Minimum-propellant landing problem of a rigid body."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.frames import angle_between
from lunarsim.models.lander import Lander
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.validation import check_numbers, is_number
from lunarsim.typing import Array


class InitialState(Protocol):
    """Initial state of a descent; `lunarsim.vehicle.State` satisfies this interface."""

    @property
    def position(self) -> Array:
        """Position in ENU (3,), m."""

    @property
    def velocity(self) -> Array:
        """Velocity in ENU (3,), m/s."""

    @property
    def attitude(self) -> Array:
        """Rotation from body axes to ENU as a unit quaternion, scalar last (4,)."""

    @property
    def rate(self) -> Array:
        """Angular rate in body axes (3,), rad/s."""

    @property
    def mass(self) -> float:
        """Mass of the vehicle, kg."""

    @property
    def thrust(self) -> float:
        """Current thrust of the engine, N."""


@dataclass(frozen=True)
class SiteVisibility:
    """Sensor that must see the landing site.

    Attributes
    ----------
    axis
        Boresight, body axes (3,); normalised.
    half_angle
        Half angle of the field of view around the boresight, rad.
    visible_fraction
        Fraction of the descent, from its start, during which the site must be visible.

    Raises
    ------
    InputError
        If the axis is zero, or an angle or fraction is invalid.
    """

    axis: Array
    half_angle: float
    visible_fraction: float = 0.7

    def __post_init__(self) -> None:
        axis = check_numbers("sight.axis", self.axis, (3,), "must be three numbers, not all 0")
        if np.linalg.norm(axis) == 0.0:
            raise InputError(
                "optimal.sight.axis", axis.tolist(), "must be three numbers, not all 0"
            )
        object.__setattr__(self, "axis", axis / np.linalg.norm(axis))
        if not (is_number(self.half_angle) and 0.0 < self.half_angle < 0.5 * np.pi):
            raise InputError(
                "optimal.sight.half_angle",
                self.half_angle,
                "must be more than 0 and less than pi/2 rad (90 degrees)",
            )
        if not (is_number(self.visible_fraction) and 0.0 < self.visible_fraction <= 1.0):
            raise InputError(
                "optimal.sight.visible_fraction",
                self.visible_fraction,
                "must be more than 0 and at most 1",
            )


# Shape of each value of an initial state.
_START_SHAPES = {
    "position": (3,), "velocity": (3,), "attitude": (4,), "rate": (3,), "mass": (), "thrust": (),
}  # fmt: skip


@dataclass(frozen=True)
class RigidDescent:
    """Powered descent of a rigid body, with the simulator's equations.

    The engine pushes along body z, responds with its lag, and cannot be shut down before touchdown;
    torques turn the body (`Dynamics`). At the end the body is upright and does not rotate.

    Attributes
    ----------
    lander
        Masses, moments of inertia, engine and torques.
    start
        Initial state, including mass and thrust.
    end_position, end_velocity
        Final state of the centre of mass (3,), ENU, m and m/s.
    gravity
        Downward acceleration, m/s^2.
    thrust_min, thrust_max
        Range of the thrust command, N; None: the lander's throttle range.
    torque_share
        Usable fraction of the lander's torques.
    max_tilt
        Maximum tilt of body z from the vertical, rad; None: no limit.
    max_rate
        Maximum angular rate of the body, rad/s; None: no limit.
    glideslope
        Minimum elevation of the path, seen from its end, rad; None: no limit.
    apex_depth
        Depth of the glideslope's apex below the end, m.
    sight
        Sensor that must see the site; None: no such constraint.
    reserve
        Propellant reserve at the end, kg.

    Raises
    ------
    InputError
        If a value is not finite or not admissible.
    """

    lander: Lander
    start: InitialState
    end_position: Array
    end_velocity: Array = field(default_factory=lambda: np.zeros(3))
    gravity: float = 1.622
    thrust_min: float | None = None
    thrust_max: float | None = None
    torque_share: float = 0.8
    max_tilt: float | None = None
    max_rate: float | None = None
    glideslope: float | None = None
    apex_depth: float = 0.5
    sight: SiteVisibility | None = None
    reserve: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.lander, Lander):
            raise InputError("optimal.lander", type(self.lander), "must be a Lander")
        for name in ("end_position", "end_velocity"):
            value = check_numbers(name, getattr(self, name), (3,), "must be three finite numbers")
            object.__setattr__(self, name, value)
        for name, given in (("thrust_min", self.lander.thrust_min),
                            ("thrust_max", self.lander.thrust_max)):  # fmt: skip
            if getattr(self, name) is None:
                object.__setattr__(self, name, given)
        if not (self.sight is None or isinstance(self.sight, SiteVisibility)):
            raise InputError("optimal.sight", type(self.sight), "must be a SiteVisibility or None")
        self._check_values()
        try:
            _ = self.start_vector
        except (AttributeError, TypeError, ValueError):
            raise InputError("optimal.start", type(self.start), "must be a State") from None
        for name, shape in _START_SHAPES.items():
            words = f"must be {shape[0]} finite numbers" if shape else "must be a finite number"
            check_numbers(f"start.{name}", getattr(self.start, name), shape, words)
        if abs(np.linalg.norm(self.start.attitude) - 1.0) > 1e-6:
            raise InputError(
                "optimal.start.attitude",
                float(np.linalg.norm(self.start.attitude)),
                "must be a unit quaternion, but its norm is "
                f"{np.linalg.norm(self.start.attitude):.6g}",
                show_value=False,
            )
        if not self.dry_mass < self.start.mass:
            raise InputError(
                "optimal.start.mass", self.start.mass,
                "must be more than the final mass (lander.dry_mass plus reserve), "
                f"{self.dry_mass} kg",
            )  # fmt: skip
        self._check_start()

    def _check_values(self) -> None:
        """Raise InputError if thrust range, gravity, a fraction, angle or rate is invalid."""
        low, high = self.lander.thrust_min, self.lander.thrust_max
        given = (self.thrust_min, self.thrust_max)
        if not (
            all(map(is_number, given))
            and low <= self.min_thrust_command < self.max_thrust_command <= high
        ):
            raise InputError(
                "optimal.thrust_min, optimal.thrust_max", given,
                f"must be two rising numbers within the throttle range of the lander, {low} to "
                f"{high} N",
            )  # fmt: skip
        if not (is_number(self.gravity) and self.gravity > 0.0):
            raise InputError("optimal.gravity", self.gravity, "must be a positive, finite number")
        if not (is_number(self.torque_share) and 0.0 < self.torque_share <= 1.0):
            raise InputError(
                "optimal.torque_share", self.torque_share, "must be more than 0 and at most 1"
            )
        for name in ("apex_depth", "reserve"):
            if not (is_number(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise InputError(
                    f"optimal.{name}", getattr(self, name), "must be a finite number of 0 or more"
                )
        for name in ("max_tilt", "glideslope"):
            angle = getattr(self, name)
            if angle is not None and not (is_number(angle) and 0.0 < angle < 0.5 * np.pi):
                raise InputError(
                    f"optimal.{name}",
                    angle,
                    "must be more than 0 and less than pi/2 rad (90 degrees)",
                )
        rate = self.max_rate
        if rate is not None and not (is_number(rate) and rate > 0.0):
            raise InputError("optimal.max_rate", self.max_rate, "must be a positive, finite number")

    def _check_start(self) -> None:
        """Raise InputError if the initial state violates a constraint."""
        at = self.start.position - self.end_position
        body = Rotation.from_quat(self.start.attitude)
        up = np.array([0.0, 0.0, 1.0])
        rate = float(np.linalg.norm(self.start.rate))
        held: list[tuple[str, str, float, str, float | None]] = [
            ("attitude", "a tilt", angle_between(body.apply(up), up), "max_tilt", self.max_tilt),
            ("rate", "a norm", rate, "max_rate", self.max_rate),
        ]  # fmt: skip
        if self.sight is not None:
            off = angle_between(body.apply(self.sight.axis), -at)
            angle = "an angle between sight.axis and the site"
            held.append(("attitude", angle, off, "sight.half_angle", self.sight.half_angle))
        for name, what, value, limit, most in held:
            if most is not None and value > most:
                unit = "deg/s" if name == "rate" else "deg"
                raise InputError(
                    f"optimal.start.{name}", value,
                    f"must give {what} of at most {np.rad2deg(most):.3f} {unit}, the value of "
                    f"{limit}, but gives {np.rad2deg(value):.3f} {unit}", show_value=False,
                )  # fmt: skip
        slope = np.tan(self.glideslope or 0.0) * np.hypot(at[0], at[1]) - self.apex_depth
        if self.glideslope is not None and at[2] < slope:
            raise InputError(
                "optimal.start.position", self.start.position.tolist(),
                f"must be at least {slope:.1f} m above the end, because of `glideslope`, but is "
                f"{at[2]:.1f} m above the end", show_value=False,
            )  # fmt: skip

    @property
    def start_vector(self) -> Array:
        """Initial state (15,): position, velocity, attitude, rate, mass, thrust."""
        s = self.start
        return np.concatenate((s.position, s.velocity, s.attitude, s.rate, [s.mass, s.thrust]))

    @property
    def min_thrust_command(self) -> float:
        """Minimum thrust command, N."""
        return float(self.thrust_min or 0.0)

    @property
    def max_thrust_command(self) -> float:
        """Maximum thrust command, N."""
        return float(self.thrust_max or 0.0)

    @property
    def dry_mass(self) -> float:
        """Minimum final mass, kg."""
        return self.lander.dry_mass + self.reserve

    @property
    def torques(self) -> Array:
        """Maximum torques about the body axes (3,), N m."""
        return self.torque_share * np.asarray(self.lander.torque_max)

    def as_point(self) -> Descent:
        """Return the corresponding descent of a point mass.

        Its thrust direction is free; only near the end its tilt is limited to what the body can
        turn.
        """
        return Descent(
            position=self.start.position, velocity=self.start.velocity, mass=self.start.mass,
            end_position=self.end_position, end_velocity=self.end_velocity, gravity=self.gravity,
            thrust_min=self.min_thrust_command, thrust_max=self.max_thrust_command,
            exhaust_velocity=self.lander.exhaust_velocity, dry_mass=self.dry_mass,
            max_tilt=self.max_tilt, glideslope=self.glideslope, apex_depth=self.apex_depth,
            max_final_tilt=np.deg2rad(5.0), tilt_rate=np.deg2rad(8.0),
        )  # fmt: skip
