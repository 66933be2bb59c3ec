"""Scaling of a rigid-body descent, and bounds of the scaled variables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.optimal.six_dof.guess import InitialGuess
from lunarsim.optimal.six_dof.motion import (
    CONTROLS,
    SHARES,
    STATES,
    control_units,
    limit_parameters,
    state_units,
    vehicle_parameters,
)
from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.optimal.units import Units
from lunarsim.typing import Array

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
        Landing problem.
    units
        Scales of length, time and mass.
    """

    descent: RigidDescent
    units: Units

    @classmethod
    def for_descent(cls, descent: RigidDescent, guess: InitialGuess) -> Scale:
        """Return the scaling in which distance, time and mass of a descent are about 1."""
        distance = float(np.linalg.norm(descent.start.position - descent.end_position))
        return cls(descent, Units(distance + 1.0, guess.duration, descent.start.mass))

    @property
    def max_control(self) -> Array:
        """Maximum thrust, N, and torques, N m (4,)."""
        return np.array([self.descent.max_thrust_command, *self.descent.torques])

    @property
    def parameters(self) -> Array:
        """Parameters of the nonlinear program (23,): vehicle, maximum commands, limits."""
        d, u = self.descent, self.units
        return np.concatenate(
            (vehicle_parameters(d, u), self.max_control / control_units(u), limit_parameters(d, u))
        )

    def _scaled(self, states: Array) -> Array:
        """Return states (..., 15) relative to the end, divided by their scales."""
        moved = states.copy()
        moved[..., :3] -= self.descent.end_position
        return np.asarray(moved / state_units(self.units))

    def scaled_variables(self, guess: InitialGuess) -> Array:
        """Return the scaled variables of a guess in one vector.

        They are the states at the nodes, the commands in the intervals, and the final time.
        """
        controls = np.column_stack((guess.thrust, guess.torque)) / self.max_control
        return np.concatenate(
            (self._scaled(guess.states).ravel(), controls.ravel(),
             [guess.duration / self.units.time])
        )  # fmt: skip

    def variable_bounds(self, intervals: int) -> tuple[Array, Array]:
        """Return lower and upper bounds of the variables, which fix start and end state."""
        d, u = self.descent, self.units
        low = np.full((intervals + 1, STATES), -np.inf)
        high = -low
        low[:, 13] = d.dry_mass / u.mass
        low[0] = high[0] = self._scaled(d.start_vector)
        end = np.concatenate((d.end_position, d.end_velocity, np.zeros(9)))
        at = [0, 1, 2, 3, 4, 5, 6, 7, 10, 11, 12]
        low[intervals, at] = high[intervals, at] = self._scaled(end)[at]
        least = np.array([d.min_thrust_command / d.max_thrust_command, -1.0, -1.0, -1.0])
        return (
            np.concatenate((low.ravel(), np.tile(least, intervals), [0.2])),
            np.concatenate((high.ravel(), np.ones(CONTROLS * intervals), [5.0])),
        )

    def constraint_bounds(self, intervals: int) -> tuple[Array, Array]:
        """Return lower and upper bounds of the constraints.

        They are those of the motion, then those of the path constraints after each step.
        """
        low = np.zeros((intervals * _STEPS, LIMITS))
        d = self.descent
        held = (d.max_tilt, d.max_rate, d.glideslope, d.sight)
        low[:, [limit is None for limit in held]] = -np.inf
        # At the end of the path the glideslope's apex and the direction to the site are undefined.
        low[-1, 2:] = -np.inf
        if d.sight is not None:
            done = np.arange(intervals)[:, None] + np.cumsum(SHARES)
            low[done.ravel() > d.sight.visible_fraction * intervals + 1e-9, 3] = -np.inf
        motion = np.zeros(intervals * STATES)
        return np.concatenate((motion, low.ravel())), np.concatenate(
            (motion, np.full(low.size, np.inf))
        )

    def unscaled_path(self, variables: Array, intervals: int) -> tuple[Array, Array, float]:
        """Return states (n + 1, 15), controls (n, 4) and final time, in physical units."""
        scaled, shares, total = self.split(variables, intervals)
        states = scaled * state_units(self.units)
        states[:, :3] += self.descent.end_position
        controls = shares * self.max_control
        controls[:, 0] = np.clip(
            controls[:, 0], self.descent.min_thrust_command, self.descent.max_thrust_command
        )
        return states, controls, float(total * self.units.time)

    @staticmethod
    def split(variables: Array, intervals: int) -> tuple[Array, Array, float]:
        """Split a vector of variables into states, commands and final time, all scaled.

        States are (n + 1, 15) and commands (n, 4).
        """
        nodes = STATES * (intervals + 1)
        return (
            variables[:nodes].reshape(intervals + 1, STATES),
            variables[nodes:-1].reshape(intervals, CONTROLS),
            float(variables[-1]),
        )
