"""Rigid-body path with the linearised motion and constraints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from lunarsim.optimal.six_dof.motion import CONTROLS, SHARES, STATES, interval, limits
from lunarsim.optimal.six_dof.scale import LIMITS, PARAMETERS, Scale

Array = NDArray[np.float64]

_INPUTS = STATES + CONTROLS + 1
_ROWS = STATES + len(SHARES) * LIMITS
# Penalty per scaled unit of a defect between intervals or of a constraint violation.
_DEFECT_PENALTY = 0.03


@dataclass(frozen=True)
class LinearisedPath:
    """Scaled path with its linearisation.

    Attributes
    ----------
    x, v, length
        Scaled states (n + 1, 15), scaled commands (n, 4), scaled length of an interval.
    values, tangents
        Results of `tangents_at`.
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
    def at(cls, x: Array, v: Array, length: float, scale: Scale) -> LinearisedPath:
        """Linearise a path."""
        values, tangents = tangents_at(x, v, length, scale.parameters)
        asked = scale.rows(len(v))[0][STATES * len(v) :].reshape(len(v), -1)
        violation_each = np.where(np.isfinite(asked), -values[:, STATES:], 0.0)
        return cls(x, v, length, values, tangents, float(np.maximum(violation_each, 0.0).sum()))

    @property
    def propellant_used(self) -> float:
        """Propellant, as a fraction of the initial mass."""
        return float(self.x[0, 13] - self.x[-1, 13])

    @property
    def defects(self) -> Array:
        """Defects: ends of intervals minus the next starts (n, 15)."""
        return np.asarray(self.values[:, :STATES] - self.x[1:])

    @property
    def max_defect(self) -> float:
        """Maximum defect."""
        return float(np.abs(self.defects).max())

    @property
    def merit(self) -> float:
        """Merit function: propellant plus penalties; lower is better."""
        return self.propellant_used + _DEFECT_PENALTY * (
            float(np.abs(self.defects).sum()) + self.violation
        )


@cache
def _shooting_function() -> Any:
    """Return (inputs, parameters) -> end, limits (35,) and derivatives (35, 20)."""
    z, p = casadi.SX.sym("z", _INPUTS), casadi.SX.sym("p", PARAMETERS)
    x, v, length = z[:STATES], z[STATES:-1], z[-1]
    states = interval()(x, v * p[11:15], length, p[:11])
    held = [limits()(states[:, k], p[15:]) for k in range(len(SHARES))]
    out = casadi.vertcat(states[:, -1], *held)
    tangent = casadi.densify(casadi.jacobian(out, z))
    return casadi.Function("shot", [z, p], [out, tangent])


def tangents_at(x: Array, v: Array, length: float, p: Array) -> tuple[Array, Array]:
    """Return ends and constraint values (n, 35), and derivatives (n, 35, 20).

    The last column is the derivative by the length of an interval.
    """
    n = len(v)
    z = np.column_stack((x[:-1], v, np.full(n, length)))
    out, jacobian = _shooting_function().map(n)(z.T, np.tile(p[:, None], n))
    tangents = np.asarray(jacobian).reshape(_ROWS, n, _INPUTS).transpose(1, 0, 2)
    return np.asarray(out).T, tangents
