"""Validation of numbers, counts and vectors in a problem."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.typing import Array

LARGEST = 1e12  # maximum of any value of a descent, in its unit, so that squares do not overflow


def is_number(value: Any) -> bool:
    """Return whether a value is a single finite real number, not a boolean."""
    real = isinstance(value, Real) and not isinstance(value, bool | np.bool_)
    return real and bool(np.isfinite(float(value)))


def check_count(name: str, value: Any, minimum: int) -> int:
    """Return a value as an integer of at least `minimum`, after checking it.

    `name` is the parameter of `lunarsim.optimal` that an error names.

    Raises
    ------
    InputError
        If the value is not an integer or is below the minimum.
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or value < minimum:
        raise InputError(f"optimal.{name}", value, f"must be an integer of {minimum} or more")
    return int(value)


def check_numbers(name: str, value: Any, shape: tuple[int, ...], expected: str) -> Array:
    """Return an array of finite real numbers of a given shape.

    `name` is the parameter of `lunarsim.optimal` that an error names.

    Raises
    ------
    InputError
        If the value is not such an array; `expected` is the problem that the message states.
    """
    try:
        found = np.asarray(value)
    except ValueError:  # nested sequences of unequal length
        raise InputError(f"optimal.{name}", value, expected) from None
    if found.dtype.kind not in "fiu" or found.shape != shape:
        raise InputError(f"optimal.{name}", value if found.size < 10 else found, expected)
    for index in np.argwhere(~np.isfinite(found)):
        place = "".join(f"[{i}]" for i in index)
        raise InputError(f"optimal.{name}{place}", float(found[tuple(index)]), "must be finite")
    return found.astype(np.float64)
