"""Errors of scenario components: their table, and the method with a wrong result."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.typing import Array

# Tables that errors name already.
_OTHER_TABLES = {"sun", "navigation", "vehicle", "sensors", "prior_map", "expected_rocks"}


@contextmanager
def prefix_input_errors(table: str) -> Iterator[None]:
    """Name the scenario table in the fields of errors that a `with` block raises.

    The field of each `InputError` becomes "TABLE.KEY": `table` and the last part of the old field.
    Fields that begin with "sun", "navigation", "vehicle", "sensors", "prior_map" or
    "expected_rocks" already name a table and stay unchanged, as do other exceptions.
    """
    try:
        yield
    except InputError as error:
        if error.field.partition(".")[0] in _OTHER_TABLES:
            raise
        key = error.field.rpartition(".")[2]
        raise error.with_field(f"{table}.{key}") from None


def wrong_result_error(
    table: str, part: object, method: str, value: Any, expected: str, time: float | None = None
) -> InputError:
    """Return the error for a component whose method returned an invalid value.

    Parameters
    ----------
    table
        Scenario table of the component, for example "guidance".
    part
        Object whose method returned the value; None for an external caller.
    method
        Name of the method that returned the value.
    value
        Value returned.
    expected
        Description of a valid return value, a noun phrase.
    time
        Time of the call, s; None if unknown.
    """
    kind = type(part)
    name = "external" if part is None else f"{kind.__module__}:{kind.__qualname__}"
    when = "" if time is None else f" (at {time:.1f} s)"
    return InputError(table, value, f"{name}.{method} must return {expected}{when}")


def checked_vector(
    table: str, part: object, method: str, value: Any, unit: str, time: float | None = None
) -> Array:
    """Return the result of a component's method as an array (3,) after checking it.

    Parameters
    ----------
    table, part, method, time
        Scenario table, object and method that returned `value`, and time of the call (s), all for
        the error message.
    value
        Value to check.
    unit
        Unit of the vector, for the error message.

    Raises
    ------
    InputError
        If the value is not three finite numbers.
    """
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape == (3,) and np.isfinite(vector).all() and not np.iscomplexobj(value):
        return vector
    raise wrong_result_error(table, part, method, value, f"three finite numbers in {unit}", time)


def checked_command(table: str, part: object, value: Any, time: float) -> Array:
    """Return a guidance law's thrust acceleration command (3,), m/s^2, after checking.

    `table` and `part` are the scenario table and the guidance law, and `time` (s) is the time of
    the call; the error message contains them.

    Raises
    ------
    InputError
        If the value is not three finite numbers.
    """
    return checked_vector(table, part, "command", value, "m/s^2", time)
