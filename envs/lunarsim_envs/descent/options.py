"""What `reset(options=...)` of a descent may say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, suggestion
from lunarsim_envs.arguments import options_of
from lunarsim_envs.descent.lanes import Lanes

# Where each stands in `Lanes.starts`.
_PLACES = {
    "position_m": slice(0, 3), "velocity_m_s": slice(3, 6), "position_sigma_m": slice(6, 7),
    "velocity_sigma_m_s": slice(7, 8),
}  # fmt: skip

# No start is farther off, m, or faster, m/s.
MOST = 5000.0


def take(options: Mapping[str, Any] | None, lanes: Lanes, mask: NDArray[np.bool_]) -> None:
    """Change where the flights of some lanes start, from now on.

    Parameters
    ----------
    options
        ``position_m`` and ``velocity_m_s`` (3,), ``position_sigma_m``, ``velocity_sigma_m_s``:
        see the table [start] of a scenario. None, or left out: as the scenario says.
    lanes, mask
        Which.

    Raises
    ------
    InputError
        If a key is unknown or a value will not do.
    """
    starts = lanes.craft.start.copy()
    for key, value in options_of(options).items():
        if key not in _PLACES:
            raise InputError(f"options.{key}", value, suggestion(key, _PLACES))
        room = starts[_PLACES[key]]
        given = np.atleast_1d(np.asarray(value, dtype=object))
        try:
            numbers = given.astype(np.float64)
        except (TypeError, ValueError):
            numbers = np.full(1, np.nan)
        if numbers.shape != room.shape or not np.isfinite(numbers).all():
            what = "a finite number" if len(room) == 1 else f"{len(room)} finite numbers"
            raise InputError(f"options.{key}", value, what)
        if np.abs(numbers).max() > MOST:
            raise InputError(f"options.{key}", value, f"at most {MOST:g} in size")
        if key.endswith(("_sigma_m", "_sigma_m_s")) and numbers[0] < 0.0:
            raise InputError(f"options.{key}", value, "0 or more")
        starts[_PLACES[key]] = numbers
    check_height(starts, lanes)
    lanes.starts[mask] = starts


def check_height(starts: NDArray[np.float64], lanes: Lanes) -> None:
    """Refuse starts that may lie in the ground.

    Raises
    ------
    InputError
        If the planned height, less five standard deviations, is not above all ground.
    """
    low, high = lanes.worlds.levels[:, 0].min(), lanes.worlds.levels[:, 1].max()
    least = high - low + lanes.craft.dynamics.lander.com_height + 5.0 * starts[6]
    if starts[2] <= least:
        raise InputError(
            "position_m", tuple(starts[:3].tolist()),
            f"a height above {least:.1f} m: five standard deviations lower it is in the ground",
        )  # fmt: skip
