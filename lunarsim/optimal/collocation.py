"""Direct collocation of a descent without convexification, solved by IPOPT.

It is an independent check of the cone programs: thrust with its limits and pointing, the mass
equation, and a free final time as a variable. Radau points of degree three; thrust is constant in
each interval. CasADi (Andersson and others 2019) differentiates, IPOPT (Waechter and Biegler 2006)
solves. It finds a local optimum and takes a few hundred times as long as the cone programs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from lunarsim.errors import InputError
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import minimum_effort_time
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.units import Units
from lunarsim.optimal.validation import check_count, is_number
from lunarsim.typing import Array

_Row = tuple[Any, Any, Any]  # a constraint expression and its bounds

_DEGREE = 3
_STATES = 7


@dataclass(frozen=True)
class CollocatedPath:
    """Path of minimum propellant computed by direct collocation.

    Attributes
    ----------
    duration
        Final time, s.
    propellant
        Propellant used, kg.
    position, velocity
        Position and velocity at the nodes (N + 1, 3), ENU, m and m/s.
    mass
        Mass at the nodes (N + 1,), kg.
    thrust
        Thrust in the intervals (N, 3), newtons.
    iterations
        Number of iterations of IPOPT.
    """

    duration: float
    propellant: float
    position: Array
    velocity: Array
    mass: Array
    thrust: Array
    iterations: int


def _state_scales(units: Units) -> Array:
    """Return the scales of the seven state variables (position, velocity, mass)."""
    return np.array([units.length] * 3 + [units.speed] * 3 + [units.mass])


def collocate(
    descent: Descent,
    intervals: int = 50,
    *,
    duration: float | None = None,
    max_iterations: int = 400,
) -> CollocatedPath:
    """Compute the minimum-propellant path of a descent by direct collocation.

    Parameters
    ----------
    descent
        Landing problem without region, cone, end tilt and thrust slack.
    intervals
        Number of intervals of constant thrust, N.
    duration
        Final time, s; None: optimised too.
    max_iterations
        Maximum number of iterations of IPOPT.

    Raises
    ------
    InputError
        If the descent has an unsupported constraint, or an argument is invalid.
    SolverError
        If IPOPT does not converge.
    """
    intervals, max_iterations = (
        check_count("intervals", intervals, 2),
        check_count("max_iterations", max_iterations, 0),
    )
    for name, other in (
        ("region", 0.0),
        ("thrust_slack", 0.0),
        ("cone", None),
        ("max_final_tilt", None),
    ):
        if getattr(descent, name) != other:
            raise InputError(
                f"optimal.{name}",
                getattr(descent, name),
                f"must be {other}, because `collocate` does not support this constraint",
            )
    if duration is not None and not (is_number(duration) and duration > 0.0):
        raise InputError("optimal.duration", duration, "must be a positive, finite number")
    guess = duration or 0.9 * minimum_effort_time(descent)
    units = Units(float(np.linalg.norm(descent.displacement)) + 1.0, guess, descent.mass)
    variables, constraints, low, high = _program(descent, units, intervals, duration)
    problem: dict[str, Any] = {
        "x": variables,
        "f": -variables[_STATES * intervals + 6],
        "g": constraints,
    }
    options: dict[str, Any] = {
        "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes",
        "ipopt.max_iter": max_iterations, "ipopt.tol": 1e-8, "ipopt.mu_strategy": "adaptive",
    }  # fmt: skip
    solver = casadi.nlpsol("descent", "ipopt", problem, options)
    start = _initial_variables(descent, units, intervals)
    got = solver(x0=start, lbg=low, ubg=high)
    stats = solver.stats()
    if not stats["success"]:
        raise SolverError(
            f"IPOPT does not converge: {stats['return_status']} after "
            f"{stats['iter_count']} iterations."
        )
    return _to_path(np.asarray(got["x"]).ravel(), descent, units, intervals, stats["iter_count"])


def _initial_variables(descent: Descent, units: Units, intervals: int) -> Array:
    """Return an initial guess of the solver's variables, scaled.

    The guess is straight from start to end with hover thrust.
    """
    fraction = np.linspace(0.0, 1.0, intervals + 1)[:, None]
    position = (1.0 - fraction) * descent.displacement
    velocity = (1.0 - fraction) * descent.velocity + fraction * descent.end_velocity
    mass = descent.mass - 0.5 * fraction * (descent.mass - descent.dry_mass)
    nodes = np.column_stack((position, velocity, mass)) / _state_scales(units)
    inner = np.repeat(nodes[1:], _DEGREE, axis=0)
    hover = np.array([0.0, 0.0, descent.mass * descent.gravity])
    lift = np.clip(hover, 0.0, descent.thrust_max) / units.force
    return np.concatenate((nodes.ravel(), inner.ravel(), np.tile(lift, intervals), [1.0]))


def _rates(descent: Descent, units: Units, state: Any, thrust: Any) -> Any:
    """Return the time derivative of a state under a thrust, all scaled."""
    weight = descent.gravity * units.time**2 / units.length
    burn = casadi.norm_2(thrust) * units.speed / descent.exhaust_velocity
    down = casadi.vertcat(0.0, 0.0, -weight)
    return casadi.vertcat(state[3:6], thrust / state[6] + down, -burn)


def _program(
    descent: Descent, units: Units, intervals: int, duration: float | None
) -> tuple[Any, Any, Array, Array]:
    """Return variables, constraints and lower and upper bounds of the constraints.

    `duration` is the final time, s; None: it is a variable.
    """
    tau = np.concatenate(([0.0], casadi.collocation_points(_DEGREE, "radau")))
    slopes = _lagrange_derivatives(tau)
    nodes = [casadi.SX.sym(f"x{k}", _STATES) for k in range(intervals + 1)]
    inner = [
        [casadi.SX.sym(f"x{k}_{j}", _STATES) for j in range(_DEGREE)] for k in range(intervals)
    ]
    thrust = [casadi.SX.sym(f"u{k}", 3) for k in range(intervals)]
    total = casadi.SX.sym("T")
    rows: list[_Row] = []
    first = np.concatenate(
        (descent.displacement, descent.velocity, [descent.mass])
    ) / _state_scales(units)
    last = np.concatenate((np.zeros(3), descent.end_velocity)) / _state_scales(units)[:6]
    rows += [(nodes[0] - first, 0.0, 0.0), (nodes[intervals][:6] - last, 0.0, 0.0)]
    rows += [(nodes[intervals][6], descent.dry_mass / units.mass, np.inf), (total, 0.05, 20.0)]
    if duration is not None:
        rows += [(total - duration / units.time, 0.0, 0.0)]
    for k in range(intervals):
        points = [nodes[k], *inner[k]]
        for j in range(1, _DEGREE + 1):
            moved = sum(slopes[i, j] * points[i] for i in range(_DEGREE + 1))
            rate = _rates(descent, units, points[j], thrust[k])
            rows.append((moved - total / intervals * rate, 0.0, 0.0))
        rows.append((nodes[k + 1] - points[-1], 0.0, 0.0))
        rows += _thrust_constraints(descent, units, thrust[k])
        if descent.glideslope is not None and k < intervals - 1:
            rows += [_glideslope_constraint(descent, units, x) for x in inner[k]]
    constraints = casadi.vertcat(*(row[0] for row in rows))
    low, high = (
        np.concatenate([np.full(row[0].numel(), row[side]) for row in rows]) for side in (1, 2)
    )
    variables = casadi.vertcat(*nodes, *(x for some in inner for x in some), *thrust, total)
    return variables, constraints, low, high


def _lagrange_derivatives(points: Array) -> Array:
    """Return the derivative of each Lagrange polynomial (first index) at each point.

    `points` are the interpolation points of one interval.
    """
    count = len(points)
    out = np.empty((count, count))
    for i in range(count):
        others = np.delete(points, i)
        basis = np.poly1d(np.poly(others) / np.prod(points[i] - others))
        out[i] = np.polyder(basis)(points)
    return out


def _thrust_constraints(descent: Descent, units: Units, thrust: Any) -> list[tuple[Any, Any, Any]]:
    """Return the constraints of thrust magnitude and tilt in one interval.

    Each constraint is (expression, lower bound, upper bound).
    """
    lower, upper = (f / units.force for f in (descent.thrust_min, descent.thrust_max))
    rows = [(casadi.sumsqr(thrust), lower**2, upper**2)]
    if descent.max_tilt is not None:
        lean = np.cos(descent.max_tilt) * casadi.norm_2(thrust)
        rows.append((thrust[2] - lean, 0.0, np.inf))
    return rows


def _glideslope_constraint(descent: Descent, units: Units, state: Any) -> _Row:
    """Return the glideslope constraint at one scaled state.

    The constraint is (expression, lower bound, upper bound).
    """
    horizontal = casadi.sqrt(state[0] ** 2 + state[1] ** 2 + 1e-10)
    up = state[2] + descent.apex_depth / units.length
    return up - np.tan(descent.glideslope or 0.0) * horizontal, 0.0, np.inf


def _to_path(
    variables: Array, descent: Descent, units: Units, intervals: int, iterations: int
) -> CollocatedPath:
    """Convert the solver's scaled variables to a path in physical units."""
    nodes = variables[: _STATES * (intervals + 1)].reshape(intervals + 1, _STATES) * _state_scales(
        units
    )
    begin = _STATES * (intervals + 1) + _STATES * _DEGREE * intervals
    return CollocatedPath(
        duration=float(variables[-1] * units.time),
        propellant=float(descent.mass - nodes[-1, 6]),
        position=nodes[:, :3] + descent.end_position,
        velocity=nodes[:, 3:6],
        mass=nodes[:, 6],
        thrust=variables[begin : begin + 3 * intervals].reshape(intervals, 3) * units.force,
        iterations=int(iterations),
    )
