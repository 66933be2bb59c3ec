"""How well the ground is known between rocks, against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.hazards.shadows.terrain_errors import (
    height_sigma,
    height_variance_growth,
)
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior

BEFORE = 10.0 * np.tan(np.radians(3.0)) ** 2


def tracked(count, seed=0):
    """Return rocks at random with errors that agree with each other and with the lander's."""
    rng = np.random.default_rng(seed)
    inertial = StrapdownState(
        np.array([0.0, 0.0, 80.0]), np.zeros(3), np.array([0, 0, 0, 1.0]), 1.6
    )
    rocks = RockFilter.of(
        inertial, terrain_prior=TerrainPrior(0.0, 1.0, float(np.tan(np.radians(3.0))))
    )
    points = rng.normal(0.0, [12.0, 12.0, 0.8], (count, 3))
    rocks.append(points, np.full(count, 0.3), np.full(count, 0.01))
    root = rng.normal(0.0, 0.1, (rocks.state.size, rocks.state.size))
    rocks.state.p[: rocks.state.size, : rocks.state.size] = root @ root.T
    return rocks


def plain_growth(rocks):
    way = rise = 0.0
    for i in range(rocks.count):
        others = sorted(range(rocks.count), key=lambda j: np.hypot(*(rocks.xy[j] - rocks.xy[i])))
        for j in others[1:4]:
            step = np.zeros(len(rocks.state.p))
            step[rocks.state_indices()[i, 2]], step[rocks.state_indices()[j, 2]] = 1.0, -1.0
            dx, dy, dz = rocks.xyz[i] - rocks.xyz[j]
            rise += dz**2 + step @ rocks.state.p @ step
            way += np.hypot(dx, dy)
    return (10.0 * BEFORE + rise) / (10.0 + way)


@pytest.mark.parametrize("count", [2, 3, 40])
def test_relief_is_estimated_from_neighbours_and_their_errors(count):
    rocks = tracked(count)
    assert height_variance_growth(rocks) == pytest.approx(plain_growth(rocks))


def test_a_rock_alone_indicates_no_relief():
    assert (
        height_variance_growth(tracked(1))
        == height_variance_growth(tracked(0))
        == pytest.approx(BEFORE)
    )
    assert np.isposinf(height_sigma(tracked(0), np.zeros((2, 2)))).all()


@pytest.mark.parametrize("count", [1, 4, 40])
def test_terrain_is_as_well_known_as_the_best_rock_near_by_reports(count):
    rocks = tracked(count, seed=2)
    at = np.random.default_rng(3).uniform(-30.0, 30.0, (50, 2))
    growth, p = plain_growth(rocks), rocks.state.p
    for point, sigma in zip(at, height_sigma(rocks, at), strict=True):
        away = np.hypot(*(rocks.xy - point).T)
        told = []
        for j in np.argsort(away)[:5]:
            h = rocks.state_indices()[j, 2]
            told.append(p[h, h] + p[2, 2] - 2.0 * p[2, h] + growth * away[j])
        assert sigma == pytest.approx(np.sqrt(min(told)))


def test_no_more_than_the_five_nearest_rocks_report():
    rocks = tracked(6)
    rocks.xyz[:] = np.column_stack((0.5 + 0.01 * np.arange(6), np.zeros(6), np.zeros(6)))
    rocks.state.p[:] = 0.0
    h = rocks.state_indices()[:, 2]
    for best in (5, 4):
        rocks.state.p[h, h] = 9.0
        rocks.state.p[h[best], h[best]] = 0.01
        growth = height_variance_growth(rocks)
        told = np.diag(rocks.state.p)[h] + growth * rocks.xyz[:, 0]
        assert (told[best] < told[:4].min()) and (told.argmin() == best)
        expected = np.sqrt(told[:5].min())
        assert height_sigma(rocks, np.zeros((1, 2)))[0] == pytest.approx(expected)


def test_terrain_at_one_height_everywhere_rises_nowhere():
    inertial = StrapdownState(
        np.array([0.0, 0.0, 80.0]), np.zeros(3), np.array([0, 0, 0, 1.0]), 1.6
    )
    assert (
        RockFilter.of(inertial, terrain_prior=TerrainPrior(2.0, None)).prior_variance_growth == 0.0
    )
