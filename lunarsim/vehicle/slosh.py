"""Propellant that swings in the tanks of one flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.models.jet_lander import JetLander
from lunarsim.vehicle import _slosh_kernels as k
from lunarsim.vehicle.dynamics import Dynamics
from lunarsim.vehicle.state import State

Array = NDArray[np.float64]


class Liquid:
    """Pendulums in the tanks, and the body that they swing in; see `lunarsim.models.slosh`.

    Position and velocity of a state are those of the point that is the centre of mass while the
    liquid rests. What mass a pendulum has and where it hangs follow the propellant left, as if
    that did not change within a step.

    Parameters
    ----------
    lander
        Its tanks and masses.

    Attributes
    ----------
    swings
        Direction of each rod and its rate of change (n, 6), body axes; at rest along -z.
    most
        Greatest angle of each rod from body -z so far (n,), rad.
    """

    def __init__(self, lander: JetLander) -> None:
        self._tanks = lander.slosh.table(lander.propellant_mass)
        self.swings = np.zeros((len(self._tanks), 6))
        self.swings[:, 2] = -1.0
        self.most = np.zeros(len(self._tanks))

    @property
    def angles(self) -> Array:
        """Of the rods from body -z (n,), rad."""
        side = np.hypot(self.swings[:, 0], self.swings[:, 1])
        return np.asarray(np.arctan2(side, -self.swings[:, 2]))

    def advance(
        self, dynamics: Dynamics, state: State, thrust: float, torque: Array, rig: Array
    ) -> State:
        """Return the state a step later; see `Dynamics.advance_rigged`."""
        y = state.as_vector()
        k.advance(
            y, self.swings, dynamics.step, float(thrust), np.asarray(torque, dtype=np.float64),
            dynamics.figures, dynamics.inertia, rig, self._tanks,
        )  # fmt: skip
        self.most = np.maximum(self.most, self.angles)
        return State.from_vector(y)
