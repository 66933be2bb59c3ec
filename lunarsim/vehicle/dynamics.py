"""Six-degree-of-freedom motion of the lander at a fixed step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.messages.commands import Command
from lunarsim.models.gravity import CentralGravity
from lunarsim.models.lander import Lander
from lunarsim.vehicle import _kernels as k
from lunarsim.vehicle.state import State

Array = NDArray[np.float64]


def rig_of(
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
    """Return what acts on the body besides thrust along body z and torques, for kernels (21,).

    Parameters
    ----------
    force, flow
        Of all thrusters, body axes (3,), N, and the propellant that they burn, kg/s.
    engine, pivot
        Unit vector (3,) along which the engine pushes, and where, body axes, m.
    com_dry, com_full
        Centre of mass with tanks empty and full (3,), body axes, m.
    spent
        Propellant of the thrusters burnt so far, kg.
    radius, spin
        Of the Moon, m, and angular velocity of the frame (3,), ENU, rad/s; radius 0: level ground.
    """
    parts = (force, flow, engine, pivot, com_dry, com_full, spent, radius, spin)
    return np.concatenate([np.atleast_1d(np.asarray(p, dtype=np.float64)) for p in parts])


# One engine through a centre of mass that stays where it is, and torques.
PLAIN_RIG = rig_of()


@dataclass(frozen=True)
class Dynamics:
    """Rigid body with variable mass, integrated by classical Runge-Kutta.

    ``r' = v``, ``v' = R(q) (0, 0, T) / m - (0, 0, g)``, ``q' = q (w, 0) / 2``,
    ``I(m) w' = tau - w x I(m) w``, ``m' = -T / (Isp g0)``, ``T' = (T_c - T) / lag``. Inertia is
    linear in the propellant left; the momentum that leaves with the exhaust balances the change
    of inertia, so no jet damping appears. Fuel slosh and plume effects are not modelled.

    With a `rig` thrusters push as well, the engine is swung, and all torques are about a centre of
    mass that moves in the body as tanks empty: ``v' = R(q) (T d + F) / m - (0, 0, g)``,
    ``I w' = tau + p x T d - c(m) x (T d + F) - w x I w``, ``m' = -T / (Isp g0) - f``. The position
    is that of the centre of mass; its slow drift in the body adds no momentum of its own.

    On a round `moon` gravity is ``-g R^2 r / |r|^3`` with r from its centre, and the frame turns:
    ``- 2 W x v - W x (W x r)`` comes to v'. Attitude and body rate are those against the frame;
    what its turning, 2.7e-6 rad/s, does to Euler's equations is left out.

    Attributes
    ----------
    lander
        The vehicle.
    gravity
        Downward acceleration at the frame's origin, m/s^2.
    step
        Integration step, s.
    moon
        Central gravity in a turning frame; None: level ground and uniform gravity.
    """

    lander: Lander
    gravity: float
    step: float = 0.01
    moon: CentralGravity | None = None

    def __post_init__(self) -> None:
        for name in ("gravity", "step"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"dynamics.{name}", value, "a positive number")

    @property
    def plain_rig(self) -> Array:
        """What acts on a body that torques alone turn, for kernels; see `rig_of` (21,)."""
        return PLAIN_RIG if self.moon is None else self.on_moon(PLAIN_RIG.copy())

    def on_moon(self, rig: Array) -> Array:
        """Write the Moon's radius and spin into what kernels take, and return it (21,)."""
        if self.moon is not None:
            rig[17], rig[18:] = self.moon.radius, self.moon.spin
        return rig

    @property
    def figures(self) -> Array:
        """Gravity, exhaust velocity, thrust lag, dry and wet mass, as kernels take them (5,)."""
        v = self.lander
        return np.array([self.gravity, v.exhaust_velocity, v.thrust_lag, v.dry_mass, v.wet_mass])

    @property
    def inertia(self) -> Array:
        """Principal moments with tanks empty and full, as kernels take them (2, 3), kg m^2."""
        return np.array([self.lander.inertia_dry, self.lander.inertia_full], dtype=np.float64)

    def thrust(self, wanted: float) -> float:
        """Return what the engine makes of a wanted thrust (N): 0, or within the throttle range."""
        return (
            min(max(wanted, self.lander.thrust_min), self.lander.thrust_max) if wanted > 0 else 0.0
        )

    def advance(self, state: State, thrust: float, torque: Array) -> State:
        """Return the state a step later under a thrust (N) and torques (3,), N m."""
        limit = np.asarray(self.lander.torque_max)
        return self.advance_rigged(
            state, self.thrust(thrust), np.clip(torque, -limit, limit), self.plain_rig
        )

    def advance_rigged(self, state: State, thrust: float, torque: Array, rig: Array) -> State:
        """Return the state a step later under a thrust that is taken as it is.

        Parameters
        ----------
        state
            Before the step.
        thrust
            Asked of the engine's lag, N.
        torque
            About the origin of the body axes (3,), N m.
        rig
            See `rig_of` (21,).
        """
        y = state.as_vector()
        k.advance_body(
            y, self.step, thrust, np.asarray(torque, dtype=np.float64), self.figures, self.inertia,
            rig, np.empty((5, 15)),
        )  # fmt: skip
        return State.from_vector(y)

    def advance_ideal(self, state: State, command: Command, slew_limit: float, steps: int) -> Array:
        """Return the state vectors (steps, 15) with an ideal attitude actuator.

        The attitude follows the command along the shortest arc at no more than `slew_limit` (rad/s;
        section IV.A.3 of the shadow EKF paper).
        """
        return np.asarray(
            k.advance_ideal(
                state.as_vector(), steps, self.step, self.thrust(command.thrust),
                np.ascontiguousarray(command.attitude, dtype=np.float64), slew_limit, self.figures,
                self.inertia, self.plain_rig,
            )
        )  # fmt: skip
