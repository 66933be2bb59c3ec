"""Vectors of lanes against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core.errors import TypingError

from lunarsim._jit import kernel
from lunarsim._simd import (
    SIMD_WIDTH,
    any_greater,
    item,
    lane_abs,
    lane_fill,
    lane_max,
    lane_sqrt,
    load,
    select_ge,
    store,
)

RNG = np.random.default_rng(0)
A, B = RNG.normal(size=(2, 100)).astype(np.float32)
AT = 7


@kernel(inner=False)
def _all(a, b, at, out):
    x = load(a, at)
    y = load(b, at)
    two = np.float32(2.0)
    store(out[0], 1, x + y)
    store(out[1], 1, x - two)
    store(out[2], 1, two * y)
    store(out[3], 1, x / y)
    store(out[4], 1, lane_max(x, y))
    store(out[5], 1, lane_max(x, lane_fill(two)))
    store(out[6], 1, lane_sqrt(lane_abs(x)))
    store(out[7], 1, select_ge(x, y, x, lane_fill(0.0)))


def test_operations_are_those_of_numpy():
    out = np.full((8, SIMD_WIDTH + 2), 9.0, np.float32)
    _all(A, B, AT, out)
    x, y = A[AT : AT + SIMD_WIDTH], B[AT : AT + SIMD_WIDTH]
    wanted = [
        x + y, x - 2, 2 * y, x / y, np.maximum(x, y), np.maximum(x, 2), np.sqrt(np.abs(x)),
        np.where(x >= y, x, 0),
    ]  # fmt: skip
    np.testing.assert_allclose(out[:, 1:-1], wanted, rtol=3e-7)
    # Nothing is written beside the sixteen.
    assert (out[:, [0, -1]] == 9.0).all()


@kernel(inner=False)
def _any(a, b):
    return any_greater(load(a, 0), load(b, 0))


def test_any_lane_counts():
    low = np.zeros(SIMD_WIDTH, np.float32)
    assert not _any(low, low)
    for k in range(SIMD_WIDTH):
        high = low.copy()
        high[k] = 1e-30
        assert _any(high, low)


@kernel(inner=False)
def _items(a, marks, numbers):
    return item(a, 3), item(marks, 1), item(numbers, 2)


def test_items_of_any_kind():
    marks, numbers = np.array([False, True]), np.array([5, 6, -7])
    assert _items(A, marks, numbers) == (A[3], True, -7)


@kernel(inner=False)
def _wrong(a):
    return load(a, 0) > load(a, 0)


def test_what_is_not_defined_is_refused():
    with pytest.raises(TypingError):
        _wrong(A)
    with pytest.raises(TypingError):
        _any(A.astype(np.int64), A)
