"""NumPy versions of the functions of `_simd`, used with NUMBA_DISABLE_JIT.

Vectors are arrays (16,).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LANES = 16

Vector = NDArray[np.float32]


def load(array: Vector, index: int) -> Vector:
    """Return sixteen elements from an index on; zeros beyond the end of the array."""
    out = np.zeros(LANES, np.float32)
    part = array[index : index + LANES]
    out[: part.size] = part
    return out


def item(array: NDArray[Any], index: int) -> Any:
    """Return the element of an array at an index."""
    return array[index]


def store(array: Vector, index: int, value: Vector) -> None:
    """Write up to sixteen elements from an index on, but not beyond the array."""
    part = array[index : index + LANES]
    part[:] = value[: part.size]


def lane_fill(number: float) -> Vector:
    """Return a vector (16,) with the same number in all lanes."""
    return np.full(LANES, number, np.float32)


def lane_max(a: Vector, b: Vector) -> Vector:
    """Return the maximum in each lane; b if either is NaN."""
    return np.where(a > b, a, b)


def lane_sqrt(a: Vector) -> Vector:
    """Return the square root in each lane."""
    return np.sqrt(a)


def lane_abs(a: Vector) -> Vector:
    """Return the absolute value in each lane."""
    return np.abs(a)


def select_ge(a: Vector, b: Vector, yes: Vector, no: Vector) -> Vector:
    """Return the values of `yes` in lanes with a >= b, and of `no` in the other lanes."""
    return np.where(a >= b, yes, no)


def any_greater(a: Vector, b: Vector) -> bool:
    """Return whether a > b in any lane of two vectors."""
    return bool((a > b).any())
