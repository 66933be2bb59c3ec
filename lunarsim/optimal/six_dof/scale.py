"""Scaling of a rigid-body descent, and bounds of the scaled variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.optimal.six_dof.guess import InitialGuess
from lunarsim.optimal.six_dof.motion import (
    CONTROLS,
    SHARES,
    STATES,
    control_units,
    figures_of,
    limit_figures,
    state_units,
)
from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.optimal.units import Units

Array = NDArray[np.float64]

LIMITS = 4
PARAMETERS = 23
# Cost of full torques over the complete descent, as a fraction of the initial mass. Without it, the
# rotation of a body with time to spare is not unique.
EFFORT = 1e-4

_STEPS = len(SHARES)


@dataclass(frozen=True)
class Scale:
    """Conversion between a descent and the scaled variables of its programs.

    Attributes
    ----------
    descent
        Problem.
    units
        Scales.
    """

    descent: RigidDescent
    units: Units

    @classmethod
    def of(cls, descent: RigidDescent, guess: InitialGuess) -> Scale:
        """Return the scaling in which distance, time and mass are about 1."""
        distance = float(np.linalg.norm(descent.start.position - descent.end_position))
        return cls(descent, Units(distance + 1.0, guess.duration, descent.start.mass))

    @property
    def control(self) -> Array:
        """Maximum thrust and torques (4,)."""
        return np.array([self.descent.most, *self.descent.torques])

    @property
    def parameters(self) -> Array:
        """Parameters of the program (23,)."""
        d, u = self.descent, self.units
        return np.concatenate(
            (figures_of(d, u), self.control / control_units(u), limit_figures(d, u))
        )

    def _scaled(self, states: Array) -> Array:
        moved = states.copy()
        moved[..., :3] -= self.descent.end_position
        return np.asarray(moved / state_units(self.units))

    def start(self, guess: InitialGuess) -> Array:
        """Return the scaled variables of a guess."""
        controls = np.column_stack((guess.thrust, guess.torque)) / self.control
        return np.concatenate(
            (self._scaled(guess.states).ravel(), controls.ravel(),
             [guess.duration / self.units.time])
        )  # fmt: skip

    def bounds(self, n: int) -> tuple[Array, Array]:
        """Return bounds of the variables, including initial and final state."""
        d, u = self.descent, self.units
        low = np.full((n + 1, STATES), -np.inf)
        high = -low
        low[:, 13] = d.dry_mass / u.mass
        low[0] = high[0] = self._scaled(d.start_vector)
        end = np.concatenate((d.end_position, d.end_velocity, np.zeros(9)))
        at = [0, 1, 2, 3, 4, 5, 6, 7, 10, 11, 12]
        low[n, at] = high[n, at] = self._scaled(end)[at]
        least = np.array([d.least / d.most, -1.0, -1.0, -1.0])
        return (
            np.concatenate((low.ravel(), np.tile(least, n), [0.2])),
            np.concatenate((high.ravel(), np.ones(CONTROLS * n), [5.0])),
        )

    def rows(self, n: int) -> tuple[Array, Array]:
        """Return bounds of the constraints: motion, then path constraints after each step."""
        low = np.zeros((n * _STEPS, LIMITS))
        d = self.descent
        held = (d.max_tilt, d.max_rate, d.glideslope, d.sight)
        low[:, [limit is None for limit in held]] = -np.inf
        # At the end of the path the glideslope's apex and the direction to the site are undefined.
        low[-1, 2:] = -np.inf
        if d.sight is not None:
            done = np.arange(n)[:, None] + np.cumsum(SHARES)
            low[done.ravel() > d.sight.share * n + 1e-9, 3] = -np.inf
        motion = np.zeros(n * STATES)
        return np.concatenate((motion, low.ravel())), np.concatenate(
            (motion, np.full(low.size, np.inf))
        )

    def read(self, x: Array, n: int) -> tuple[Array, Array, float]:
        """Return states (n + 1, 15), controls (n, 4) and the final time, unscaled."""
        scaled, shares, total = self.split(x, n)
        states = scaled * state_units(self.units)
        states[:, :3] += self.descent.end_position
        controls = shares * self.control
        controls[:, 0] = np.clip(controls[:, 0], self.descent.least, self.descent.most)
        return states, controls, float(total * self.units.time)

    @staticmethod
    def split(x: Array, n: int) -> tuple[Array, Array, float]:
        """Return scaled states (n + 1, 15), scaled commands (n, 4) and the final time."""
        nodes = STATES * (n + 1)
        return x[:nodes].reshape(n + 1, STATES), x[nodes:-1].reshape(n, CONTROLS), float(x[-1])
