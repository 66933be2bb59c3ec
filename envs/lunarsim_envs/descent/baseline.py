"""An agent that needs no training, to compare with: E-guidance to a gate, then straight down."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim_envs.descent.core import Descents

Array = NDArray[np.float64]

# The gate over the target: height of the pads, m, and speed downward, m/s.
_HEIGHT, _SPEED = 12.0, 2.0
# Distance to the gate over speed is the time of a straight flight at that speed; slowing down takes
# so many times as long. Never less than the last seconds, at never less than this speed, s and m/s.
_LONGER, _LAST, _SLOWEST = 2.6, 1.0, 6.0
# Of the last metres: gains on position and velocity, 1/s^2 and 1/s, and the most that they ask for
# across and along the vertical, m/s^2.
_ON_POSITION, _ON_VELOCITY, _ON_SPEED = 0.36, 1.3, 1.5
_ACROSS, _ALONG = 0.25, 1.0


class PolynomialAgent:
    """E-guidance (Cherry 1964) to a gate over the target, and a vertical descent from there.

    Parameters
    ----------
    descents
        Of a ``Guidance-v0`` environment whose observation begins with position and velocity:
        ``env.unwrapped.descents``.

    Raises
    ------
    InputError
        If actions are no thrust accelerations, or the observation begins otherwise.
    """

    def __init__(self, descents: Descents) -> None:
        if not descents.lanes.guided:
            raise InputError("descents", "Control-v0", "those of a Guidance-v0 environment")
        names = [part.name for part in descents.shown.parts[:2]]
        if names != ["position", "velocity"]:
            raise InputError("observation", names, "position and velocity first")
        self._actions = descents.actions
        dynamics = descents.lanes.craft.dynamics
        self._gravity = dynamics.gravity
        self._pads = dynamics.lander.com_height

    def __call__(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return the action for an observation (size,), or for each of (n, size)."""
        seen = np.atleast_2d(np.asarray(observation, dtype=np.float64))
        position, velocity = seen[:, :3], seen[:, 3:6]
        low = position[:, 2] < self._pads + 1.15 * _HEIGHT
        wanted = np.where(
            low[:, None], self._down(position, velocity), self._to_gate(position, velocity)
        )
        wanted[:, 2] += self._gravity
        action = self._actions.action(wanted)
        return action if np.ndim(observation) == 2 else action[0]

    def _to_gate(self, position: Array, velocity: Array) -> Array:
        """Return the acceleration that meets the gate's position and velocity (n, 3), m/s^2."""
        gate = np.array([0.0, 0.0, self._pads + _HEIGHT])
        there = np.array([0.0, 0.0, -_SPEED])
        away = gate - position
        fast = np.maximum(np.linalg.norm(velocity, axis=1), _SLOWEST)
        left = np.maximum(_LONGER * np.linalg.norm(away, axis=1) / fast, _LAST)[:, None]
        return np.asarray(6.0 * away / left**2 - (4.0 * velocity + 2.0 * there) / left)

    def _down(self, position: Array, velocity: Array) -> Array:
        """Return the acceleration that comes down at the gate's speed (n, 3), m/s^2."""
        across = -_ON_POSITION * position[:, :2] - _ON_VELOCITY * velocity[:, :2]
        along = -_ON_SPEED * (velocity[:, 2:] + _SPEED)
        return np.hstack((np.clip(across, -_ACROSS, _ACROSS), np.clip(along, -_ALONG, _ALONG)))
