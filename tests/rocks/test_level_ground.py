"""One rock alone on level ground, against the ray caster of the true world."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.rock_on_plane import RockOnPlane
from lunarsim.world.terrain import Heightfield, Terrain


def scene(field: RockField, k: int) -> Terrain:
    grid = Grid.centred((0.0, 0.0), 400.0, 20.0)
    one = {name: getattr(field, name)[k : k + 1] for name in ("a", "b", "height", "yaw", "shape")}
    rock = RockField(x=np.zeros(1), y=np.zeros(1), base=field.base[k : k + 1], **one)
    return Terrain(Heightfield(grid, np.zeros(grid.shape, np.float32)), rock)


@pytest.mark.parametrize("shape", ["hemisphere", "ellipsoid", "cube", "irregular", "mixed"])
def test_rays_end_where_those_of_the_world_do(shape):
    rng = np.random.default_rng(5)
    field = RockModel(shape).draw(np.full(4, 2.0), rng)
    for k in range(len(field)):
        alone, world = RockOnPlane(field, k), scene(field, k)
        direction = rng.standard_normal((2000, 3)) * [1.0, 1.0, 0.6]
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        # From all round towards the rock, and from points near it to all sides.
        start = np.where(
            np.arange(2000)[:, None] < 1000,
            rng.uniform(-1.5, 1.5, (2000, 3)) - 30.0 * direction,
            rng.uniform(-4.0, 4.0, (2000, 3)),
        )
        start[:, 2] = np.abs(start[:, 2]) + 2.5
        distance, normal = alone.cast(start, direction)
        hits = world.cast(start, direction)
        near = np.isfinite(hits.range) & (hits.range < 100.0)
        assert near.sum() > 300
        assert distance[near] == pytest.approx(hits.range[near], abs=1e-6)
        # On an edge either face will do.
        same = np.abs(normal[near] - hits.normal[near]).max(axis=1) < 1e-6
        assert same.mean() > 0.995
        sky = direction[:, 2] > 0.0
        assert np.array_equal(np.isinf(distance[sky]), np.isnan(hits.range[sky]))


@pytest.mark.parametrize("shape", ["hemisphere", "cube", "irregular"])
def test_outlines_are_those_of_the_world(shape):
    field = RockModel(shape, burial=(0.0, 0.3)).draw(np.full(3, 2.0), np.random.default_rng(2))
    points = np.random.default_rng(3).uniform(-2.0, 2.0, (5000, 2))
    for k in range(len(field)):
        covered = RockOnPlane(field, k).covers(points)
        assert np.mean(covered == (scene(field, k).elevation(points) > 0.0)) > 0.999
        assert 0.02 < covered.mean() < 0.9
