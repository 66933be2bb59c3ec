"""Direct multiple shooting: node states are variables, linked by the motion.

There is one nonlinear program per number of intervals, with the descent as a parameter. IPOPT
(Waechter and Biegler 2006) solves it with derivatives by CasADi (Andersson and others 2019), from
the path of a point mass. Constraints apply after every step of an interval, not only at its ends.
"""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any

import casadi
import numpy as np

from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.six_dof.compiled_solver import compiled_library
from lunarsim.optimal.six_dof.guess import InitialGuess, initial_guess
from lunarsim.optimal.six_dof.motion import (
    CONTROLS,
    SHARES,
    STATES,
    interval_function,
    limit_function,
)
from lunarsim.optimal.six_dof.path import RigidPath
from lunarsim.optimal.six_dof.problem import RigidDescent
from lunarsim.optimal.six_dof.scale import EFFORT, PARAMETERS, Scale
from lunarsim.optimal.validation import check_count

_STEPS = len(SHARES)
_OPTIONS: dict[str, Any] = {
    "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-6,
    "ipopt.acceptable_tol": 1e-5, "ipopt.mu_strategy": "adaptive", "error_on_fail": False,
    # Small pushes keep the initial guess.
    "ipopt.bound_push": 1e-4, "ipopt.bound_frac": 1e-4,
}  # fmt: skip


def shoot(
    descent: RigidDescent,
    intervals: int = 30,
    *,
    guess: InitialGuess | None = None,
    max_iterations: int = 300,
    compiled: bool = False,
) -> RigidPath:
    """Compute the minimum-propellant path of a rigid body by direct multiple shooting.

    Parameters
    ----------
    descent
        Landing problem.
    intervals
        Number of intervals, with constant thrust and torques in each.
    guess
        Initial guess; None: the optimum of a point mass.
    max_iterations
        Maximum number of iterations of IPOPT.
    compiled
        Whether to use compiled C code from `compiled_library`.

    Raises
    ------
    InputError
        If there are fewer than 4 intervals, or compilation is requested without a compiler.
    InfeasibleError
        If not even a point mass can land.
    SolverError
        If IPOPT does not converge.
    """
    intervals, max_iterations = (
        check_count("intervals", intervals, 4),
        check_count("max_iterations", max_iterations, 1),
    )
    start_time = time.perf_counter()
    guess = initial_guess(descent, intervals) if guess is None else guess.resample(intervals)
    scale = Scale.for_descent(descent, guess)
    solver = _solver(intervals, max_iterations, compiled)
    low, high = scale.variable_bounds(intervals)
    got = solver(
        x0=scale.scaled_variables(guess), p=scale.parameters, lbx=low, ubx=high,
        **dict(zip(("lbg", "ubg"), scale.constraint_bounds(intervals), strict=True)),
    )  # fmt: skip
    stats = solver.stats()
    if not stats["success"]:
        raise SolverError(
            f"IPOPT does not converge: {stats['return_status']} after "
            f"{stats['iter_count']} iterations."
        )
    x = np.asarray(got["x"]).ravel()
    states, controls, duration = scale.unscaled_path(x, intervals)
    return RigidPath(
        descent, duration, states, controls[:, 0], controls[:, 1:], int(stats["iter_count"]),
        time.perf_counter() - start_time,
    )  # fmt: skip


@lru_cache(maxsize=8)
def _solver(intervals: int, max_iterations: int, compiled: bool) -> Any:
    """Return the cached IPOPT solver for a number of intervals."""
    options = {**_OPTIONS, "ipopt.max_iter": max_iterations}
    if not compiled:
        return casadi.nlpsol("six_dof", "ipopt", _program(intervals), options)
    path = compiled_library(
        f"six_dof_{intervals}", lambda: casadi.nlpsol("six_dof", "ipopt", _program(intervals))
    )
    return casadi.nlpsol("six_dof", "ipopt", str(path), options)


def _program(intervals: int) -> dict[str, Any]:
    """Return the nonlinear program for `casadi.nlpsol`, for a number of intervals.

    It consists of variables, parameters, cost and constraints.
    """
    x = casadi.MX.sym("x", STATES, intervals + 1)
    v = casadi.MX.sym("v", CONTROLS, intervals)
    total = casadi.MX.sym("T")
    p = casadi.MX.sym("p", PARAMETERS)
    controls = v * casadi.repmat(p[11:15], 1, intervals)
    states = interval_function().map(intervals)(
        x[:, :intervals], controls, total / intervals, p[:11]
    )
    ends = states[:, _STEPS - 1 :: _STEPS]
    held = limit_function().map(intervals * _STEPS)(states, p[15:])
    effort = casadi.sumsqr(v[1:, :]) / intervals
    return {
        "x": casadi.vertcat(casadi.vec(x), casadi.vec(v), total),
        "p": p,
        "f": -x[13, intervals] + EFFORT * effort,
        "g": casadi.vertcat(casadi.vec(ends - x[:, 1:]), casadi.vec(held)),
    }
