"""Interpolation of a relief at the edges of its map."""

import numpy as np
import pytest

from lunarsim.world.terrain import _surface_kernels as kernels


def test_no_post_beyond_the_map_is_read():
    """A row of NaN lies behind the map in memory."""
    whole = np.full((8, 6), np.nan, np.float32)
    whole[:7] = np.arange(42.0).reshape(7, 6)
    z = whole[:7]
    for x, y in ((5.0, 2.5), (2.5, 6.0), (5.0, 6.0)):
        assert kernels.relief_at(x, y, z, 0.0, 0.0, 1.0) == pytest.approx(6.0 * y + x)
        normal = np.empty(3)
        kernels.relief_normal(x, y, z, 0.0, 0.0, 1.0, normal)
        assert normal == pytest.approx(np.array([-1.0, -6.0, 1.0]) / np.sqrt(38.0))
