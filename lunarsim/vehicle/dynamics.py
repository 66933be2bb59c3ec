"""Six-degree-of-freedom motion of the lander with a fixed step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.messages.commands import Command
from lunarsim.models.gravity import CentralGravity
from lunarsim.models.lander import Lander
from lunarsim.typing import Array
from lunarsim.vehicle import _kernels as k
from lunarsim.vehicle.state import State


def build_rig(
    *,
    force: ArrayLike = (0.0, 0.0, 0.0),
    flow: float = 0.0,
    engine: ArrayLike = (0.0, 0.0, 1.0),
    pivot: ArrayLike = (0.0, 0.0, 0.0),
    com_dry: ArrayLike = (0.0, 0.0, 0.0),
    com_full: ArrayLike = (0.0, 0.0, 0.0),
    spent: float = 0.0,
    radius: float = 0.0,
    spin: ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """Pack forces and geometry of a vehicle into an array for compiled functions.

    The array has shape (21,). The defaults are an engine through a fixed centre of mass, without
    thrusters, on a flat Moon.

    Parameters
    ----------
    force, flow
        Total force of the thrusters, body axes (3,), N, and their propellant flow, kg/s.
    engine, pivot
        Unit vector of the engine's thrust (3,), and its point of application, body axes, m.
    com_dry, com_full
        Centre of mass with tanks empty and full (3,), body axes, m.
    spent
        Thruster propellant used so far, kg.
    radius, spin
        Radius of the Moon, m, and angular velocity of the frame (3,), ENU, rad/s; radius 0: flat
        Moon.
    """
    parts = (force, flow, engine, pivot, com_dry, com_full, spent, radius, spin)
    return np.concatenate([np.atleast_1d(np.asarray(p, dtype=np.float64)) for p in parts])


# One engine through a fixed centre of mass, and torques.
PLAIN_RIG = build_rig()


def thrust_axis(about_x: float, about_y: float) -> tuple[float, float, float]:
    """Return the thrust axis (3,), body axes, for rotations of the engine, rad."""
    return (
        np.sin(about_y) * np.cos(about_x), -np.sin(about_x), np.cos(about_y) * np.cos(about_x),
    )  # fmt: skip


@dataclass(frozen=True)
class Dynamics:
    """Motion of a rigid body with variable mass, integrated by the Runge-Kutta method.

    ``r' = v``, ``v' = R(q) (0, 0, T) / m - (0, 0, g)``, ``q' = q (w, 0) / 2``,
    ``I(m) w' = tau - w x I(m) w``, ``m' = -T / (Isp g0)``, ``T' = (T_c - T) / lag``. Inertia is
    linear in propellant mass; the angular momentum of the exhaust balances the change of inertia,
    so that no jet damping appears. Slosh and plume effects are not modelled.

    With a `rig`, thrusters also push, the engine is gimballed, and torques act about a centre of
    mass that moves in the body: ``v' = R(q) (T d + F) / m - (0, 0, g)``,
    ``I w' = tau + p x T d - c(m) x (T d + F) - w x I w``, ``m' = -T / (Isp g0) - f``. The position
    is that of the centre of mass; the momentum of its slow drift in the body is neglected.

    On a round `moon`, gravity is ``-g R^2 r / |r|^3`` with r from the centre. The frame rotates,
    which adds ``- 2 W x v - W x (W x r)`` to v'. Attitude and body rate are relative to the frame;
    the effect of its rotation (2.7e-6 rad/s) on Euler's equations is neglected.

    Attributes
    ----------
    lander
        Vehicle model.
    gravity
        Downward acceleration at the frame's origin, m/s^2.
    step
        Integration step, s.
    moon
        Central gravity in a rotating frame; None: flat Moon and uniform gravity.
    """

    lander: Lander
    gravity: float
    step: float = 0.01
    moon: CentralGravity | None = None

    def __post_init__(self) -> None:
        for name in ("gravity", "step"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"dynamics.{name}", value, "must be positive and finite")

    @cached_property
    def plain_rig(self) -> Array:
        """Array (21,) of `build_rig` for a body without thrusters and gimbal."""
        v = self.lander
        return self.on_moon(
            build_rig(
                engine=thrust_axis(*v.thrust_misalignment), com_dry=v.com_offset,
                com_full=v.com_offset,
            )
        )  # fmt: skip

    def on_moon(self, rig: Array) -> Array:
        """Write the Moon's radius and spin into an array of `build_rig`; return the array.

        On a flat Moon, `rig` (21,) remains unchanged.
        """
        if self.moon is not None:
            rig[17], rig[18:] = self.moon.radius, self.moon.spin
        return rig

    @property
    def params(self) -> Array:
        """Gravity, exhaust velocity, thrust lag, dry and wet mass as an array (5,), SI."""
        v = self.lander
        return np.array([self.gravity, v.exhaust_velocity, v.thrust_lag, v.dry_mass, v.wet_mass])

    @property
    def inertia(self) -> Array:
        """Principal moments of inertia (2, 3), kg m^2, with tanks empty and full."""
        return np.array([self.lander.inertia_dry, self.lander.inertia_full], dtype=np.float64)

    def thrust(self, commanded_thrust: float) -> float:
        """Return the true thrust for a command, N: clipped to the throttle range, or 0.

        A command of 0 or less gives 0.
        """
        if commanded_thrust <= 0:
            return 0.0
        v = self.lander
        return v.thrust_scale * min(max(commanded_thrust, v.thrust_min), v.thrust_max)

    def advance(self, state: State, thrust: float, torque: Array) -> State:
        """Return the state one step later for commanded thrust (N) and torques (3,), N m.

        Thrust and torques are clipped to the limits of the lander.
        """
        limit = np.asarray(self.lander.torque_max)
        torque = self.lander.torque_scale * np.clip(torque, -limit, limit)
        return self.advance_with_rig(state, self.thrust(thrust), torque, self.plain_rig)

    def advance_with_rig(self, state: State, thrust: float, torque: Array, rig: Array) -> State:
        """Return the state one step later for given forces, without limits.

        Parameters
        ----------
        state
            State before the step.
        thrust
            Input of the engine's lag, N.
        torque
            Torque about the origin of the body axes (3,), N m.
        rig
            Forces and geometry from `build_rig` (21,).
        """
        y = state.as_vector()
        k.advance_body(
            y, self.step, thrust, np.asarray(torque, dtype=np.float64), self.params, self.inertia,
            rig, np.empty((5, 15)),
        )  # fmt: skip
        return State.from_vector(y)

    def advance_ideal(self, state: State, command: Command, slew_limit: float, steps: int) -> Array:
        """Simulate several steps with an ideal attitude actuator.

        Returns the state vector after each step (steps, 15).

        The attitude follows the command along the shortest arc at `slew_limit` or less (rad/s;
        shadow EKF paper, section IV.A.3).
        """
        return np.asarray(
            k.advance_ideal(
                state.as_vector(), steps, self.step, self.thrust(command.thrust),
                np.ascontiguousarray(command.attitude, dtype=np.float64), slew_limit, self.params,
                self.inertia, self.plain_rig,
            )
        )  # fmt: skip
