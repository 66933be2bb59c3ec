"""Convert actions from -1 to 1 to physical commands."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.lander import Lander
from lunarsim.typing import Array

# Actions may exceed their bounds by the rounding error of float32.
_ROUNDING = 1e-6


class Actions:
    """Convert between actions from -1 to 1 and physical commands.

    Commands are thrust accelerations, or thrust and torques. Action 0 is a vertical thrust equal to
    the weight (thrust accelerations), or to the weight without propellant (thrust and torques).

    Parameters
    ----------
    lander
        Vehicle that defines the limits.
    gravity
        Gravity, m/s^2.
    guided
        Whether actions are thrust accelerations (true), or thrust and torques (false).

    Attributes
    ----------
    low, middle, high
        Physical values of the actions -1, 0 and 1 (size,), m/s^2, or N and N m. Between them the
        difference to `middle` grows with the square of the action, so that small commands, which a
        touchdown needs, are well resolved.
    """

    def __init__(self, lander: Lander, gravity: float, *, guided: bool) -> None:
        torque = np.asarray(lander.torque_max)
        if guided:
            most = lander.thrust_max / lander.dry_mass
            self.high = np.array([0.5 * most, 0.5 * most, most])
            self.low = self.high * [-1.0, -1.0, 0.0]
            self.middle = np.array([0.0, 0.0, gravity])
        else:
            weight = max(lander.dry_mass * gravity, lander.thrust_min)
            self.high = np.array([lander.thrust_max, *torque])
            self.low = np.array([lander.thrust_min, *-torque])
            self.middle = np.array([weight, 0.0, 0.0, 0.0])

    @property
    def space(self) -> spaces.Box:
        """Action space of one environment."""
        return spaces.Box(-1.0, 1.0, self.high.shape, np.float32)

    def physical(self, action: ArrayLike, count: int | None = None) -> Array:
        """Convert actions from -1 to 1 to physical units (n, size), m/s^2 or N and N m.

        Parameters
        ----------
        action
            Actions from -1 to 1 (n, size), or (size,) for a single environment.
        count
            Number of environments n; None for a single environment.

        Raises
        ------
        ValueError
            If actions have another shape or type, are not finite or are out of bounds.
        """
        size = len(self.high)
        shape = (size,) if count is None else (count, size)
        given = np.asarray(action)
        if given.shape != shape or given.dtype.kind not in "fiu":
            raise ValueError(
                f"action: must be numbers between -1 and 1 of shape {shape}, got shape "
                f"{given.shape} and type {given.dtype}."
            )
        wide = given.astype(np.float64).reshape(-1, size)
        inside = np.abs(wide) <= 1.0 + _ROUNDING
        if not inside.all():
            first = np.argwhere(~inside.reshape(shape))[0].tolist()
            value = given[tuple(first)].item()
            raise ValueError(f"action{first}: must be between -1 and 1, got {value:.7g}.")
        limited = _limited(wide)
        span = np.where(limited < 0.0, self.middle - self.low, self.high - self.middle)
        return np.asarray(self.middle + span * limited * np.abs(limited))

    def action(self, physical: ArrayLike) -> NDArray[np.float32]:
        """Return the action from -1 to 1 closest to values in physical units (..., size)."""
        offset = np.asarray(physical, dtype=np.float64) - self.middle
        span = np.where(offset < 0.0, self.middle - self.low, self.high - self.middle)
        # The span is 0 below the middle if the minimum thrust is the weight without propellant.
        with np.errstate(divide="ignore"):
            squares = _limited(offset / span)
        return np.asarray(np.sign(squares) * np.sqrt(np.abs(squares)), np.float32)


def _limited(values: Array) -> Array:
    """Return values limited to -1 to 1, for few values faster than `numpy.clip`."""
    return np.minimum(np.maximum(values, -1.0), 1.0)
