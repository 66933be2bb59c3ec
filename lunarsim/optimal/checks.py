"""Figures that are asked for: numbers, counts and vectors, or an error that names them."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError

Array = NDArray[np.float64]

LARGEST = 1e12  # of any figure of a descent, in its unit: squares and ratios of such are numbers


def is_number(value: Any) -> bool:
    """Tell whether it is one finite real number; True and False are none."""
    real = isinstance(value, Real) and not isinstance(value, bool | np.bool_)
    return real and bool(np.isfinite(float(value)))


def count(name: str, value: Any, least: int) -> int:
    """Return a whole number.

    Raises
    ------
    InputError
        If it is none, or under the least.
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise InputError(f"optimal.{name}", value, f"a whole number, at least {least}")
    return int(value)


def numbers(name: str, value: Any, shape: tuple[int, ...], expected: str) -> Array:
    """Return an array of finite real numbers of a shape.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        found = np.asarray(value)
    except ValueError:  # ragged
        raise InputError(f"optimal.{name}", value, expected) from None
    if found.dtype.kind not in "fiu" or found.shape != shape or not np.isfinite(found).all():
        raise InputError(f"optimal.{name}", value if found.size < 10 else found.shape, expected)
    return found.astype(np.float64)
