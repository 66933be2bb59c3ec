"""From a solver's answer back to a path in metres, and what its multipliers say.

The multiplier of an interval's length is minus the Hamiltonian there, since the cost's derivative
with the length of an interval is what the program's Lagrangian gives (envelope theorem). Along an
optimum under autonomous dynamics it is constant, and zero where the final time is free. The
multipliers of the thrust are the primer vector, linear in time while no bound on the state binds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.optimal.cone_program import Answer, Program
from lunarsim.optimal.path import Path
from lunarsim.optimal.problem import Descent
from lunarsim.optimal.transcription import Scales, Transcription

Array = NDArray[np.float64]


def path_of(
    made: Transcription, program: Program, answer: Answer, descent: Descent, duration: float
) -> Path:
    """Return the path that an answer stands for.

    Its `slope` and `hamiltonian` are those of what was asked for: increment or landing error.
    """
    units = Scales.of(descent, duration)
    n = made.structure.intervals
    nodes = answer.x[: 7 * (n + 1)].reshape(n + 1, 7)
    speed = units.length / units.time
    velocity = nodes[:, 3:6] * speed
    push = np.diff(velocity, axis=0) * (n / duration) + np.array([0.0, 0.0, descent.gravity])
    spent = -np.diff(nodes[:, 6]) * speed
    s, z = made.rows["thrust"], answer.z
    # Of the landing error a unit is a length, of the increment a speed.
    landing = made.structure.free and program.c[-1] == 1.0
    unit = units.length if landing else speed
    lengths = _lengths(made, program, answer) * unit / duration
    planes = made.structure.planes
    return Path(
        descent=descent,
        duration=duration,
        position=descent.end_position + nodes[:, :3] * units.length,
        velocity=velocity,
        mass=descent.mass * np.exp(nodes[:, 6] * units.kappa),
        thrust=push,
        bound=spent * n / duration,
        increment=float(-nodes[-1, 6] * speed),
        cost=float(program.c @ answer.x) * unit,
        slope=float(lengths.mean()),
        hamiltonian=-lengths,
        primer=-z[s].reshape(n, 4)[:, 1:],
        bars=z[made.rows["planes"]].reshape(-1, planes) if planes else np.zeros((0, 0)),
        iterations=answer.iterations,
        solver=answer.solver,
    )


def _lengths(made: Transcription, program: Program, answer: Answer) -> Array:
    """Return the derivative of the cost with the length of each interval (N,), scaled."""
    n, x, z = made.structure.intervals, answer.x, answer.z
    nodes = x[: 7 * (n + 1)].reshape(n + 1, 7)
    speeds = nodes[:, 3:6]
    out: Array = -0.5 * np.einsum(
        "ij,ij->i", answer.y[: 3 * n].reshape(n, 3), speeds[1:] + speeds[:-1]
    )
    short = program.g @ x - program.h
    spent = -np.diff(nodes[:, 6])
    out += z[made.rows["high"]] * n * (short[made.rows["high"]] - spent)
    out += z[made.rows["low"]] * n * (short[made.rows["low"]] + spent)
    weight = program.h[made.rows["thrust"]][3] * n
    out -= z[made.rows["thrust"]].reshape(n, 4)[:, 3] * weight
    if "tilt" in made.rows:
        out -= z[made.rows["tilt"]] * weight
    for name, axes in (("planes", made.structure.planes), ("glideslope", 3)):
        if name in made.rows:
            out[made.inner] += _stretched(made, program, answer, name, axes)
    return out


def _stretched(
    made: Transcription, program: Program, answer: Answer, name: str, axes: int
) -> Array:
    """Return what rows on control points add: they move by half the velocity with the length."""
    n = made.structure.intervals
    rows = program.g[made.rows[name]]
    moving = answer.x.copy()
    moving[: 7 * (n + 1)].reshape(n + 1, 7)[:, :3] = 0.0  # leaves half V / N of each row
    return np.asarray((answer.z[made.rows[name]] * (rows @ moving)).reshape(-1, axes).sum(1) * n)
