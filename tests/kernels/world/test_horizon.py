"""The horizon kernel against its reference."""

from __future__ import annotations

import numpy as np

from lunarsim.world._horizon_kernels import raise_to_terrain
from tests.reference import horizon as reference

R = 1_737_400.0


def test_the_kernel_agrees_with_the_reference():
    rng = np.random.default_rng(11)
    distances = np.sort(rng.uniform(10.0, 60_000.0, 40))
    heights = rng.normal(0.0, 2_000.0, (25, 40))
    heights[rng.random((25, 40)) < 0.2] = np.nan
    heights[3] = np.nan
    start = rng.uniform(-0.02, 0.01, 25)
    angle, reach = start.copy(), np.zeros(25)
    raise_to_terrain(angle, reach, heights, distances, 130.0, R)
    wanted = reference.raised(start, heights, distances, 130.0, R)
    np.testing.assert_allclose(angle, wanted[0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(reach, wanted[1])
    assert reach[3] == 0.0
