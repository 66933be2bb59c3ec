"""Six-degree-of-freedom motion of the lander at a fixed step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.vehicle import _kernels as k
from lunarsim.vehicle.state import State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Dynamics:
    """Rigid body with variable mass, integrated by classical Runge-Kutta.

    ``r' = v``, ``v' = R(q) (0, 0, T) / m - (0, 0, g)``, ``q' = q (w, 0) / 2``,
    ``I(m) w' = tau - w x I(m) w``, ``m' = -T / (Isp g0)``, ``T' = (T_c - T) / lag``. Inertia is
    linear in the propellant left; the momentum that leaves with the exhaust balances the change
    of inertia, so no jet damping appears. Fuel slosh and plume effects are not modelled.

    Attributes
    ----------
    lander
        The vehicle.
    gravity
        Downward acceleration, m/s^2.
    step
        Integration step, s.
    """

    lander: Lander
    gravity: float
    step: float = 0.01

    def __post_init__(self) -> None:
        for name in ("gravity", "step"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"dynamics.{name}", value, "a positive number")

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
        y = state.as_vector()
        limit = np.asarray(self.lander.torque_max)
        k.advance_body(
            y, self.step, self.thrust(thrust), np.clip(torque, -limit, limit), self.figures,
            self.inertia, np.empty((5, 15)),
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
                self.inertia,
            )
        )  # fmt: skip
