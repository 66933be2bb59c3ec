"""Conversion of a solver's result to a path, and the meaning of its multipliers.

The derivative of the cost by an interval's length follows from the program's Lagrangian (envelope
theorem); it is minus the Hamiltonian in that interval. Along an optimum under autonomous dynamics
the Hamiltonian is constant, and zero if the final time is free. The multipliers of the thrust are
the primer vector, linear in time while no state constraint is active.
"""

from __future__ import annotations

import numpy as np

from lunarsim.optimal.cone_program import Program, SolverResult
from lunarsim.optimal.path import OptimalPath
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.transcription import ProgramScales, Transcription
from lunarsim.typing import Array


def build_path(
    transcription: Transcription,
    program: Program,
    solution: SolverResult,
    descent: Descent,
    duration: float,
) -> OptimalPath:
    """Convert the solution of a cone program to a descent path in physical units.

    `slope` and `hamiltonian` of the path refer to the minimised quantity: delta-v or landing error.

    Parameters
    ----------
    transcription, program
        Structure of the cone program, and its data.
    solution
        Solution by the solver, scaled.
    descent
        Landing problem.
    duration
        Final time, s.
    """
    units = ProgramScales.of(descent, duration)
    n = transcription.structure.intervals
    nodes = solution.x[: 7 * (n + 1)].reshape(n + 1, 7)
    speed = units.length / units.time
    velocity = nodes[:, 3:6] * speed
    thrust_acceleration = np.diff(velocity, axis=0) * (n / duration) + np.array(
        [0.0, 0.0, descent.gravity]
    )
    spent = -np.diff(nodes[:, 6]) * speed
    s, z = transcription.rows["thrust"], solution.z
    # The unit of the landing error is a length, that of delta-v a speed.
    landing = transcription.structure.free and program.c[-1] == 1.0
    unit = units.length if landing else speed
    lengths = _length_derivatives(transcription, program, solution) * unit / duration
    planes = transcription.structure.planes
    return OptimalPath(
        descent=descent,
        duration=duration,
        position=descent.end_position + nodes[:, :3] * units.length,
        velocity=velocity,
        mass=descent.mass * np.exp(nodes[:, 6] * units.kappa),
        thrust_acceleration=thrust_acceleration,
        bound=spent * n / duration,
        delta_v=float(-nodes[-1, 6] * speed),
        cost=float(program.c @ solution.x) * unit,
        slope=float(lengths.mean()),
        hamiltonian=-lengths,
        primer_vector=-z[s].reshape(n, 4)[:, 1:],
        half_space_multipliers=z[transcription.rows["planes"]].reshape(-1, planes)
        if planes
        else np.zeros((0, 0)),
        iterations=solution.iterations,
        solver=solution.solver,
    )


def _length_derivatives(
    transcription: Transcription, program: Program, solution: SolverResult
) -> Array:
    """Return the derivative of the cost by the length of each interval (N,), scaled.

    The derivative follows from the Lagrangian of `program` at its `solution`.
    """
    n, x, z = transcription.structure.intervals, solution.x, solution.z
    nodes = x[: 7 * (n + 1)].reshape(n + 1, 7)
    speeds = nodes[:, 3:6]
    out: Array = -0.5 * np.einsum(
        "ij,ij->i", solution.y[: 3 * n].reshape(n, 3), speeds[1:] + speeds[:-1]
    )
    residual = program.g @ x - program.h
    spent = -np.diff(nodes[:, 6])
    out += z[transcription.rows["high"]] * n * (residual[transcription.rows["high"]] - spent)
    out += z[transcription.rows["low"]] * n * (residual[transcription.rows["low"]] + spent)
    weight = program.h[transcription.rows["thrust"]][3] * n
    out -= z[transcription.rows["thrust"]].reshape(n, 4)[:, 3] * weight
    if "tilt" in transcription.rows:
        out -= z[transcription.rows["tilt"]] * weight
    for name, axes in (("planes", transcription.structure.planes), ("glideslope", 3)):
        if name in transcription.rows:
            out[transcription.inner] += _control_point_terms(
                transcription, program, solution, name, axes
            )
    return out


def _control_point_terms(
    transcription: Transcription, program: Program, solution: SolverResult, name: str, axes: int
) -> Array:
    """Return the part of `_length_derivatives` from constraints on control points.

    Control points move by half the velocity over an interval. `name` is the group of constraints,
    `axes` their number per control point.
    """
    n = transcription.structure.intervals
    rows = program.g[transcription.rows[name]]
    moving = solution.x.copy()
    moving[: 7 * (n + 1)].reshape(n + 1, 7)[:, :3] = 0.0  # keeps half V / N of each row
    return np.asarray(
        (solution.z[transcription.rows[name]] * (rows @ moving)).reshape(-1, axes).sum(1) * n
    )
