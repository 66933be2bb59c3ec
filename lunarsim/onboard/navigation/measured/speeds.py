"""Speeds along the beams of a Doppler velocimeter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix
from lunarsim.onboard.navigation.error_state import ErrorState, Outcome

Array = NDArray[np.float64]

_COLUMNS = np.r_[3:6, 9:12]
# Passes at most of the iterated update, and the change of speed below which it ends, m/s.
_PASSES, _SETTLED = 5, 1e-3


def take_speeds(
    state: ErrorState,
    speed: ArrayLike,
    sigma: ArrayLike,
    beams: ArrayLike,
    gate: float = np.inf,
) -> Outcome:
    """Take in speeds over the ground.

    A beam b (body axes) sees ``b' R' v``; a small rotation of the body changes that by
    ``(b x R' v)'`` times itself. That product with the velocity is taken at what the reading itself
    makes likeliest (iterated Kalman filter; Jazwinski 1970, section 8.3): had it been taken at a
    velocity that is metres a second off, and at the next reading no more, the difference would pass
    for knowledge of the tilt.

    Parameters
    ----------
    state
        Of the filter.
    speed, sigma
        Along each beam and their standard deviations (n,), m/s; beams without a return, or whose
        deviation is not positive, tell nothing.
    beams
        Unit vectors (n, 3), body axes.
    gate
        See `ErrorState.measure`.

    Returns
    -------
    Outcome
        Its `white` has a place for every beam.
    """
    measured, noise = np.asarray(speed, np.float64), np.asarray(sigma, np.float64)
    seen = np.isfinite(measured) & np.isfinite(noise) & (noise > 0.0)
    if not seen.any():
        return Outcome(np.nan, 0, False)
    b = np.asarray(beams, np.float64)[seen]
    jacobian, innovation = _linearised(state, measured[seen], noise[seen] ** 2, b)
    found = state.measure(jacobian, _COLUMNS, innovation, noise[seen] ** 2, gate)
    if not found.taken:
        return found
    white = np.full(len(seen), np.nan)
    white[seen] = found.white
    return replace(found, white=white)


def _linearised(
    state: ErrorState, measured: Array, variance: Array, beams: Array
) -> tuple[Array, Array]:
    """Return the Jacobian (n, 6) by velocity and attitude, and the innovation (n,).

    Both about the state as it is, with derivatives where the measurement (n,) puts it.
    """
    own = state.covariance[np.ix_(_COLUMNS, _COLUMNS)]
    velocity, attitude = state.inertial.velocity, quat_to_matrix(state.inertial.attitude)
    error = np.zeros(6)
    for _ in range(_PASSES):
        rotation = attitude @ quat_to_matrix(quat_from_rotation_vector(error[3:]))
        body = rotation.T @ (velocity + error[:3])
        jacobian = np.hstack((beams @ rotation.T, np.cross(beams, body)))
        innovation = measured - beams @ body + jacobian @ error
        expected = jacobian @ own @ jacobian.T + np.diag(variance)
        step = own @ jacobian.T @ np.linalg.solve(expected, innovation) - error
        error = error + step
        if not np.abs(step[:3]).max() > _SETTLED:
            break
    return jacobian, innovation
