"""An attitude, as a star tracker gives it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.frames import (
    is_rotation,
    normalised,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_matrix,
    quat_to_rotation_vector,
)
from lunarsim.onboard.navigation.error_state import MAP, ErrorState, Outcome
from lunarsim.onboard.navigation.inertial import ATTITUDE

# What is left of the second order counts from this share of the noise on.
_COUNTS = 1e-2


def take_attitude(
    state: ErrorState,
    attitude: ArrayLike,
    covariance: ArrayLike,
    *,
    block: str | None = None,
    gate: float = np.inf,
) -> Outcome:
    """Take in an attitude.

    Parameters
    ----------
    state
        Of the filter.
    attitude
        Quaternion, body to ENU of the site frame (4,); what is not finite or no rotation tells
        nothing.
    covariance
        Of its noise, small rotation in body axes (3, 3), rad^2; one that is not symmetric tells
        nothing.
    block
        Where the tracker's misalignment lies in the state (small rotation, body axes); left out: it
        has none. Without it readings would average away what they share.
    gate
        See `ErrorState.measure`.

    Raises
    ------
    InputError
        If the arrays are of other shapes.
    """
    q, r = np.asarray(attitude, np.float64), np.asarray(covariance, np.float64)
    if q.shape != (4,) or r.shape != (3, 3):
        raise InputError("attitude", (q.shape, r.shape), "a quaternion and its covariance (3, 3)")
    if not (is_rotation(q) and symmetric(r)):
        return Outcome(np.nan, 3, False)
    believed = state.inertial.attitude
    if state.has(MAP):
        azimuth = float(state.value(MAP)[3])
        believed = quat_multiply(quat_from_rotation_vector([0.0, 0.0, azimuth]), believed)
    between = quat_multiply(quat_conjugate(believed), normalised(q))
    columns = np.arange(ATTITUDE.start, ATTITUDE.stop)
    jacobian = np.eye(3)
    innovation = quat_to_rotation_vector(between)
    if block is not None:
        own = state.block(block)
        columns = np.concatenate((columns, np.arange(own.start, own.stop)))
        jacobian = np.hstack((jacobian, np.eye(3)))
        innovation = innovation - state.value(block)
    if state.has(MAP):
        # Stars tell of the site frame's azimuth, not of the local one's.
        columns = np.append(columns, state.block(MAP).start + 3)
        jacobian = np.column_stack((jacobian, quat_to_matrix(believed)[2]))
        r = r + _left_over(state, r)
    return state.measure(jacobian, columns, innovation, r, gate)


def symmetric(covariance: np.ndarray) -> bool:
    """Tell whether a covariance (n, n) is finite and symmetric but for rounding."""
    if not np.isfinite(covariance).all():
        return False
    return bool(np.allclose(covariance, covariance.T, atol=1e-9 * np.abs(covariance).max()))


def _left_over(state: ErrorState, noise: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of what a correction of azimuth and tilt leaves, rad^2.

    Both are corrected at once, as if turns were added; half of their cross product is left, and is
    more than the noise of stars where the start is known to a degree or two.
    """
    p, azimuth = state.for_rows(), state.block(MAP).start + 3
    left = 0.25 * float(p[azimuth, azimuth]) * float(np.trace(p[ATTITUDE, ATTITUDE]))
    counts = left > _COUNTS * float(np.diag(noise).min())
    return left * np.eye(3) if counts else np.zeros((3, 3))
