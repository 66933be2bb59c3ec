"""A detector's counts in one pass against one operation after the other."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from lunarsim.sensors.detector import counts_from_electrons


def plainly(electrons, rng, shot_noise, read_noise, full_well, gain, bits):
    """Return the counts as arrays have them, operation by operation."""
    came = electrons.copy()
    if shot_noise or read_noise > 0.0:
        variance = np.full(electrons.shape, read_noise**2, np.float32)
        if shot_noise:
            few = electrons < 300.0
            variance[~few] += electrons[~few]
            came[few] = rng.poisson(electrons[few])
        came += np.sqrt(variance) * rng.standard_normal(electrons.shape, np.float32)
    if gain < 1.0:
        came = np.minimum(came, np.float32(full_well))
    top = 2**bits - 1
    return np.rint(np.clip(came * np.float32(gain * top / full_well), 0.0, top))


@pytest.mark.parametrize("bits", [8, 9, 12, 16])
def test_what_is_no_number_counts_nothing_and_no_count_is_beyond_the_top(bits):
    electrons = np.array([[np.nan, np.inf, -np.inf, -5.0, 1e30, 0.0]], np.float32)
    found = counts_from_electrons(
        electrons, np.random.default_rng(0), shot_noise=False, read_noise=1.0, full_well=2e4,
        gain=1.0, bits=bits,
    )  # fmt: skip
    top = 2**bits - 1
    assert found.tolist() == [[0, top, 0, 0, top, 0]]


@pytest.mark.parametrize(
    ("shot", "read", "gain", "bits"),
    list(product([True, False], [0.0, 25.0], [0.6, 1.0, 2.5], [8, 12, 16])),
)
def test_counts_are_those_of_one_operation_after_the_other(shot, read, gain, bits):
    electrons = np.random.default_rng(1).choice(
        np.array([0.0, 3.0, 299.0, 300.0, 5e3, 2.1e4, 9e4], np.float32), (60, 70)
    )
    found = counts_from_electrons(
        electrons.copy(), np.random.default_rng(2), shot_noise=shot, read_noise=read,
        full_well=2e4, gain=gain, bits=bits,
    )  # fmt: skip
    expected = plainly(electrons, np.random.default_rng(2), shot, read, 2e4, gain, bits)
    assert found.dtype == (np.uint8 if bits == 8 else np.uint16)
    np.testing.assert_array_equal(found, expected)
