"""A rigid body's path with the tangents of motion and limits there."""

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
# What an interval's end apart from the next one's start, or a limit passed, costs in units.
_APART = 0.03


@dataclass(frozen=True)
class Point:
    """A path in units, and the motion's tangents there.

    Attributes
    ----------
    x, v, length
        Scaled states (n + 1, 15), shares of commands (n, 4), length of an interval.
    values, tangents
        See `tangents_at`.
    passed
        By how much limits are passed, summed up.
    """

    x: Array
    v: Array
    length: float
    values: Array
    tangents: Array
    passed: float

    @classmethod
    def at(cls, x: Array, v: Array, length: float, scale: Scale) -> Point:
        """Return a path with its tangents."""
        values, tangents = tangents_at(x, v, length, scale.parameters)
        asked = scale.rows(len(v))[0][STATES * len(v) :].reshape(len(v), -1)
        under = np.where(np.isfinite(asked), -values[:, STATES:], 0.0)
        return cls(x, v, length, values, tangents, float(np.maximum(under, 0.0).sum()))

    @property
    def burnt(self) -> float:
        """Propellant, as a share of the start's mass."""
        return float(self.x[0, 13] - self.x[-1, 13])

    @property
    def gaps(self) -> Array:
        """Ends of intervals less the next ones' starts (n, 15)."""
        return np.asarray(self.values[:, :STATES] - self.x[1:])

    @property
    def apart(self) -> float:
        """The largest gap."""
        return float(np.abs(self.gaps).max())

    @property
    def merit(self) -> float:
        """Propellant and what is not yet kept, less is better."""
        return self.burnt + _APART * (float(np.abs(self.gaps).sum()) + self.passed)


@cache
def _shot() -> Any:
    """Return (state, control, length; parameters) -> end, limits (35,) and derivatives (35, 20)."""
    z, p = casadi.SX.sym("z", _INPUTS), casadi.SX.sym("p", PARAMETERS)
    x, v, length = z[:STATES], z[STATES:-1], z[-1]
    states = interval()(x, v * p[11:15], length, p[:11])
    held = [limits()(states[:, k], p[15:]) for k in range(len(SHARES))]
    out = casadi.vertcat(states[:, -1], *held)
    tangent = casadi.densify(casadi.jacobian(out, z))
    return casadi.Function("shot", [z, p], [out, tangent])


def tangents_at(x: Array, v: Array, length: float, p: Array) -> tuple[Array, Array]:
    """Return ends of all intervals and limits in them (n, 35), and their derivatives (n, 35, 20).

    The last column is with the length of an interval.
    """
    n = len(v)
    z = np.column_stack((x[:-1], v, np.full(n, length)))
    out, jacobian = _shot().map(n)(z.T, np.tile(p[:, None], n))
    tangents = np.asarray(jacobian).reshape(_ROWS, n, _INPUTS).transpose(1, 0, 2)
    return np.asarray(out).T, tangents
