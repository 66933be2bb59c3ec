"""Speeds along the beams of a Doppler velocimeter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import quat_to_matrix
from lunarsim.models.instruments import FixedBeams
from lunarsim.onboard.navigation.error_state import ErrorState, Outcome

_COLUMNS = np.r_[3:6, 9:12]
# No beam's speeds are known to be off by less over a flight, m/s: of a beam that is off by a little
# all measurements say the same, and together they would move the velocity by that.
_LEAST_SPEED_BIAS = 0.02
# Nor does that wander by less in a second, m/s.
_LEAST_SPEED_WANDER = 0.005


def speed_errors(velocimeter: FixedBeams) -> tuple[float, float]:
    """Return what the speeds of a beam are off by at the start, and what that wanders in a second.

    Standard deviations, m/s: as stated, and not less than is likely.
    """
    return (
        max(velocimeter.speed_bias, _LEAST_SPEED_BIAS),
        max(velocimeter.speed_wander, _LEAST_SPEED_WANDER),
    )


def take_speeds(
    state: ErrorState,
    speed: ArrayLike,
    sigma: ArrayLike,
    beams: ArrayLike,
    gate: float = np.inf,
    *,
    biases: ArrayLike | None = None,
    known: ArrayLike | float = 0.0,
) -> Outcome:
    """Take in speeds over the ground.

    A beam b (body axes) sees ``b' R' v``; a small rotation of the body changes that by
    ``(b x R' v)'`` times itself.

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
    biases
        Places (n,) in the error state of what the beams are off by; left out: by nothing.
    known
        What they are thought to be off by now (n,), m/s.

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
    rotation = quat_to_matrix(state.inertial.attitude)
    own = rotation.T @ state.inertial.velocity
    jacobian, columns = np.hstack((b @ rotation.T, np.cross(b, own))), _COLUMNS
    innovation = measured[seen] - b @ own
    if biases is not None:
        jacobian = np.hstack((jacobian, np.eye(len(b))))
        columns = np.append(columns, np.asarray(biases)[seen])
        innovation = innovation - np.broadcast_to(known, len(seen))[seen]
    found = state.measure(jacobian, columns, innovation, noise[seen] ** 2, gate)
    if not found.taken:
        return found
    white = np.full(len(seen), np.nan)
    white[seen] = found.white
    return replace(found, white=white)
