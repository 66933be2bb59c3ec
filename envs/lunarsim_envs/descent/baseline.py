"""Baseline agent without training: E-guidance to a gate, then a vertical descent."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.typing import Array
from lunarsim_envs.descent.core import DescentEnvCore

# Gate above the target: height of the pads, m, and downward speed, m/s.
_HEIGHT, _SPEED = 12.0, 2.0
# Time-to-go: this factor times distance to the gate over speed, because the lander decelerates. The
# time is at least _LAST, s, and the speed at least _SLOWEST, m/s.
_LONGER, _LAST, _SLOWEST = 2.6, 1.0, 6.0
# Vertical descent: gains on lateral position and velocity and on vertical speed, 1/s^2, 1/s, 1/s,
# and limits of the lateral and vertical acceleration, m/s^2.
_ON_POSITION, _ON_VELOCITY, _ON_SPEED = 0.36, 1.3, 1.5
_ACROSS, _ALONG = 0.25, 1.0


class PolynomialGuidance:
    """Fly E-guidance (Cherry 1964) to a gate above the target, then vertically.

    Parameters
    ----------
    descents
        ``env.unwrapped.descents`` of a ``Guidance-v1`` environment with position and velocity as
        the first observation components.

    Raises
    ------
    InputError
        If actions are not thrust accelerations, or the observation has another layout.
    """

    def __init__(self, descents: DescentEnvCore) -> None:
        if not descents.lanes.guided:
            raise InputError("descents", "Control-v1", "must be from a Guidance-v1 environment")
        names = [part.name for part in descents.shown.parts[:2]]
        if names != ["position", "velocity"]:
            raise InputError("observation", names, "must begin with 'position' and 'velocity'")
        self._actions, self._physical = descents.actions, descents.physical
        dynamics = descents.lanes.craft.dynamics
        self._gravity = dynamics.gravity
        self._pads = dynamics.lander.com_height

    def __call__(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return the actions for one observation (size,) or several (n, size)."""
        seen = np.atleast_2d(self._physical(observation).astype(np.float64))
        position, velocity = seen[:, :3], seen[:, 3:6]
        low = position[:, 2] < self._pads + 1.15 * _HEIGHT
        wanted = np.where(
            low[:, None], self._down(position, velocity), self._to_gate(position, velocity)
        )
        wanted[:, 2] += self._gravity
        action = self._actions.action(wanted)
        return action if np.ndim(observation) == 2 else action[0]

    def _to_gate(self, position: Array, velocity: Array) -> Array:
        """Return the acceleration (n, 3), m/s^2, that leads to the gate above the target.

        `position` and `velocity` are (n, 3), relative to the target, ENU. Gravity is not included.
        """
        gate = np.array([0.0, 0.0, self._pads + _HEIGHT])
        there = np.array([0.0, 0.0, -_SPEED])
        away = gate - position
        fast = np.maximum(np.linalg.norm(velocity, axis=1), _SLOWEST)
        left = np.maximum(_LONGER * np.linalg.norm(away, axis=1) / fast, _LAST)[:, None]
        return np.asarray(6.0 * away / left**2 - (4.0 * velocity + 2.0 * there) / left)

    def _down(self, position: Array, velocity: Array) -> Array:
        """Return the acceleration (n, 3), m/s^2, of a vertical descent onto the target.

        The descent keeps the speed at the gate; gravity is not included.
        """
        across = -_ON_POSITION * position[:, :2] - _ON_VELOCITY * velocity[:, :2]
        along = -_ON_SPEED * (velocity[:, 2:] + _SPEED)
        return np.hstack((np.clip(across, -_ACROSS, _ACROSS), np.clip(along, -_ALONG, _ALONG)))
