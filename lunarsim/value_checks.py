"""Checks of numbers and arrays; the errors name the first wrong element."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.typing import Array


def as_real_array(field: str, values: ArrayLike) -> Array:
    """Convert values to an array of float64, with NaN for masked values.

    Raises
    ------
    InputError
        If the values are complex, text or logical; the error names `field`.
    """
    kind = np.asarray(values).dtype
    if kind.kind not in "fiuO":
        raise InputError(
            field, values, f"must be real numbers, not of type {kind.name}", show_value=False
        )
    if isinstance(values, np.ma.MaskedArray):
        return np.asarray(np.ma.filled(values.astype(np.float64), np.nan))
    return np.asarray(values, dtype=np.float64)


def check_shape(field: str, value: Any, shape: tuple[int, ...], why: str = "") -> None:
    """Raise InputError unless an array has a given shape.

    Parameters
    ----------
    field
        Name of the array in the error.
    value
        Number or array.
    shape
        Required shape.
    why
        End of the problem in the error, if the shape is not fixed: "like the grid", "for 3 beams".

    Raises
    ------
    InputError
        If `value` has another shape; the error shows the shape.

    Examples
    --------
    >>> check_shape("map.value", np.zeros((2, 3)), (2, 4), "like the grid")
    Traceback (most recent call last):
    lunarsim.errors.InputError: map.value: must have shape (2, 4) like the grid, got (2, 3).
    """
    if np.shape(value) != shape:
        raise InputError(field, np.shape(value), f"must have shape {shape} {why}".rstrip())


def check_finite(field: str, value: ArrayLike) -> None:
    """Raise InputError unless a number, or each element of an array, is finite.

    Raises
    ------
    InputError
        For the first element that is not finite: "estimate.position[2]".
    """
    numbers = np.asarray(value, dtype=np.float64)
    check_elements(field, numbers, np.isfinite(numbers), "must be finite")


def check_elements(
    field: str, values: ArrayLike, is_valid: ArrayLike, problem: str, remedy: str = ""
) -> None:
    """Raise InputError for the first invalid element of an array.

    Parameters
    ----------
    field
        Name of the array in the error.
    values
        Number or array.
    is_valid
        Whether each element is valid, of the same shape.
    problem, remedy
        Problem and remedy of the error.

    Raises
    ------
    InputError
        If an element is invalid. The error names the array and the index, and shows the element.

    Examples
    --------
    >>> check_elements("sigma", [0.1, -2.0], [True, False], "must be 0 or more")
    Traceback (most recent call last):
    lunarsim.errors.InputError: sigma[1]: must be 0 or more, got -2.0.
    """
    valid = np.asarray(is_valid)
    if valid.all():
        return
    index = tuple(np.argwhere(~valid)[0].tolist())
    name = f"{field}[{', '.join(map(str, index))}]" if index else field
    raise InputError(name, np.asarray(values)[index].item(), problem, remedy)


def check_time(field: str, time: float, last: float) -> None:
    """Raise InputError unless a time is finite and not before the last one, both in s.

    Raises
    ------
    InputError
        If `time` is not finite or less than `last`; the error names `field`.
    """
    check_finite(field, time)
    if time < last:
        raise InputError(field, time, f"must be at least the previous time, {last} s")
