"""Test compiled kriging and square counting against simple references."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.navigation import _kriging_kernels as kernels
from tests.reference import ground as reference


@pytest.mark.parametrize(("places", "count"), [(1, 1), (2, 2), (3, 3), (9, 5), (200, 5)])
def test_heights_are_those_of_the_reference(places, count):
    rng = np.random.default_rng(places)
    where, at = rng.uniform(-40.0, 40.0, (places, 2)), rng.uniform(-60.0, 60.0, (20, 2))
    known, given = rng.normal(size=places), (count, 0.3, 0.05)
    found = kernels.interpolate_heights(where, known, at, *given)
    assert found == pytest.approx(reference.kriged(where, known, at, *given), abs=1e-9)


def test_duplicate_places_and_non_finite_points():
    where = np.array([[3.0, 1.0], [3.0, 1.0], [-8.0, 2.0]])
    known, at = np.array([1.0, 2.0, 7.0]), np.array([[3.0, 1.0], [np.nan, 0.0], [0.0, np.inf]])
    found = kernels.interpolate_heights(where, known, at, 3, 1.0, 0.05)
    assert found[0] == pytest.approx(1.5, abs=0.01)
    assert np.isnan(found[1:]).all()


@pytest.mark.parametrize("seed", range(6))
def test_squares_that_points_lie_on(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=10.0 ** rng.uniform(-1.0, 2.0), size=(300, 3))
    points[rng.random(300) < 0.2, rng.integers(2)] = np.nan
    side = float(rng.uniform(0.3, 3.0))
    wanted = reference.squares(points, side)
    assert kernels.count_covered_squares(points, side, 1000) == wanted
    assert kernels.count_covered_squares(points, side, wanted) == wanted
    assert kernels.count_covered_squares(points, side, wanted - 1) == wanted - 1


def test_squares_of_a_scan_that_grazes_the_terrain_are_not_counted_one_by_one():
    far = np.array([[0.0, 0.0, 0.0], [1e5, 1e5, 0.0]])
    assert kernels.count_covered_squares(far, 1.0, 10) == -1
    assert kernels.count_covered_squares(np.full((4, 3), np.nan), 1.0, 10) == 0
