"""Crater profiles added to a raster."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.grid import Grid
from lunarsim.world.terrain import (
    crater_profile,
)
from lunarsim.world.terrain._crater_kernels import add_crater_profiles
from lunarsim.world.terrain.craters import APRON_RADII, DEPTH_RATIO, RIM_HEIGHT_RATIO


@given(st.integers(0, 1000))
def test_stamping_agrees_with_the_profile(seed):
    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), 30.0, 0.7)
    x, y = rng.uniform(-20.0, 20.0, (2, 6))
    diameter, freshness = rng.uniform(1.0, 15.0, 6), rng.random(6)
    z = np.zeros(grid.shape)
    add_crater_profiles(
        z,
        grid.x0,
        grid.y0,
        grid.posting,
        x,
        y,
        diameter,
        freshness,
        DEPTH_RATIO,
        RIM_HEIGHT_RATIO,
        APRON_RADII,
    )
    centres = grid.centres()
    plain = sum(
        crater_profile(np.hypot(*(centres - [x[n], y[n]]).transpose(2, 0, 1)), diameter[n],
                       freshness[n])
        for n in range(6)
    )  # fmt: skip
    assert np.allclose(z, plain, atol=1e-9)
