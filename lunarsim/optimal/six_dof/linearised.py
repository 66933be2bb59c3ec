"""Rigid-body path with the linearised motion and constraints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi
import numpy as np

from lunarsim.optimal.six_dof.motion import (
    CONTROLS,
    SHARES,
    STATES,
    interval_function,
    limit_function,
)
from lunarsim.optimal.six_dof.scale import LIMITS, PARAMETERS, Scale
from lunarsim.typing import Array

_INPUTS = STATES + CONTROLS + 1
_ROWS = STATES + len(SHARES) * LIMITS
# Penalty per scaled unit of a defect between intervals or of a constraint violation.
_DEFECT_PENALTY = 0.03


@dataclass(frozen=True)
class LinearisedPath:
    """Path in scaled variables with the linearisation of its motion and constraints.

    Attributes
    ----------
    x, v, length
        Scaled states at the nodes (n + 1, 15), scaled commands in the intervals (n, 4), and scaled
        length of an interval.
    values, tangents
        Values (n, 35) and derivatives (n, 35, 20) for each interval, from `linearise_intervals`.
    violation
        Sum of the constraint violations.
    """

    x: Array
    v: Array
    length: float
    values: Array
    tangents: Array
    violation: float

    @classmethod
    def at(cls, states: Array, controls: Array, length: float, scale: Scale) -> LinearisedPath:
        """Linearise a path of scaled states, commands and interval length."""
        values, tangents = linearise_intervals(states, controls, length, scale.parameters)
        asked = scale.constraint_bounds(len(controls))[0][STATES * len(controls) :].reshape(
            len(controls), -1
        )
        violation_each = np.where(np.isfinite(asked), -values[:, STATES:], 0.0)
        return cls(
            states, controls, length, values, tangents, float(np.maximum(violation_each, 0.0).sum())
        )

    @property
    def propellant_used(self) -> float:
        """Propellant used, as a fraction of the initial mass."""
        return float(self.x[0, 13] - self.x[-1, 13])

    @property
    def defects(self) -> Array:
        """Defects: propagated end of each interval minus the next node's state (n, 15)."""
        return np.asarray(self.values[:, :STATES] - self.x[1:])

    @property
    def max_defect(self) -> float:
        """Maximum absolute defect of a state variable, scaled."""
        return float(np.abs(self.defects).max())

    @property
    def merit(self) -> float:
        """Merit function: propellant plus penalties; lower is better."""
        return self.propellant_used + _DEFECT_PENALTY * (
            float(np.abs(self.defects).sum()) + self.violation
        )


@cache
def _shooting_function() -> Any:
    """Return a CasADi function that propagates and differentiates one interval.

    It maps state, command and length (20,) and the parameters of `Scale` to the state at the end
    with the constraint values after each step (35,), and to their derivatives (35, 20).
    """
    z, p = casadi.SX.sym("z", _INPUTS), casadi.SX.sym("p", PARAMETERS)
    x, v, length = z[:STATES], z[STATES:-1], z[-1]
    states = interval_function()(x, v * p[11:15], length, p[:11])
    held = [limit_function()(states[:, k], p[15:]) for k in range(len(SHARES))]
    out = casadi.vertcat(states[:, -1], *held)
    tangent = casadi.densify(casadi.jacobian(out, z))
    return casadi.Function("shot", [z, p], [out, tangent])


def linearise_intervals(
    states: Array, controls: Array, length: float, parameters: Array
) -> tuple[Array, Array]:
    """Propagate and differentiate all intervals of a path.

    The results are the state at the end of each interval with the constraint values after each step
    (n, 35), and their derivatives by state, command and length (n, 35, 20). All is scaled;
    `parameters` are those of `Scale`.
    """
    n = len(controls)
    z = np.column_stack((states[:-1], controls, np.full(n, length)))
    out, jacobian = _shooting_function().map(n)(z.T, np.tile(parameters[:, None], n))
    tangents = np.asarray(jacobian).reshape(_ROWS, n, _INPUTS).transpose(1, 0, 2)
    return np.asarray(out).T, tangents
