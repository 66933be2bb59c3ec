"""Sloshing propellant in the tanks of one flight."""

from __future__ import annotations

import numpy as np

from lunarsim.models.jet_lander import JetLander
from lunarsim.typing import Array
from lunarsim.vehicle import _slosh_kernels as k
from lunarsim.vehicle.dynamics import Dynamics
from lunarsim.vehicle.state import State


class SloshPendulums:
    """Pendulums that model the sloshing propellant of one flight.

    The model is described in `lunarsim.models.slosh`. The position and velocity of a lander's state
    are those of the centre of mass that the lander has with its liquid at rest. Mass and pivot of a
    pendulum follow the remaining propellant and are constant within a step.

    Parameters
    ----------
    lander
        Lander with its tanks and masses.

    Attributes
    ----------
    rod_states
        Direction of each rod and its rate of change (n, 6), body axes; at rest along -z.
    max_angles
        Maximum angle of each rod from body -z so far (n,), rad.
    """

    def __init__(self, lander: JetLander) -> None:
        self._tanks = lander.slosh.table(lander.propellant_mass)
        self.rod_states = np.zeros((len(self._tanks), 6))
        self.rod_states[:, 2] = -1.0
        self.max_angles = np.zeros(len(self._tanks))

    @property
    def angles(self) -> Array:
        """Angles of the rods from body -z (n,), rad."""
        side = np.hypot(self.rod_states[:, 0], self.rod_states[:, 1])
        return np.asarray(np.arctan2(side, -self.rod_states[:, 2]))

    def advance(
        self, dynamics: Dynamics, state: State, thrust: float, torque: Array, rig: Array
    ) -> State:
        """Advance lander and pendulums by one step; return the lander's new state.

        `thrust` is the input of the engine's lag, N, `torque` (3,) is about the body's origin, N m,
        and `rig` (21,) is from `build_rig`.
        """
        y = state.as_vector()
        k.advance(
            y, self.rod_states, dynamics.step, float(thrust), np.asarray(torque, dtype=np.float64),
            dynamics.params, dynamics.inertia, rig, self._tanks,
        )  # fmt: skip
        self.max_angles = np.maximum(self.max_angles, self.angles)
        return State.from_vector(y)
