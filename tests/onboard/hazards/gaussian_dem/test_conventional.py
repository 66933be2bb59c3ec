from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import (
    conventional_dem,
)
from tests.reference import dem as reference

GRID = Grid.centred((0.0, 0.0), 8.0, 0.5)


def cloud(seed: int, n: int = 60, spread: float = 3.9) -> np.ndarray:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-spread, spread, (n, 2))
    return np.column_stack((xy, np.sin(xy[:, 0]) + 0.1 * rng.standard_normal(n)))


@given(st.integers(0, 1000))
def test_conventional_dem_agrees_with_the_plain_reference(seed):
    points = cloud(seed)
    ours = conventional_dem(points, GRID)
    z, weight = reference.conventional(points, GRID)
    assert np.allclose(ours.weight, weight, atol=1e-6)
    known = weight > 0.0
    assert np.allclose(ours.elevation[known], z[known], atol=1e-5)
    assert np.isfinite(ours.elevation).all()


def test_holes_take_the_mean_of_their_neighbours():
    grid = Grid(0.0, 0.0, 1.0, 3, 3)
    points = [[x, y, 10.0 * x + y] for x in range(3) for y in range(3) if (x, y) != (1, 1)]
    dem = conventional_dem(points, grid)
    assert dem.elevation[1, 1] == pytest.approx(np.mean([p[2] for p in points]))
    far = conventional_dem([[0.0, 0.0, 7.0]], grid)
    assert np.allclose(far.elevation, 7.0)
