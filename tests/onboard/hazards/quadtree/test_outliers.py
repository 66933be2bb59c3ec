"""Test outliers in height: they change neither means nor sites; rocks still count."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector, SiteSettings

SIDE = 100.0


def field(seed, count=300_000):
    """Return points of smooth terrain with hemispheres of 0.35 to 0.6 m, and their centres."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-0.5 * SIDE, 0.5 * SIDE, (count, 2))
    z = 0.3 * np.sin(xy[:, 0] / 9.0) + 0.02 * xy[:, 1]
    rocks = rng.uniform(-0.45 * SIDE, 0.45 * SIDE, (40, 2))
    radius = rng.uniform(0.35, 0.6, 40)
    for rock, r in zip(rocks, radius, strict=True):
        near = np.hypot(*(xy - rock).T)
        z += np.where(near < r, np.sqrt(np.maximum(r**2 - near**2, 0.0)), 0.0)
    return np.column_stack((xy, z + rng.normal(0.0, 0.02, count))), rocks, radius


def with_birds(points, birds, seed):
    """Return the points, some of them raised or lowered by 1 to 1000 m."""
    rng = np.random.default_rng(seed)
    points = points.copy()
    which = rng.choice(len(points), birds, replace=False)
    points[which, 2] += rng.choice([-1.0, 1.0], birds) * 10.0 ** rng.uniform(0.0, 3.0, birds)
    return points, which


def judged(points):
    quadtree = QuadtreeMap((0.0, 0.0), SIDE)
    for part in np.array_split(points, 5):
        quadtree.insert(part)
    selector = SiteSelector(quadtree, SiteSettings(), thorough=True)
    return quadtree, selector, selector.update()


@pytest.mark.parametrize("birds", [60, 600])
def test_birds_change_hardly_a_site(birds):
    points, _, _ = field(1)
    _, _, clean = judged(points)
    _, _, found = judged(with_birds(points, birds, 2)[0])
    eligible = [{tuple(p) for p in s.position[s.status == 0, :2]} for s in (clean, found)]
    assert len(eligible[0]) > 3000
    assert len(eligible[0] ^ eligible[1]) < 0.01 * len(eligible[0])
    # Heights and roughness also match the terrain.
    height = {tuple(p[:2]): p[2] for p in clean.position}
    gap = np.array([p[2] - height[tuple(p[:2])] for p in found.position if tuple(p[:2]) in height])
    assert np.quantile(np.abs(gap), 0.999) < 0.05
    both = np.isfinite(found.roughness)
    assert np.quantile(found.roughness[both], 0.99) < 2.0 * np.nanquantile(clean.roughness, 0.99)


def test_birds_are_reported_and_nothing_else_is():
    points, _, _ = field(3, 100_000)
    lifted, which = with_birds(points, 200, 4)
    quadtree = QuadtreeMap((0.0, 0.0), SIDE)
    quadtree.insert(lifted)
    far = {round(float(z), 3) for z in lifted[which, 2]}
    told = quadtree.points[quadtree.is_outlier]
    # With ten points per square metre, cells have 1.6 m, where 1 m is hardly more than a slope.
    assert len(told) >= 0.95 * len(which)
    assert sum(round(float(z), 3) in far for z in told[:, 2]) == len(told)
    quadtree = QuadtreeMap((0.0, 0.0), SIDE)
    quadtree.insert(points)
    assert quadtree.is_outlier.sum() <= 2


def test_rocks_of_three_decimetres_are_exceptions():
    points, rocks, radius = field(5)
    _, selector, _ = judged(with_birds(points, 600, 6)[0])
    hazards = selector.ratios > selector.settings.exception_limit
    square = selector.map.side / len(hazards)
    col, row = np.floor((rocks + 0.5 * selector.map.side) / square).astype(int).T
    near = [hazards[r - 1 : r + 2, c - 1 : c + 2].any() for r, c in zip(row, col, strict=True)]
    # The smallest rocks exceed the tolerance over 0.1 m^2: three of thirty points per square metre.
    assert np.mean(near) > 0.9
    assert np.mean(np.array(near)[radius > 0.4]) == 1.0
    # There are no hazards away from rocks.
    centres = (np.argwhere(hazards)[:, ::-1] + 0.5) * square - 0.5 * selector.map.side
    gap = np.hypot(*(centres[:, None] - rocks[None]).transpose(2, 0, 1)) - radius
    assert (gap.min(axis=1) > square).mean() < 0.02


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10_000), parts=st.integers(1, 9), dwell=st.booleans())
def test_who_stands_apart_does_not_depend_on_the_order(seed, parts, dwell):
    rng = np.random.default_rng(seed)
    points, _, _ = field(seed, 4000)
    points[:, :2] *= 0.005 if dwell else 0.05  # thousands in a cell, or a few
    points, _ = with_birds(points, 40, seed)
    one, many = (QuadtreeMap((0.0, 0.0), 10.0) for _ in range(2))
    one.insert(points)
    for part in np.array_split(rng.permutation(points), parts):
        many.insert(part)
    first, second = (set(map(tuple, q.points[q.is_outlier])) for q in (one, many))
    assert first == second
    assert first or not dwell


def test_a_bird_that_finds_company_is_terrain():
    rng = np.random.default_rng(7)
    quadtree = QuadtreeMap((0.0, 0.0), 10.0)
    ground = np.column_stack((rng.uniform(-2.0, 2.0, (2000, 2)), rng.normal(0.0, 0.02, 2000)))
    quadtree.insert(ground)
    quadtree.insert([[0.51, 0.52, 2.0]])
    assert quadtree.is_outlier.sum() == 1
    node = np.array([quadtree.cell_at((0.51, 0.52), 0.8, 0.8)], np.int32)
    assert quadtree.elevation(node)[0] < 0.01
    quadtree.insert([[0.53, 0.54, 2.1], [0.52, 0.51, 1.9]])
    assert quadtree.is_outlier.sum() == 0
    assert quadtree.elevation(node)[0] > 0.02
