"""Checks of what custom parts return: an error names the part, its method and the value."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError

Array = NDArray[np.float64]


def wrong_result(
    table: str, part: object, method: str, value: Any, wanted: str, time: float | None = None
) -> InputError:
    """Return the error of a part that has returned something else than it must.

    Parameters
    ----------
    table
        The scenario's table of the part.
    part, method
        Who returned it, and from which method; a part of None is one outside the simulation.
    value
        What was returned.
    wanted
        What must be returned, in words.
    time
        When, s; None: not known to the caller.
    """
    shown = value.tolist() if isinstance(value, np.ndarray) else value
    said = shown if isinstance(shown, str) else reprlib.repr(shown)
    kind = type(part)
    name = "external" if part is None else f"{kind.__module__}:{kind.__qualname__}"
    when = "" if time is None else f" at {time:.1f} s"
    return InputError(table, name, f"{method} returned {said}{when}. It must return {wanted}")


def checked_vector(
    table: str, part: object, method: str, value: Any, unit: str, time: float | None = None
) -> Array:
    """Return a vector (3,) that a part has computed, in a unit; see `wrong_result`.

    Raises
    ------
    InputError
        If it is not three finite numbers.
    """
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape == (3,) and np.isfinite(vector).all() and not np.iscomplexobj(value):
        return vector
    raise wrong_result(table, part, method, value, f"three finite numbers in {unit}", time)


def checked_command(table: str, part: object, value: Any, time: float) -> Array:
    """Return the thrust acceleration (3,) that a guidance law has commanded, m/s^2.

    Raises
    ------
    InputError
        If it is not three finite numbers.
    """
    return checked_vector(table, part, "command", value, "m/s^2", time)
