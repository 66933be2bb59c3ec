"""Fly planned commands in the simulator without feedback."""

from __future__ import annotations

import numpy as np

from lunarsim.optimal.six_dof.path import RigidPath
from lunarsim.typing import Array
from lunarsim.vehicle.dynamics import Dynamics
from lunarsim.vehicle.state import State


def simulate_open_loop(path: RigidPath, max_step: float = 0.01) -> tuple[Array, Array]:
    """Simulate a rigid-body path with its planned commands, without feedback.

    Parameters
    ----------
    path
        Path whose start and commands are used.
    max_step
        Maximum integration step, s.

    Returns
    -------
    times
        Time (K,), s.
    states
        States (K, 15), as `State.as_vector`.
    """
    d, count = path.descent, len(path.thrust)
    length = path.duration / count
    parts = int(np.ceil(length / max_step))
    dynamics = Dynamics(d.lander, d.gravity, step=length / parts)
    state = State.from_vector(path.states[0])
    rows = [state.as_vector()]
    for thrust, torque in zip(path.thrust, path.torque, strict=True):
        for _ in range(parts):
            state = dynamics.advance(state, float(thrust), torque)
            rows.append(state.as_vector())
    return np.linspace(0.0, path.duration, count * parts + 1), np.array(rows)
