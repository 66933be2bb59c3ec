"""The ground of a quadtree as a raster, and how high its points stand above it."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.hazards.quadtree import QuadtreeMap
from lunarsim.onboard.hazards.quadtree.surface import rises, surface
from tests.reference import quadtree as reference


def mapped(points: np.ndarray) -> QuadtreeMap:
    quadtree = QuadtreeMap((0.0, 0.0, 100.0), 12.8, 0.1)
    quadtree.insert(points)
    return quadtree


def scattered(rng: np.random.Generator, count: int, side: float = 12.8) -> np.ndarray:
    xy = rng.uniform(-0.5 * side, 0.5 * side, (count, 2))
    return np.column_stack((xy, 100.0 + 0.15 * xy[:, 0] - 0.1 * xy[:, 1]))


@pytest.mark.parametrize("count", [60, 400, 6000])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_surface_is_that_of_a_plain_search(count, seed):
    rng = np.random.default_rng(seed)
    points = scattered(rng, count, 10.0)
    points[:, 2] += rng.normal(0.0, 0.3, count)
    quadtree = mapped(points)
    height, grid = surface(quadtree, 0.4, 1.6)
    assert (grid.posting, grid.shape) == (0.4, (32, 32))
    nodes = quadtree.band(0.4, 1.6)
    cells = np.column_stack((
        quadtree.centres(nodes), quadtree.sizes(nodes), quadtree.elevation(nodes)
    ))  # fmt: skip
    expected = reference.surface(cells, grid.centres(), 0.4)
    assert height == pytest.approx(expected, abs=1e-6, nan_ok=True)


def test_a_plane_seen_thinly_keeps_its_slope():
    rng = np.random.default_rng(3)
    quadtree = mapped(scattered(rng, 900))
    height, grid = surface(quadtree, 0.4, 1.6)
    xy = grid.centres()
    plane = 100.0 + 0.15 * xy[..., 0] - 0.1 * xy[..., 1]
    middle = (np.abs(xy) < 4.0).all(axis=-1)
    # Points fall anywhere in their cells.
    assert np.abs(height - plane)[middle].mean() < 0.03
    east = np.gradient(height, grid.posting, axis=1)[middle].mean()
    assert east == pytest.approx(0.15, abs=0.01)


def test_ground_far_from_any_point_is_unknown():
    rng = np.random.default_rng(4)
    points = scattered(rng, 4000)
    height, grid = surface(mapped(points[points[:, 0] < -1.0]), 0.4, 1.6)
    east = grid.centres()[..., 0]
    assert np.isfinite(height[east < -1.0]).all()
    assert np.isnan(height[east > 4.0]).all()


def test_rises_are_the_heights_above_the_ground_about():
    rng = np.random.default_rng(5)
    points = scattered(rng, 20_000)
    # Boxes of 0.2 m, one on 1.4 m each way.
    tall = (points[:, :2] % 1.4 < 0.2).all(axis=1)
    points[:, 2] += np.where(tall, 0.4, 0.0) + rng.normal(0.0, 0.01, len(points))
    found = rises(mapped(points))
    # A box met by one point is taken for a bird.
    assert tall.mean() - 0.003 < (found > 0.3).mean() <= tall.mean()
    assert (np.abs(found) < 0.1).mean() > 0.97


def test_a_map_without_points_has_no_ground():
    quadtree = QuadtreeMap((0.0, 0.0), 12.8, 0.1)
    assert np.isnan(surface(quadtree, 0.4, 1.6)[0]).all()
    assert len(rises(quadtree)) == 0
