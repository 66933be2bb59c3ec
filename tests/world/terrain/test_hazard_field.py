"""The made hazard field."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.world.terrain import hazard_field


def test_boulders_and_craters_are_as_described():
    terrain = hazard_field(np.random.default_rng(1), grass_sigma=0.0, swell=0.01)
    rocks = terrain.rocks
    assert len(rocks) == 300
    assert 0.4 <= 2.0 * rocks.a.min() <= 2.0 * rocks.a.max() <= 1.0
    assert np.array_equal(rocks.height, rocks.a)
    # All of them in the square, turned back.
    c, s = np.cos(np.deg2rad(20.0)), np.sin(np.deg2rad(20.0))
    u, v = c * rocks.x + s * rocks.y, -s * rocks.x + c * rocks.y
    assert max(np.abs(u).max(), np.abs(v).max()) <= 50.0
    assert max(np.abs(rocks.x).max(), np.abs(rocks.y).max()) > 50.0
    gap = np.hypot(rocks.x[:, None] - rocks.x, rocks.y[:, None] - rocks.y)
    np.fill_diagonal(gap, np.inf)
    assert (gap >= rocks.a[:, None] + rocks.a).all()
    # Depth from the level around, no more than half a metre.
    assert -0.55 < terrain.relief.z.min() < -0.15
    west, east, south, north = terrain.bounds
    assert min(east - west, north - south) > 319.0


def test_the_same_generator_gives_the_same_field():
    few = {"surround": 120.0, "boulders": 40, "craters": 3}
    a, b = (hazard_field(np.random.default_rng(3), **few) for _ in range(2))
    assert np.array_equal(a.relief.z, b.relief.z)
    assert np.array_equal(a.rocks.x, b.rocks.x)
    empty = hazard_field(np.random.default_rng(3), surround=120.0, boulders=0, craters=0)
    assert len(empty.rocks) == 0


@pytest.mark.parametrize(
    "arguments", [{"size": 400.0}, {"size": 0.0}, {"boulders": -1}, {"boulders": 900, "size": 10.0}]
)
def test_impossible_fields_are_refused(arguments):
    with pytest.raises(InputError, match="terrain"):
        hazard_field(np.random.default_rng(0), **arguments)
