"""Angles and random numbers of compiled descents."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from lunarsim_envs.descent import _kernels as k
from lunarsim_envs.descent._loop_kernels import first_quadrant_angle


@numba.njit
def _angles(s, w, out):
    for n in range(len(s)):
        out[n] = first_quadrant_angle(s[n], w[n])


def test_angles_are_those_of_the_library():
    rng = np.random.default_rng(8)
    angle = np.concatenate((rng.uniform(0.0, 0.5 * np.pi, 4000), 10.0 ** rng.uniform(-14, 0, 4000)))
    size = 10.0 ** rng.uniform(-8, 3, len(angle))
    s = np.concatenate((size * np.sin(angle), [0.0, 1.0, 0.0, 1.0, 0.66]))
    w = np.concatenate((size * np.cos(angle), [1.0, 0.0, 0.0, 1.0, 1.0]))
    out = np.empty(len(s))
    _angles(s, w, out)
    assert out == pytest.approx(np.arctan2(s, w), rel=4e-16, abs=0.0)


def test_draws_are_even_and_normal():
    """Against their first moments, and each other: 100,000 of neighbouring keys."""
    even = np.array([k.uniform(np.uint64(n // 10), n % 10) for n in range(100_000)])
    assert even.min() > 0.0 and even.max() < 1.0
    assert even.mean() == pytest.approx(0.5, abs=0.004)
    assert even.var() == pytest.approx(1.0 / 12.0, abs=0.002)
    assert abs(np.corrcoef(even[:-1], even[1:])[0, 1]) < 0.01
    assert abs(np.corrcoef(even[:-10], even[10:])[0, 1]) < 0.01
    bell = np.array([k.normal(np.uint64(n), 2) for n in range(20_000)])
    assert (bell.mean(), bell.std()) == pytest.approx((0.0, 1.0), abs=0.03)
    assert np.mean(np.abs(bell) > 2.0) == pytest.approx(0.0455, abs=0.006)
