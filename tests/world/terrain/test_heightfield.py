from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.grid import Grid
from lunarsim.world.terrain import Heightfield


@given(st.integers(0, 1000), st.sampled_from([0.2, 0.33, 0.5, 0.99]))
def test_refining_keeps_the_measured_posts(seed, posting):
    grid = Grid(0.0, 0.0, 1.0, 9, 7)
    relief = Heightfield(grid, np.random.default_rng(seed).random((9, 7)).astype(np.float32))
    fine = relief.refined(posting)
    factor = round(1.0 / fine.grid.posting)
    assert fine.grid.posting <= posting
    assert np.array_equal(fine.z[::factor, ::factor], relief.z)


def test_refining_does_not_invent_data():
    grid = Grid(0.0, 0.0, 1.0, 9, 9)
    z = np.zeros((9, 9), np.float32)
    z[4, 4] = np.nan
    fine = Heightfield(grid, z).refined(0.25)
    assert np.isnan(fine.z[13:20, 13:20]).all()
    assert np.isfinite(fine.z[:12]).all()


def test_scaling():
    grid = Grid(0.0, 0.0, 1.0, 3, 3)
    relief = Heightfield(grid, np.arange(9, dtype=np.float32).reshape(3, 3))
    assert np.allclose(relief.scaled(0.2).z, 0.2 * relief.z)
