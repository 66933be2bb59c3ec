"""Test in-place additions of products to a covariance."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.navigation import _rock_filter_kernels as kernels


@pytest.mark.parametrize("count", [1, 2])
def test_outer_products_are_added_in_place_to_a_part_of_a_matrix(count):
    rng = np.random.default_rng(0)
    p = rng.standard_normal((40, 40))
    before, w = p.copy(), rng.standard_normal((count, 30))
    w[:, ::3] = 0.0
    kernels.add_outer_products(p[7:37, 7:37], w)
    before[7:37, 7:37] += w.T @ w
    assert p == pytest.approx(before, rel=1e-14, abs=1e-15)
