"""Cover of rocks on a raster against a plain loop."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.shadows import _probability_kernels as kernels

GRID = Grid.centred((0.0, 0.0), 40.0, 0.25)


def test_paint_equals_a_plain_loop():
    rng = np.random.default_rng(4)
    xy = rng.uniform(-22.0, 22.0, (40, 2))
    reach = rng.uniform(0.5, 3.0, 40)
    profile = np.sort(rng.random((40, 33)), axis=1)[:, ::-1].copy()
    profile[:, -1] = 0.0
    weight = rng.random(40)
    clear = np.ones(GRID.shape)
    kernels.multiply_clear_probability(
        clear, GRID.x0, GRID.y0, GRID.posting, xy, reach, profile, weight
    )
    expected = np.ones(GRID.shape)
    for i, j in product(range(0, GRID.rows, 3), range(0, GRID.cols, 3)):
        for k in range(40):
            d = np.hypot(GRID.x[j] - xy[k, 0], GRID.y[i] - xy[k, 1])
            p = np.interp(d / reach[k] * 32, np.arange(33), profile[k], right=0.0)
            expected[i, j] *= 1.0 - weight[k] * p
    assert clear[::3, ::3] == pytest.approx(expected[::3, ::3], abs=1e-12)
