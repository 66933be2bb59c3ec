"""Measurement model of the speeds along the beams of a Doppler velocimeter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import quat_to_matrix
from lunarsim.models.instruments import VelocimeterInstrument
from lunarsim.onboard.navigation.error_state import ErrorState, UpdateOutcome

_COLUMNS = np.r_[3:6, 9:12]
# Minimum standard deviation of the speed bias of a beam, m/s. A constant bias affects all readings
# alike, and with a smaller value they would together move the velocity by it.
_MIN_SPEED_BIAS_M_S = 0.02
# Minimum random walk of the bias in 1 s, m/s.
_MIN_SPEED_WALK_M_S = 0.005


def speed_bias_model(velocimeter: VelocimeterInstrument) -> tuple[float, float]:
    """Return a velocimeter beam's initial speed bias, and its random walk in 1 s.

    Both are standard deviations, m/s: the specified values, but not less than realistic minima.
    """
    return (
        max(velocimeter.speed_bias_sigma, _MIN_SPEED_BIAS_M_S),
        max(velocimeter.speed_bias_walk, _MIN_SPEED_WALK_M_S),
    )


def update_with_speeds(
    state: ErrorState,
    speed: ArrayLike,
    sigma: ArrayLike,
    beams: ArrayLike,
    gate: float = np.inf,
    *,
    bias_indices: ArrayLike | None = None,
    bias_estimates: ArrayLike | float = 0.0,
) -> UpdateOutcome:
    """Update the error state with Doppler speeds along velocimeter beams.

    A beam b (body axes) measures ``b' R' v``, where R is the rotation from body axes to ENU and v
    the velocity; a small rotation of the body changes this by the product of ``(b x R' v)'`` and
    the rotation.

    Parameters
    ----------
    state
        Error state of the filter.
    speed, sigma
        Speed along each beam and its standard deviation (n,), m/s; beams without a return or with a
        deviation that is not positive are ignored.
    beams
        Unit vectors of the beams (n, 3), body axes.
    gate
        Maximum normalised innovation squared; a larger one is rejected.
    bias_indices
        Indices of the beam biases in the error state (n,); default: no biases.
    bias_estimates
        Estimated biases (n,), m/s.

    Returns
    -------
    UpdateOutcome
        Outcome of the update; `whitened` has one element per beam.
    """
    measured, noise = np.asarray(speed, np.float64), np.asarray(sigma, np.float64)
    has_return = np.isfinite(measured) & np.isfinite(noise) & (noise > 0.0)
    if not has_return.any():
        return UpdateOutcome(np.nan, 0, False)
    b = np.asarray(beams, np.float64)[has_return]
    rotation = quat_to_matrix(state.inertial.attitude)
    body_velocity = rotation.T @ state.inertial.velocity
    jacobian, columns = np.hstack((b @ rotation.T, np.cross(b, body_velocity))), _COLUMNS
    innovation = measured[has_return] - b @ body_velocity
    if bias_indices is not None:
        jacobian = np.hstack((jacobian, np.eye(len(b))))
        columns = np.append(columns, np.asarray(bias_indices)[has_return])
        innovation = innovation - np.broadcast_to(bias_estimates, len(has_return))[has_return]
    outcome = state.measure(jacobian, columns, innovation, noise[has_return] ** 2, gate)
    if not outcome.is_accepted:
        return outcome
    white = np.full(len(has_return), np.nan)
    white[has_return] = outcome.whitened
    return replace(outcome, whitened=white)
