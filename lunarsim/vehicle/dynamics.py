"""Six-degree-of-freedom motion of the lander at a fixed step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.vehicle import _kernels as k
from lunarsim.vehicle.state import State

AttitudeMode = Literal["slerp", "pd"]


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
    attitude_mode
        ``"slerp"``: the attitude follows the command along the shortest arc at no more than
        `rate_limit` (section IV.A.3 of the shadow EKF paper). ``"pd"``: quaternion
        proportional-derivative torques within the limits of the reaction control system.
    rate_limit
        Slew rate limit, rad/s.
    frequency, damping
        Natural frequency (rad/s) and damping ratio of the attitude loop, for ``"pd"``.
    """

    lander: Lander
    gravity: float
    step: float = 0.01
    attitude_mode: AttitudeMode = "pd"
    rate_limit: float = np.deg2rad(15.0)
    frequency: float = 4.0
    damping: float = 0.9

    def __post_init__(self) -> None:
        for name in ("gravity", "step", "rate_limit", "frequency", "damping"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"dynamics.{name}", value, "a positive number")

    @property
    def response_time(self) -> float:
        """Lag (s) with which the thrust vector follows a slowly changing command."""
        attitude = 2.0 * self.damping / self.frequency if self.attitude_mode == "pd" else 0.0
        return attitude + self.lander.thrust_lag

    def advance(self, state: State, command: Command, steps: int) -> NDArray[np.float64]:
        """Return the state vectors (steps, 15) after each step under a held command."""
        lander = self.lander
        thrust = command.thrust
        if thrust > 0.0:
            thrust = min(max(thrust, lander.thrust_min), lander.thrust_max)
        history = k.advance(
            state.as_vector(),
            steps,
            self.step,
            thrust,
            np.ascontiguousarray(command.attitude, dtype=np.float64),
            0 if self.attitude_mode == "slerp" else 1,
            self.rate_limit,
            self.frequency,
            self.damping,
            np.asarray(lander.torque_max, dtype=np.float64),
            self.gravity,
            lander.exhaust_velocity,
            lander.thrust_lag,
            lander.dry_mass,
            lander.wet_mass,
            np.asarray(lander.inertia_dry, dtype=np.float64),
            np.asarray(lander.inertia_full, dtype=np.float64),
        )
        return np.asarray(history)
