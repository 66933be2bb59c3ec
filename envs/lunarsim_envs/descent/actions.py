"""What an agent commands: numbers from -1 to 1, and what they stand for."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from lunarsim.models.lander import Lander

Array = NDArray[np.float64]

# An action may lie past its bounds by the rounding of a float32.
_ROUNDING = 1e-6


class Actions:
    """Thrust accelerations, or thrust and torques.

    Parameters
    ----------
    lander
        Whose.
    guided
        Which of the two.

    Attributes
    ----------
    scale, offset
        Physical units are ``offset + scale * action``.
    """

    def __init__(self, lander: Lander, *, guided: bool) -> None:
        most = lander.thrust_max / lander.dry_mass
        least, half = lander.thrust_min, 0.5 * (lander.thrust_max - lander.thrust_min)
        self.scale = np.array([most, most, 0.5 * most] if guided else [half, *lander.torque_max])
        self.offset = np.array([0.0, 0.0, 0.5 * most] if guided else [least + half, 0.0, 0.0, 0.0])

    @property
    def space(self) -> spaces.Box:
        """Of one lane."""
        return spaces.Box(-1.0, 1.0, self.scale.shape, np.float32)

    def physical(self, action: ArrayLike, count: int | None = None) -> Array:
        """Return actions in physical units (n, size).

        Parameters
        ----------
        action
            From -1 to 1 (n, size), or (size,) of one environment.
        count
            Of lanes n; None: one environment.

        Raises
        ------
        ValueError
            If it is of another shape or type, not finite, or out of bounds.
        """
        size = len(self.scale)
        shape = (size,) if count is None else (count, size)
        given = np.asarray(action)
        if given.shape != shape or given.dtype.kind not in "fiu":
            raise ValueError(
                f"action of shape {given.shape} and type {given.dtype}: must be numbers of shape "
                f"{shape} from -1 to 1"
            )
        wide = given.astype(np.float64).reshape(-1, size)
        most = np.abs(wide).max(initial=0.0)
        if not most <= 1.0 + _ROUNDING:
            told = "a number that is not finite" if not np.isfinite(most) else f"{most:g} in size"
            raise ValueError(f"action with {told}: must lie from -1 to 1")
        return np.asarray(self.offset + self.scale * np.clip(wide, -1.0, 1.0))

    def action(self, physical: ArrayLike) -> NDArray[np.float32]:
        """Return the action that stands nearest to physical units (..., size)."""
        scaled = (np.asarray(physical, dtype=np.float64) - self.offset) / self.scale
        return np.asarray(np.clip(scaled, -1.0, 1.0), dtype=np.float32)
