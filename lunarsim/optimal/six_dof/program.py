"""Quadratic programs of successive convexification: structure and values.

Variables: states at nodes 1 to N, commands, the length of an interval, virtual controls.
Equalities: linearised motion, and the final state. Inequalities: bounds of commands, mass and time,
and linearised constraints. All matrices keep their sparsity pattern, so that a solver is updated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from lunarsim.optimal.six_dof.linearised import LinearisedPath
from lunarsim.optimal.six_dof.motion import CONTROLS, SHARES, STATES
from lunarsim.optimal.six_dof.scale import EFFORT, LIMITS, Scale
from lunarsim.typing import Array

# Penalty on virtual controls, relative to the final mass as a fraction of the initial mass.
_VIRTUAL_CONTROL_PENALTY = 1e6
# States without virtual control: mass and thrust follow the commands, and mass is the objective.
_WITHOUT_VIRTUAL_CONTROL = (13, 14)

_STEPS = len(SHARES)
_FIXED_AT_END = (
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    10,
    11,
    12,
)  # upright and at rest; heading and thrust are free
_INACTIVE_BOUND = 1e3  # bound that is never active, scaled


@dataclass(frozen=True)
class QuadraticProgram:
    """Quadratic program: minimise ``x P x / 2 + c x`` with ``A x = b``, ``G x <= h``."""

    p: Any
    c: Array
    a: Any
    b: Array
    g: Any
    h: Array


class _SparsePattern:
    """Sparsity pattern that builds CSC matrices from entries in another order.

    `rows` and `columns` (n,) are the indices of the entries, in the order in which `matrix` gets
    their values.
    """

    def __init__(self, rows: Array, columns: Array, shape: tuple[int, int]) -> None:
        order = sparse.coo_matrix(
            (np.arange(1, len(rows) + 1, dtype=np.float64), (rows, columns)), shape=shape
        ).tocsc()
        self._order = order.data.astype(np.int64) - 1
        self._matrix = order

    def matrix(self, values: Array) -> Any:
        """Return the CSC matrix of this pattern with the entries `values` (n,)."""
        m = self._matrix
        return sparse.csc_matrix((values[self._order], m.indices, m.indptr), shape=m.shape)


class ProgramLayout:
    """Order of variables and constraints in programs of successive convexification.

    Parameters
    ----------
    n
        Number of intervals.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.first_control = STATES * n
        self.length = self.first_control + CONTROLS * n
        controlled = (STATES - len(_WITHOUT_VIRTUAL_CONTROL)) * n
        self.virtual = slice(self.length + 1, self.length + 1 + controlled)
        self.count = self.virtual.stop
        self._inputs = self._variables_of_intervals()
        self._a, self._g = self._equalities(), self._inequalities()

    def _variables_of_intervals(self) -> Array:
        """Return the indices of the variables of each interval (n, 20).

        They are those of state, command and length; -1 stands for the fixed initial state.
        """
        n = self.n
        states = np.arange(-STATES, STATES * (n - 1)).reshape(n, STATES)
        states[0] = -1
        controls = self.first_control + np.arange(CONTROLS * n).reshape(n, CONTROLS)
        return np.column_stack((states, controls, np.full(n, self.length)))

    def _block_indices(self, rows: int) -> tuple[Any, Any, Any]:
        """Return row and column indices of dense blocks, and a mask of valid entries.

        Each interval has a block of `rows` rows; its columns are the variables of the interval.
        """
        n = self.n
        r = np.broadcast_to(np.arange(rows * n).reshape(n, rows, 1), (n, rows, 20)).ravel()
        c = np.broadcast_to(self._inputs[:, None, :], (n, rows, 20)).ravel()
        return r, c, c >= 0

    def _equalities(self) -> _SparsePattern:
        """Return the sparsity pattern of motion and final state."""
        n = self.n
        r, c, keep = self._block_indices(STATES)
        nodes = np.arange(STATES * n)
        controlled = nodes[~np.isin(nodes % STATES, _WITHOUT_VIRTUAL_CONTROL)]
        ends = STATES * (n - 1) + np.array(_FIXED_AT_END)
        rows = np.concatenate(
            (r[keep], nodes, controlled, STATES * n + np.arange(len(_FIXED_AT_END)))
        )
        own = self.virtual.start + np.arange(len(controlled))
        columns = np.concatenate((c[keep], nodes, own, ends))
        return _SparsePattern(rows, columns, (STATES * n + len(_FIXED_AT_END), self.count))

    def _inequalities(self) -> _SparsePattern:
        """Return the sparsity pattern of path constraints and bounds of variables."""
        n = self.n
        r, c, keep = self._block_indices(_STEPS * LIMITS)
        first_row = _STEPS * LIMITS * n
        controls = self.first_control + np.arange(CONTROLS * n)
        mass = STATES * (n - 1) + 13
        columns = np.concatenate((controls, controls, [self.length, self.length, mass]))
        rows = np.concatenate((r[keep], first_row + np.arange(len(columns))))
        return _SparsePattern(
            rows, np.concatenate((c[keep], columns)), (first_row + len(columns), self.count)
        )

    def build(self, scale: Scale, path: LinearisedPath, step_penalty: float) -> QuadraticProgram:
        """Return the quadratic program linearised at a path.

        Parameters
        ----------
        scale
            Scaling of the descent.
        path
            Path with its linearisation.
        step_penalty
            Penalty on the change of the path, in the unit of `_VIRTUAL_CONTROL_PENALTY`.
        """
        x, v, length, tangents = path.x, path.v, path.length, path.tangents
        n = self.n
        keep = self._inputs >= 0
        known = np.column_stack((x[:-1], v, np.full(n, length)))
        # The linearisation is exact at its own path; the initial state is fixed.
        rest = path.values - np.einsum("nij,nj->ni", tangents, np.where(keep, known, 0.0))
        low_x, low_v, _ = Scale.split(scale.variable_bounds(n)[0], n)
        some = np.broadcast_to(keep[:, None, :], tangents.shape)
        motion, limit_rows = tangents[:, :STATES], tangents[:, STATES:]
        ones, controlled = np.ones(STATES * n), self.virtual.stop - self.virtual.start
        a = self._a.matrix(
            np.concatenate(
                (-motion[some[:, :STATES]], ones, -ones[:controlled], np.ones(len(_FIXED_AT_END)))
            )
        )
        b = np.concatenate((rest[:, :STATES].ravel(), low_x[n, list(_FIXED_AT_END)]))
        asked = scale.constraint_bounds(n)[0][STATES * n :].reshape(n, -1)
        free = ~np.isfinite(asked)
        g_held = np.where(free[:, :, None], 0.0, -limit_rows)
        h_held = np.where(free, _INACTIVE_BOUND, rest[:, STATES:])
        controls = np.ones(CONTROLS * n)
        g = self._g.matrix(
            np.concatenate((g_held[some[:, STATES:]], -controls, controls, [-1.0, 1.0, -1.0]))
        )
        h = np.concatenate(
            (h_held.ravel(), -low_v.ravel(), controls,
             [-0.8 * length, 1.25 * length, -low_x[1, 13]])
        )  # fmt: skip
        return QuadraticProgram(*self._cost(x, v, length, step_penalty), a, b, g, h)

    def _cost(
        self, states: Array, controls: Array, length: float, step_penalty: float
    ) -> tuple[Any, Array]:
        """Return matrix P and vector c of the cost.

        The cost consists of final mass, torques, change of the path and virtual controls.
        """
        n = self.n
        weight = np.full(self.count, step_penalty)
        weight[self.virtual] = _VIRTUAL_CONTROL_PENALTY
        last = np.concatenate(
            (states[1:].ravel(), controls.ravel(), [length], np.zeros(self.count - self.length - 1))
        )
        c = -np.where(np.arange(self.count) < self.virtual.start, step_penalty, 0.0) * last
        torques = self.first_control + np.arange(CONTROLS * n).reshape(n, CONTROLS)[:, 1:].ravel()
        weight[torques] += 2.0 * EFFORT / n
        c[STATES * (n - 1) + 13] -= 1.0
        return sparse.diags(weight, format="csc"), c

    def split(self, variables: Array, first_state: Array) -> tuple[Array, Array, float]:
        """Split the solution of a program into scaled states, commands and length.

        States are (n + 1, 15), with the fixed `first_state`, and commands (n, 4). The length is
        that of an interval.
        """
        n = self.n
        states = np.vstack((first_state, variables[: STATES * n].reshape(n, STATES)))
        return (
            states,
            variables[self.first_control : self.length].reshape(n, CONTROLS),
            variables[self.length],
        )
