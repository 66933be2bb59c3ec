"""A slant range to level ground (shadow EKF paper, Eq. 9, for any boresight)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.error_state import MAP, POSE, ErrorState, Outcome

Array = NDArray[np.float64]

# Cosine from straight down beyond which a beam says little of the ground below.
LEAST_DOWN = 0.1
# A deviation beyond this tells nothing, m: its square may be no number.
VAGUE = 1e9


def take_range(
    state: ErrorState,
    distance: float,
    sigma: float,
    beam: ArrayLike,
    ground: float,
    *,
    block: str | None = None,
    part: int = 0,
    rise: float = 0.0,
    gate: float = np.inf,
) -> Outcome:
    """Take in a range.

    Parameters
    ----------
    state
        Of the filter.
    distance, sigma
        Measured, and its standard deviation, m; NaN, or a deviation that is not positive or
        beyond any use, tells nothing.
    beam
        Unit vector (3,), body axes.
    ground
        Elevation of the ground in the site frame, m.
    block
        What is to be added to that elevation is kept there in the state; left out: nothing.
    part
        Which error of that block.
    rise
        Variance of the ground's height where the beam meets it, along the beam, m^2.
    gate
        See `ErrorState.measure`.
    """
    nothing = Outcome(np.nan, 1, False)
    if not (0.0 < distance < np.inf and 0.0 < sigma < VAGUE):
        return nothing
    rotation = quat_to_matrix(state.inertial.attitude)
    b = np.asarray(beam, dtype=np.float64)
    down = float(rotation[2] @ b)
    level = ground if block is None else ground + float(state.value(block)[part])
    if state.has(MAP):
        level += float(state.value(MAP)[2])
    height = float(state.inertial.position[2]) - level
    if down > -LEAST_DOWN:
        return nothing
    jacobian = np.array([-1.0 / down, *(-height / down**2 * np.cross(rotation[2], b))])
    columns = POSE[2:]
    if block is not None:
        jacobian = np.append(jacobian, 1.0 / down)
        columns = np.append(columns, state.block(block).start + part)
    if state.has(MAP):
        # The ground's elevation is known in the site frame.
        jacobian = np.append(jacobian, 1.0 / down)
        columns = np.append(columns, state.block(MAP).start + 2)
    return state.measure(jacobian, columns, distance + height / down, [sigma**2 + rise], gate)
