"""Measurement model of a slant range to flat terrain (shadow EKF paper, Eq. 9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.navigation.error_state import MAP, POSE, ErrorState, UpdateOutcome

# Minimum cosine between a beam and straight down; flatter beams are ignored.
MIN_DOWN_COSINE = 0.1
# Standard deviations above this are ignored, m: their square can overflow.
MAX_SIGMA_M = 1e9


def update_with_range(
    state: ErrorState,
    distance: float,
    sigma: float,
    beam: ArrayLike,
    elevation: float,
    *,
    block: str | None = None,
    index: int = 0,
    terrain_variance: float = 0.0,
    gate: float = np.inf,
) -> UpdateOutcome:
    """Update the error state with a slant range to the terrain along a beam.

    The terrain is assumed flat (shadow EKF paper, Eq. 9).

    Parameters
    ----------
    state
        Error state of the filter.
    distance, sigma
        Range and its standard deviation, m. The reading is ignored if the range is NaN, or the
        deviation is not positive or too large.
    beam
        Unit vector of the beam (3,), body axes. The reading is ignored if the beam points less than
        6 deg below the horizon.
    elevation
        Elevation of the terrain in the site frame, m.
    block
        Name of the block (group of errors) with the correction of this elevation; default: no
        correction.
    index
        Index of the correction in that block.
    terrain_variance
        Variance of the terrain height at the footprint, m^2.
    gate
        Maximum normalised innovation squared; a larger one is rejected.
    """
    nothing = UpdateOutcome(np.nan, 1, False)
    if not (0.0 < distance < np.inf and 0.0 < sigma < MAX_SIGMA_M):
        return nothing
    rotation = quat_to_matrix(state.inertial.attitude)
    b = np.asarray(beam, dtype=np.float64)
    down = float(rotation[2] @ b)
    level = elevation if block is None else elevation + float(state.value(block)[index])
    if state.has(MAP):
        level += float(state.value(MAP)[2])
    height = float(state.inertial.position[2]) - level
    if down > -MIN_DOWN_COSINE:
        return nothing
    jacobian = np.array([-1.0 / down, *(-height / down**2 * np.cross(rotation[2], b))])
    columns = POSE[2:]
    if block is not None:
        jacobian = np.append(jacobian, 1.0 / down)
        columns = np.append(columns, state.block(block).start + index)
    if state.has(MAP):
        # The elevation of the terrain is given in the site frame.
        jacobian = np.append(jacobian, 1.0 / down)
        columns = np.append(columns, state.block(MAP).start + 2)
    return state.measure(
        jacobian, columns, distance + height / down, [sigma**2 + terrain_variance / down**2], gate
    )
