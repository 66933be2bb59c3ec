"""Sloshing propellant in the tanks of one flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.jet_lander import JetLander
from lunarsim.vehicle import _slosh_kernels as k
from lunarsim.vehicle.dynamics import Dynamics
from lunarsim.vehicle.state import State

Array = NDArray[np.float64]


class SloshPendulums:
    """Pendulums in the tanks, coupled to the body (`lunarsim.models.slosh`).

    Position and velocity of a state are those of the point that is the centre of mass while the
    liquid rests. Mass and pivot of a pendulum follow the remaining propellant and are constant
    within a step.

    Parameters
    ----------
    lander
        Lander with its tanks and masses.

    Attributes
    ----------
    rod_states
        Direction of each rod and its rate of change (n, 6), body axes; at rest along -z.
    most
        Maximum angle of each rod from body -z so far (n,), rad.
    """

    def __init__(self, lander: JetLander) -> None:
        self._tanks = lander.slosh.table(lander.propellant_mass)
        self.rod_states = np.zeros((len(self._tanks), 6))
        self.rod_states[:, 2] = -1.0
        self.most = np.zeros(len(self._tanks))

    @property
    def angles(self) -> Array:
        """Angles of the rods from body -z (n,), rad."""
        side = np.hypot(self.rod_states[:, 0], self.rod_states[:, 1])
        return np.asarray(np.arctan2(side, -self.rod_states[:, 2]))

    def advance(
        self, dynamics: Dynamics, state: State, thrust: float, torque: Array, rig: Array
    ) -> State:
        """Return the state one step later, like `Dynamics.advance_with_rig`."""
        y = state.as_vector()
        k.advance(
            y, self.rod_states, dynamics.step, float(thrust), np.asarray(torque, dtype=np.float64),
            dynamics.figures, dynamics.inertia, rig, self._tanks,
        )  # fmt: skip
        self.most = np.maximum(self.most, self.angles)
        return State.from_vector(y)
