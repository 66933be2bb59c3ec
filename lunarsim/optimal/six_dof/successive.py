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

from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.six_dof.guess import InitialGuess, initial_guess
from lunarsim.optimal.six_dof.linearised import LinearisedPath
from lunarsim.optimal.six_dof.path import RigidPath
from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.optimal.six_dof.program import ProgramLayout, QuadraticProgram
from lunarsim.optimal.six_dof.scale import Scale
from lunarsim.optimal.validation import check_count
from lunarsim.typing import Array

# Penalties on steps, relative to the final mass as a fraction of the initial mass: initial value,
# bounds, and value of the final joining programs.
_INITIAL_PENALTY, _MIN_PENALTY, _MAX_PENALTY, _JOINING_PENALTY = 1e-5, 1e-5, 1e-1, 1e-2
# Ratio of actual to predicted gain below which a path is rejected, and above which the penalty
# decreases.
_REJECT_RATIO, _ACCEPT_RATIO = 0.1, 0.5
# Gains are relative to the worst of this number of last paths.
_MEMORY = 3
# A search settles if the relative change of propellant is below the first value and the maximum
# defect below the second (scaled). A joining program with a high step penalty then closes the
# defects, unless the penalty was already above the third value.
_CONVERGED_CHANGE, _SMALL_DEFECT, _LONG_STEP_PENALTY = 5e-4, 5e-3, 1e-4
# Maximum defect, and maximum sum of constraint violations, of a joined path.
_MAX_DEFECT, _MAX_VIOLATION = 2e-5, 5e-3


class SuccessiveConvexification:
    """Solver for the descent of a rigid body by a sequence of quadratic programs.

    Each program is linearised at the path of the previous one. All have the same structure, so they
    are updated instead of built.

    Parameters
    ----------
    intervals
        Number of intervals, with constant thrust and torques in each.
    max_programs
        Maximum number of programs.

    Raises
    ------
    InputError
        If there are fewer than 4 intervals, or no program.
    """

    def __init__(self, intervals: int = 30, max_programs: int = 40) -> None:
        self.intervals, self.max_programs = (
            check_count("intervals", intervals, 4),
            check_count("max_programs", max_programs, 1),
        )
        self._layout = ProgramLayout(self.intervals)
        self._solver: Any = None

    def solve(self, descent: RigidDescent, guess: InitialGuess | None = None) -> RigidPath:
        """Compute the minimum-propellant path of a rigid body.

        Parameters
        ----------
        descent
            Landing problem.
        guess
            Initial guess; None: the optimum of a point mass.

        Raises
        ------
        InfeasibleError
            If not even a point mass can land.
        SolverError
            If a program has no solution, or the sequence does not converge.
        """
        n, start_time = self.intervals, time.perf_counter()
        guess = initial_guess(descent, n) if guess is None else guess.resample(n)
        scale = Scale.for_descent(descent, guess)
        x, v, total = scale.split(scale.scaled_variables(guess), n)
        path, programs = self.iterate(scale, LinearisedPath.at(x, v, total / n, scale))
        states, controls, duration = scale.unscaled_path(
            np.concatenate((path.x.ravel(), path.v.ravel(), [n * path.length])), n
        )
        return RigidPath(
            descent, duration, states, controls[:, 0], controls[:, 1:], programs,
            time.perf_counter() - start_time,
        )  # fmt: skip

    def iterate(self, scale: Scale, path: LinearisedPath) -> tuple[LinearisedPath, int]:
        """Solve programs until convergence; return the path and the number of programs."""
        penalty, joining = _INITIAL_PENALTY, False
        merits = [path.merit]
        for programs in range(1, self.max_programs + 1):
            program = self._layout.build(scale, path, _JOINING_PENALTY if joining else penalty)
            variables = self._solve(program)
            if variables is None:
                penalty, joining = 6.0 * penalty, False
                continue
            new = LinearisedPath.at(*self._layout.split(variables, path.x[0]), scale)
            if joining and new.max_defect < _MAX_DEFECT and new.violation < _MAX_VIOLATION:
                return new, programs
            reference_merit = max(merits[-_MEMORY:])
            predicted_gain = reference_merit - new.propellant_used
            ratio = (reference_merit - new.merit) / max(predicted_gain, 1e-12)
            if not joining and ratio < _REJECT_RATIO and predicted_gain > 0.0:
                penalty = min(6.0 * penalty, _MAX_PENALTY)
                joining = penalty > _LONG_STEP_PENALTY and path.max_defect < _SMALL_DEFECT
                continue
            is_converged = (
                abs(new.propellant_used - path.propellant_used)
                < _CONVERGED_CHANGE * new.propellant_used
                and new.max_defect < _SMALL_DEFECT
            )
            joining = is_converged and (joining or penalty <= _LONG_STEP_PENALTY)
            if ratio > _ACCEPT_RATIO:
                penalty = max(penalty / 3.0, _MIN_PENALTY)
            path = new
            merits.append(new.merit)
        raise SolverError(
            f"Successive convexification does not converge in {self.max_programs} programs: defect "
            f"{path.max_defect:.1e}, constraint violation {path.violation:.1e}."
        )

    def _solve(self, program: QuadraticProgram) -> Array | None:
        """Return the solution of a program, or None if QOCO fails."""
        f = program
        if self._solver is None:
            self._solver = qoco.QOCO()
            self._solver.setup(
                len(f.c), len(f.h), len(f.b), f.p, f.c, f.a, f.b, f.g, f.h, len(f.h), 0,
                np.zeros(0, dtype=np.int32), max_iters=100,
            )  # fmt: skip
        else:
            self._solver.update_vector_data(f.c, f.b, f.h)
            self._solver.update_matrix_data(f.p.data, f.a.data, f.g.data)
        got = self._solver.solve()
        x = np.array(got.x, dtype=np.float64)
        if not str(got.status).startswith("QOCO_SOLVED") or not np.isfinite(x).all():
            self._solver = None  # a failed solve may leave NaN behind
            return None
        return x
