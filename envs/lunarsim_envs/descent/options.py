"""Apply the options of `reset`: start state, target, rock cover and Sun."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lunarsim.errors import InputError, suggestion
from lunarsim.scenario import Scenario
from lunarsim.scenario.changes import with_values
from lunarsim.typing import Array, BoolArray
from lunarsim_envs.arguments import checked_options
from lunarsim_envs.descent.batch import DescentBatch

# Scenario key of each option.
KEYS = {
    "position_m": "start.position_m", "velocity_m_s": "start.velocity_m_s",
    "position_sigma_m": "start.position_sigma_m", "velocity_sigma_m_s": "start.velocity_sigma_m_s",
    "target_m": "target.position_m", "target_scatter_m": "target.scatter_m",
    "cover": "rocks.cover",
    "sun_azimuth_deg": "sun.azimuth_deg", "sun_elevation_deg": "sun.elevation_deg",
}  # fmt: skip
# Slices of the options in `DescentBatch.starts` and `DescentBatch.target_areas`.
_STARTS = {
    "position_m": slice(0, 3), "velocity_m_s": slice(3, 6), "position_sigma_m": slice(6, 7),
    "velocity_sigma_m_s": slice(7, 8),
}  # fmt: skip
_AIMS = {"target_m": slice(0, 2), "target_scatter_m": slice(2, 4)}

# Bound of start positions, m, and velocities, m/s.
MOST = 5000.0


def apply_options(options: Mapping[str, Any] | None, lanes: DescentBatch, mask: BoolArray) -> None:
    """Set start, target and rock cover of the next flights of some landers.

    Parameters
    ----------
    options
        ``position_m`` and ``velocity_m_s`` (3,), ``position_sigma_m``, ``velocity_sigma_m_s`` as in
        the table [start] of a scenario; ``target_m``, ``target_scatter_m`` (2,) as in [target],
        within the target area of the scenario; ``cover``, a rock cover (area fraction) for which
        the pool has worlds. Omitted options have the values of the scenario.
    lanes
        Batch of landers.
    mask
        Landers to change (n,).

    Raises
    ------
    InputError
        If a key is unknown or a value is invalid; then nothing changes.
    """
    start, target_area = lanes.craft.start.copy(), lanes.craft.target_area.copy()
    cover: float | None = None
    for key, value in checked_options(options).items():
        if key in _STARTS:
            start[_STARTS[key]] = _checked_numbers(key, value, start[_STARTS[key]])
        elif key in _AIMS:
            target_area[_AIMS[key]] = _checked_numbers(key, value, target_area[_AIMS[key]])
        elif key == "cover":
            cover = float(_checked_numbers(key, value, np.zeros(1))[0])
        elif key in KEYS:
            raise InputError(
                f"options.{key}", value,
                "must be omitted, because this environment does not simulate the Sun",
                show_value=False,
            )  # fmt: skip
        else:
            raise _unknown_option(key)
    world_range = lanes.worlds.span(cover)
    check_start_height(start, lanes, "options.position_m[2]")
    _check_target_area(target_area, lanes)
    lanes.starts[mask], lanes.target_areas[mask] = start, target_area
    lanes.world_ranges[mask] = world_range


def scenario_with_options(options: Mapping[str, Any] | None, scenario: Scenario) -> Scenario:
    """Return a scenario with the options of `reset` applied.

    Parameters
    ----------
    options
        Options of `apply_options`, and ``sun_azimuth_deg`` and ``sun_elevation_deg`` of [sun].
    scenario
        Scenario to change.

    Raises
    ------
    InputError
        If a key is unknown or a value is invalid.
    """
    for key, value in checked_options(options).items():
        if key not in KEYS:
            raise _unknown_option(key)
        plain = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
        if plain is None:
            raise InputError(
                f"options.{key}", value, "must not be None", "Omit the option for its default.",
                show_value=False,
            )  # fmt: skip
        try:
            scenario = with_values(scenario, {KEYS[key]: plain}, "options")
        except InputError as error:
            raise error.with_field(error.field.replace(KEYS[key], key)) from error
    return scenario


def _unknown_option(key: str) -> InputError:
    return InputError(
        f"options.{key}", None, "is an unknown option", suggestion(key, KEYS), show_value=False
    )


def _checked_numbers(key: str, value: Any, template: Array) -> Array:
    """Check the numbers of an option and return them in the shape of `template`.

    `key` is the name of the option. Standard deviations and scatters must not be negative.
    """
    plain = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    several = len(template) > 1
    listed = [plain] if not several else list(plain) if isinstance(plain, Sequence) else []
    kinds = int, float, np.integer, np.floating
    are_numbers = all(isinstance(one, kinds) and not isinstance(one, bool) for one in listed)
    numbers = np.array(listed if are_numbers else [], dtype=np.float64)
    if not are_numbers or numbers.shape != template.shape:
        expected = f"{len(template)} numbers" if several else "a number"
        raise InputError(f"options.{key}", value, f"must be {expected}")
    minimum = 0.0 if key.endswith(("_sigma_m", "_sigma_m_s", "_scatter_m")) else -MOST
    for i, number in enumerate(numbers.tolist()):
        if not minimum <= number <= MOST:
            field = f"options.{key}[{i}]" if several else f"options.{key}"
            bounds = f"between {minimum:g} and {MOST:g}" if np.isfinite(number) else "finite"
            raise InputError(field, number, f"must be {bounds}")
    return numbers


def _check_target_area(target_area: Array, lanes: DescentBatch) -> None:
    """Check that targets lie in the scenario's target area, where terrain is stored.

    `target_area` (4,) has centre and half widths, east and north, m.
    """
    middle, largest = lanes.craft.target_area[:2], lanes.craft.target_area[2:]
    for i in range(2):
        target, scatter = target_area[[i, 2 + i]].tolist()
        room = largest[i] - scatter
        if room < -1e-9:
            raise InputError(
                f"options.target_scatter_m[{i}]", scatter,
                f"must be at most target.scatter_m[{i}] of the scenario ({largest[i]:g})",
            )  # fmt: skip
        if abs(target - middle[i]) > room + 1e-9:
            low, high = middle[i] - room, middle[i] + room
            bounds = f"between {low:g} and {high:g}" if room > 1e-9 else f"{low:g}"
            raise InputError(
                f"options.target_m[{i}]", target,
                f"must be {bounds}, so that targets stay in the target area of the scenario",
            )  # fmt: skip


def check_start_height(
    start: Array, lanes: DescentBatch, field: str = "start.position_m[2]"
) -> None:
    """Check that flights start above the terrain of all worlds.

    `start` (8,) has the planned position, velocity and their standard deviations, as
    `VehicleParams.start`. The planned height minus five standard deviations must be above the
    highest terrain; otherwise an `InputError` for `field` is raised.
    """
    low, high = lanes.worlds.levels[:, 0].min(), lanes.worlds.levels[:, 1].max()
    minimum = high - low + lanes.craft.dynamics.lander.com_height + 5.0 * start[6]
    if start[2] <= minimum:
        raise InputError(
            field, float(start[2]),
            f"must be above {minimum:.1f} m, which is five times position_sigma_m above the "
            "highest terrain",
        )  # fmt: skip
