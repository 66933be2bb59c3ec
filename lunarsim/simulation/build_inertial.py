"""Where inertial navigation starts: the truth plus errors of the scenario's budget."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.onboard.navigation.inertial import InertialState, InitialErrors
from lunarsim.rng import Streams
from lunarsim.scenario import Scenario
from lunarsim.vehicle import State


def started(
    scenario: Scenario, state: State, streams: Streams
) -> tuple[InertialState, InitialErrors, NDArray[np.float64]]:
    """Return the estimate at the start, its standard deviations, and its position's error (3,)."""
    s = scenario.navigation
    errors = InitialErrors(
        max(s.position_bias_m, 1e-3), max(s.velocity_m_s, 1e-4),
        max(np.deg2rad(s.attitude_deg), 1e-6),
    )  # fmt: skip
    drawn = streams.get("navigation").standard_normal((3, 3))
    turn = quat_from_rotation_vector(errors.attitude * drawn[2])
    offset = errors.position * drawn[0]
    inertial = InertialState(
        state.position + offset,
        state.velocity + errors.velocity * drawn[1],
        quat_multiply(state.attitude, turn),
        scenario.gravity_m_s2,
        step=scenario.simulation.step_s,
    )
    return inertial, errors, offset
