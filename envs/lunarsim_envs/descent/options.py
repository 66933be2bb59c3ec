"""What `reset(options=...)` may say: where flights start and are to land, over which ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, suggestion
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_values
from lunarsim_envs.arguments import options_of
from lunarsim_envs.descent.lanes import Lanes

Array = NDArray[np.float64]

# What of a scenario each stands for.
KEYS = {
    "position_m": "start.position_m", "velocity_m_s": "start.velocity_m_s",
    "position_sigma_m": "start.position_sigma_m", "velocity_sigma_m_s": "start.velocity_sigma_m_s",
    "target_m": "target.position_m", "target_scatter_m": "target.scatter_m",
    "cover": "rocks.cover",
    "sun_azimuth_deg": "sun.azimuth_deg", "sun_elevation_deg": "sun.elevation_deg",
}  # fmt: skip
# Where each stands in `Lanes.starts` and in `Lanes.aims`.
_STARTS = {
    "position_m": slice(0, 3), "velocity_m_s": slice(3, 6), "position_sigma_m": slice(6, 7),
    "velocity_sigma_m_s": slice(7, 8),
}  # fmt: skip
_AIMS = {"target_m": slice(0, 2), "target_scatter_m": slice(2, 4)}

# No start is farther off, m, or faster, m/s.
MOST = 5000.0


def take(options: Mapping[str, Any] | None, lanes: Lanes, mask: NDArray[np.bool_]) -> None:
    """Change where the flights of some lanes start and land, and over what, from now on.

    Parameters
    ----------
    options
        ``position_m`` and ``velocity_m_s`` (3,), ``position_sigma_m``, ``velocity_sigma_m_s``:
        see the table [start] of a scenario. ``target_m``, ``target_scatter_m`` (2,): see [target];
        targets lie where those of the scenario may. ``cover``: one that worlds were drawn with.
        None, or left out: as the scenario says.
    lanes, mask
        Which.

    Raises
    ------
    InputError
        If a key is unknown or a value will not do; nothing is changed then.
    """
    starts, aims = lanes.craft.start.copy(), lanes.craft.aim.copy()
    cover: float | None = None
    for key, value in options_of(options).items():
        if key in _STARTS:
            starts[_STARTS[key]] = _numbers(key, value, starts[_STARTS[key]])
        elif key in _AIMS:
            aims[_AIMS[key]] = _numbers(key, value, aims[_AIMS[key]])
        elif key == "cover":
            cover = float(_numbers(key, value, np.zeros(1))[0])
        elif key in KEYS:
            raise InputError(
                f"options.{key}", value,
                "left out: nothing here sees by the Sun but perception on board",
            )  # fmt: skip
        else:
            raise InputError(f"options.{key}", value, suggestion(key, KEYS))
    span = lanes.worlds.span(cover)
    check_height(starts, lanes)
    _check_aims(aims, lanes)
    lanes.starts[mask], lanes.aims[mask], lanes.spans[mask] = starts, aims, span


def changed_by(options: Mapping[str, Any] | None, scenario: Scenario) -> Scenario:
    """Return a scenario as the options of a reset say; see `take`.

    Also ``sun_azimuth_deg`` and ``sun_elevation_deg``: see the table [sun].

    Raises
    ------
    InputError
        If a key is unknown or a value will not do.
    """
    for key, value in options_of(options).items():
        if key not in KEYS:
            raise InputError(f"options.{key}", value, suggestion(key, KEYS))
        plain = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
        if plain is None:
            raise InputError(f"options.{key}", value, "a value, or left out: as the scenario says")
        try:
            scenario = with_values(scenario, {KEYS[key]: plain}, "options")
        except InputError as error:
            raise InputError(f"options.{key}", value, error.problem, error.remedy) from error
    return scenario


def _numbers(key: str, value: Any, room: Array) -> Array:
    """Return the numbers of an option, as many as there is room for."""
    plain = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    several = list(plain) if isinstance(plain, Sequence) else []
    listed = [plain] if len(room) == 1 else several
    kinds = int, float, np.integer, np.floating
    told = all(isinstance(one, kinds) and not isinstance(one, bool) for one in listed)
    numbers = np.array(listed, dtype=np.float64) if told else np.full(1, np.nan)
    if numbers.shape != room.shape or not np.isfinite(numbers).all():
        what = "a finite number" if len(room) == 1 else f"{len(room)} finite numbers"
        raise InputError(f"options.{key}", value, what)
    if np.abs(numbers).max() > MOST:
        raise InputError(f"options.{key}", value, f"at most {MOST:g} in size")
    if key.endswith(("_sigma_m", "_sigma_m_s", "_scatter_m")) and numbers.min() < 0.0:
        raise InputError(f"options.{key}", value, "0 or more")
    return np.asarray(numbers)


def _check_aims(aims: Array, lanes: Lanes) -> None:
    """Refuse targets off the ground that worlds are kept of: where the scenario's may lie."""
    middle, scatter = lanes.craft.aim[:2], lanes.craft.aim[2:]
    low, high = middle - scatter, middle + scatter
    if np.any(aims[:2] - aims[2:] < low - 1e-9) or np.any(aims[:2] + aims[2:] > high + 1e-9):
        raise InputError(
            "options.target_m", (*aims[:2].tolist(), *aims[2:].tolist()),
            f"with target_scatter_m on either side within {low[0]:g} to {high[0]:g} m east and "
            f"{low[1]:g} to {high[1]:g} m north, where the scenario's targets lie "
            "(target.scatter_m)",
        )  # fmt: skip


def check_height(starts: Array, lanes: Lanes) -> None:
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
