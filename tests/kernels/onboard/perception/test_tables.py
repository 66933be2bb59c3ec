"""Reading tables between their nodes."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from lunarsim.onboard.perception import _table_kernels as kernels


def test_tables_are_read_to_the_bit_as_scipy_reads_them():
    rng = np.random.default_rng(8)
    x, y = np.sort(rng.random(13)), np.sort(rng.random(10))
    table = rng.standard_normal((13, 10, 4))
    at = np.column_stack((rng.uniform(x[0], x[-1], 500), rng.uniform(y[0], y[-1], 500)))
    at[:4] = [[x[0], y[0]], [x[-1], y[-1]], [x[3], y[-1]], [x[-1], y[4]]]
    found = kernels.interpolate_table(table, x, y, at[:, 0].copy(), at[:, 1].copy())
    assert np.array_equal(found, RegularGridInterpolator((x, y), table)(at).T)


def test_what_is_read_nowhere_is_no_number():
    x, y = np.arange(3.0), np.arange(4.0)
    at_x, at_y = np.array([np.nan, 1.0, 1.0]), np.array([1.0, np.nan, 1.0])
    found = kernels.interpolate_table(np.ones((3, 4, 2)), x, y, at_x, at_y)
    assert np.array_equal(found, np.array([[np.nan, np.nan, 1.0]] * 2), equal_nan=True)
