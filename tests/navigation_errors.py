"""By how much navigation errs in a flight."""

from __future__ import annotations

import numpy as np

from lunarsim.frames import quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.simulation import Simulation


def error_of(simulation: Simulation) -> np.ndarray:
    """Return the errors of position, velocity and attitude (ENU), site frame (9,)."""
    state = simulation.state
    found = simulation.computer.navigation.estimate_in_site(simulation.time, state.mass)
    turn = quat_multiply(state.attitude, quat_conjugate(found.attitude))
    return np.concatenate((
        state.position - found.position, state.velocity - found.velocity,
        quat_to_rotation_vector(turn),
    ))  # fmt: skip
