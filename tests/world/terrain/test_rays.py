"""Rays of every steepness over a map that is longer than wide and off the origin."""

import numpy as np
import pytest

from lunarsim.rocks.shapes import shape_table
from tests.reference import terrain as reference
from tests.worlds import long_terrain

SHAPES = shape_table().vertices


@pytest.mark.parametrize(("seed", "lift"), [(0, 30.0), (1, 6.0), (2, 1.0)])
def test_rays_agree_with_marching(seed, lift):
    """From straight down to grazing: `lift` is how far above the map they start."""
    rng = np.random.default_rng(seed)
    terrain = long_terrain(rng)
    count = 24
    start = np.column_stack((rng.uniform(-9.0, 14.0, count), rng.uniform(34.0, 74.0, count)))
    aim = np.column_stack((rng.uniform(-3.0, 8.2, count), rng.uniform(40.0, 68.0, count)))
    start[:4] = aim[:4]  # straight down, and along the axes
    start[4:8, 0] = aim[4:8, 0]
    start[8:12, 1] = aim[8:12, 1]
    origin = np.column_stack((start, rng.uniform(1.0, 1.5, count) * lift + 1.5))
    direction = np.column_stack((aim, rng.uniform(-0.5, 0.5, count))) - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    plain = reference.march(terrain, origin, direction, SHAPES)
    found = np.array(
        [terrain.cast(o, d[None]).range[0] for o, d in zip(origin, direction, strict=True)]
    )
    # Marching may step over a rim; a ray of its own that finds no ground is rare.
    assert np.sum(np.isnan(found) != np.isnan(plain)) <= 1
    off = np.abs(found - plain)
    assert np.mean(off[np.isfinite(off)] < 1e-6) > 0.9
    assert np.isfinite(plain).sum() > 12
