"""Test the nearest-neighbour search against sorting all places."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.navigation import _kriging_kernels as kernels


def scattered(rng, n):
    return rng.normal(scale=(40.0, 10.0), size=(n, 2))


def crowded(rng, n):
    return np.concatenate((rng.normal(scale=0.3, size=(n - 3, 2)), rng.uniform(-200, 200, (3, 2))))


def posts(rng, n):
    """Return places on a grid, with many equal distances and some duplicates."""
    return np.rint(rng.uniform(-6.0, 6.0, (n, 2)))


def line(rng, n):
    return np.column_stack((rng.uniform(-50.0, 50.0, n), np.full(n, 3.0)))


def strip(rng, n):
    return rng.uniform((-500.0, -0.01), (500.0, 0.01), (n, 2))


def test_places_of_which_one_is_nowhere_lie_on_one_square():
    east, north = np.random.default_rng(0).normal(size=(2, 90))
    for nowhere in (np.nan, np.inf, -np.inf):
        east[7] = nowhere
        order, first, _ = kernels.sort_by_square(east, north)
        assert order.tolist() == list(range(90))
        assert first.tolist() == [0, 90]


@pytest.mark.parametrize("lie", [scattered, crowded, posts, line, strip])
@pytest.mark.parametrize("n", [1, 4, 48, 49, 300, 1500])
def test_the_nearest_are_those_that_sorting_finds(lie, n):
    rng = np.random.default_rng(n)
    places = lie(rng, max(n, 4))[:n]
    east, north = places.T.copy()
    squares = kernels.sort_by_square(east, north)
    assert np.sort(squares[0]).tolist() == list(range(n))
    span = np.ptp(places, axis=0).max() + 1.0
    for x, y in np.concatenate((places[:5], np.rint(rng.uniform(-span, span, (60, 2))))):
        k = min(5, n)
        chosen, away = np.empty(k, np.int64), np.empty(k)
        assert kernels.find_nearest(east, north, x, y, squares, chosen, away) == k
        distance = (east - x) ** 2 + (north - y) ** 2
        assert chosen.tolist() == np.argsort(distance, kind="stable")[:k].tolist()
        assert away == pytest.approx(distance[chosen], rel=1e-12, abs=1e-12)
