"""Measurement model of a star tracker's attitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import (
    is_rotation,
    normalised,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_to_matrix,
    quat_to_rotation_vector,
)
from lunarsim.onboard.navigation.error_state import MAP, ErrorState, UpdateOutcome
from lunarsim.onboard.navigation.inertial import ATTITUDE
from lunarsim.value_checks import check_shape

# Second-order errors are added if they exceed this fraction of the noise variance.
_MIN_SECOND_ORDER_SHARE = 1e-2


def update_with_attitude(
    state: ErrorState,
    attitude: ArrayLike,
    covariance: ArrayLike,
    *,
    block: str | None = None,
    gate: float = np.inf,
) -> UpdateOutcome:
    """Update the error state with an attitude measured by a star tracker.

    Parameters
    ----------
    state
        Error state of the filter.
    attitude
        Quaternion, body to ENU of the site frame (4,); ignored if it is not a unit quaternion.
    covariance
        Noise covariance of the small rotation in body axes (3, 3), rad^2; a reading with an
        asymmetric covariance is ignored.
    block
        Name of the block (group of errors) with the tracker's misalignment (small rotation, body
        axes); default: no misalignment. Without this block, repeated readings would average away
        their common error.
    gate
        Maximum normalised innovation squared; a larger one is rejected.

    Raises
    ------
    InputError
        If an array has a wrong shape.
    """
    q, r = np.asarray(attitude, np.float64), np.asarray(covariance, np.float64)
    check_shape("attitude", q, (4,))
    check_shape("covariance", r, (3, 3))
    if not (is_rotation(q) and is_symmetric(r)):
        return UpdateOutcome(np.nan, 3, False)
    estimated = state.inertial.attitude
    if state.has(MAP):
        azimuth = float(state.value(MAP)[3])
        estimated = quat_multiply(quat_from_rotation_vector([0.0, 0.0, azimuth]), estimated)
    rotation = quat_multiply(quat_conjugate(estimated), normalised(q))
    columns = np.arange(ATTITUDE.start, ATTITUDE.stop)
    jacobian = np.eye(3)
    innovation = quat_to_rotation_vector(rotation)
    if block is not None:
        own = state.block(block)
        columns = np.concatenate((columns, np.arange(own.start, own.stop)))
        jacobian = np.hstack((jacobian, np.eye(3)))
        innovation = innovation - state.value(block)
    if state.has(MAP):
        # Star trackers measure the attitude in the site frame, not in the local frame.
        columns = np.append(columns, state.block(MAP).start + 3)
        jacobian = np.column_stack((jacobian, quat_to_matrix(estimated)[2]))
        r = r + _second_order_covariance(state, r)
    return state.measure(jacobian, columns, innovation, r, gate)


def is_symmetric(covariance: np.ndarray) -> bool:
    """Return whether a covariance (n, n) is finite and symmetric up to rounding."""
    if not np.isfinite(covariance).all():
        return False
    return bool(np.allclose(covariance, covariance.T, atol=1e-9 * np.abs(covariance).max()))


def _second_order_covariance(state: ErrorState, noise: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) of the second-order attitude error, rad^2.

    The update adds the corrections of attitude and azimuth linearly. Half of their cross product
    remains as an error, which exceeds the star-tracker noise if the initial attitude is known to a
    degree or two only. The result is zero if the error is small relative to the measurement `noise`
    (3, 3), rad^2.
    """
    p, azimuth = state.covariance_for_rows(), state.block(MAP).start + 3
    variance = 0.25 * float(p[azimuth, azimuth]) * float(np.trace(p[ATTITUDE, ATTITUDE]))
    is_significant = variance > _MIN_SECOND_ORDER_SHARE * float(np.diag(noise).min())
    return variance * np.eye(3) if is_significant else np.zeros((3, 3))
