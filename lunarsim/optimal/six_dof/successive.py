"""Successive convexification of the rigid-body descent.

The method solves a sequence of quadratic programs. Motion and constraints are linearised at the
last path. Virtual controls with a high penalty absorb the defects, and a quadratic penalty limits
the steps (penalised trust region; Szmuk, Reynolds and Acikmese 2020). Constraints apply after every
step of an interval, so that they hold between the nodes (like the continuous-time form of Elango
and others 2024, with points instead of an integral). The programs have one structure: QOCO is set
up once and updated.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import qoco
from numpy.typing import NDArray

from lunarsim.optimal.checks import count
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.six_dof.guess import Guess, guess_of
from lunarsim.optimal.six_dof.linearised import Point
from lunarsim.optimal.six_dof.path import RigidPath
from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.optimal.six_dof.program import Filled, Layout
from lunarsim.optimal.six_dof.scale import Scale

Array = NDArray[np.float64]

# Penalties on steps, relative to the final mass as a fraction of the initial mass: initial value,
# bounds, and value of the final joining programs.
_FIRST, _CHEAPEST, _DEAREST, _JOINING = 1e-5, 1e-5, 1e-1, 1e-2
# Ratio of actual to predicted gain below which a path is rejected, and above which the penalty
# decreases.
_POOR, _GOOD = 0.1, 0.5
# Gains are relative to the worst of this number of last paths.
_MEMORY = 3
# A search settles if the relative change of propellant is below the first value and the maximum
# defect below the second (scaled). A joining program with a high step penalty then closes the
# defects, unless the penalty was already above the third value.
_SAVED, _NEAR, _LONG = 5e-4, 5e-3, 1e-4
# Maximum defect, and maximum sum of constraint violations, of a joined path.
_JOINED, _PASSED = 2e-5, 5e-3


class Successive:
    """Solver that keeps and updates programs of one structure.

    Parameters
    ----------
    intervals
        N, with constant thrust and torques in each.
    most
        Maximum number of programs.

    Raises
    ------
    InputError
        If there are fewer than 4 intervals, or no program.
    """

    def __init__(self, intervals: int = 30, most: int = 40) -> None:
        self.intervals, self.most = count("intervals", intervals, 4), count("most", most, 1)
        self._layout = Layout(self.intervals)
        self._held: Any = None

    def solve(self, descent: RigidDescent, guess: Guess | None = None) -> RigidPath:
        """Compute the minimum-propellant path of a rigid body.

        Parameters
        ----------
        descent
            Problem.
        guess
            Initial guess; None: the optimum of a point mass.

        Raises
        ------
        InfeasibleError
            If not even a point mass can land.
        SolverError
            If a program has no solution, or the sequence does not converge.
        """
        n, begun = self.intervals, time.perf_counter()
        guess = guess_of(descent, n) if guess is None else guess.on(n)
        scale = Scale.of(descent, guess)
        x, v, total = scale.split(scale.start(guess), n)
        path, programs = self.settled(scale, Point.at(x, v, total / n, scale))
        states, controls, duration = scale.read(
            np.concatenate((path.x.ravel(), path.v.ravel(), [n * path.length])), n
        )
        return RigidPath(
            descent, duration, states, controls[:, 0], controls[:, 1:], programs,
            time.perf_counter() - begun,
        )  # fmt: skip

    def settled(self, scale: Scale, point: Point) -> tuple[Point, int]:
        """Return the converged path and the number of programs."""
        price, joining = _FIRST, False
        merits = [point.merit]
        for programs in range(1, self.most + 1):
            program = self._layout.fill(scale, point, _JOINING if joining else price)
            z = self._solved(program)
            if z is None:
                price, joining = 6.0 * price, False
                continue
            new = Point.at(*self._layout.read(z, point.x[0]), scale)
            if joining and new.apart < _JOINED and new.passed < _PASSED:
                return new, programs
            bar = max(merits[-_MEMORY:])
            foreseen = bar - new.burnt
            ratio = (bar - new.merit) / max(foreseen, 1e-12)
            if not joining and ratio < _POOR and foreseen > 0.0:
                price = min(6.0 * price, _DEAREST)
                joining = price > _LONG and point.apart < _NEAR
                continue
            settles = abs(new.burnt - point.burnt) < _SAVED * new.burnt and new.apart < _NEAR
            joining = settles and (joining or price <= _LONG)
            if ratio > _GOOD:
                price = max(price / 3.0, _CHEAPEST)
            point = new
            merits.append(new.merit)
        raise SolverError(
            f"Successive convexification does not converge in {self.most} programs: defect "
            f"{point.apart:.1e}, constraint violation {point.passed:.1e}."
        )

    def _solved(self, filled: Filled) -> Array | None:
        """Return the variables of a program, or None if QOCO fails."""
        f = filled
        if self._held is None:
            self._held = qoco.QOCO()
            self._held.setup(
                len(f.c), len(f.h), len(f.b), f.p, f.c, f.a, f.b, f.g, f.h, len(f.h), 0,
                np.zeros(0, dtype=np.int32), max_iters=100,
            )  # fmt: skip
        else:
            self._held.update_vector_data(f.c, f.b, f.h)
            self._held.update_matrix_data(f.p.data, f.a.data, f.g.data)
        got = self._held.solve()
        x = np.array(got.x, dtype=np.float64)
        if not str(got.status).startswith("QOCO_SOLVED") or not np.isfinite(x).all():
            self._held = None  # a failed solve may leave NaN behind
            return None
        return x
