"""Simple shape of a lander for films and recordings: body, legs and engine."""

from __future__ import annotations

import numpy as np

from lunarsim.models.lander import Lander
from lunarsim.typing import Array

# Underside and top of the body above the pad plane, and its half width, leg radii; its sides.
_UNDER, _TOP, _HALF, _SIDES = 0.25, 1.1, 0.55, 8
# Length of the flame at maximum thrust, leg radii.
_FLAME = 2.2


def body_faces(lander: Lander) -> list[Array]:
    """Return the faces of the body, polygons (k, 3) in body axes, m.

    The corners of a face run anticlockwise as seen from outside.
    """
    low, high = _levels(lander)
    turn = 2.0 * np.pi * (np.arange(_SIDES) + 0.5) / _SIDES
    ring = np.column_stack((np.cos(turn), np.sin(turn))) * _HALF * lander.leg_radius
    lower = np.column_stack((ring, np.full(_SIDES, low)))
    upper = np.column_stack((0.75 * ring, np.full(_SIDES, high)))
    faces = [np.array([lower[k - 1], lower[k], upper[k], upper[k - 1]]) for k in range(_SIDES)]
    return [*faces, upper, lower[::-1]]


def leg_lines(lander: Lander) -> Array:
    """Return the ends of the legs (legs, 2, 3), body axes, m: at body and pad."""
    pads = lander.pads
    knees = np.column_stack((0.5 * pads[:, :2], np.full(len(pads), 0.5 * sum(_levels(lander)))))
    return np.stack((knees, pads), axis=1)


def flame_vector(lander: Lander, thrust: float) -> tuple[Array, Array]:
    """Return the origin (3,) of the flame and the vector to its tip, body axes, m.

    `thrust` is the thrust of the main engine, N.
    """
    length = _FLAME * lander.leg_radius * thrust / lander.thrust_max
    return np.array([0.0, 0.0, _levels(lander)[0]]), np.array([0.0, 0.0, -length])


def _levels(lander: Lander) -> tuple[float, float]:
    """Return the heights of underside and top of the body in body axes, m."""
    foot, size = -lander.com_height, lander.leg_radius
    return foot + _UNDER * size, foot + _TOP * size
