"""Height, normal and rays of one rock of any shape, against the set of its points."""

import numpy as np
import pytest

from lunarsim.rocks import _kernels as kernels
from lunarsim.rocks.shapes import shape_table
from tests.reference import rocks as plain

FAR = 14.0


def rock(rng, shape):
    """Return a rock off the origin, its base above or below the ground, its axes unlike."""
    yaw = rng.uniform(0.0, 2.0 * np.pi)
    return np.array(
        [*rng.uniform(-1.0, 1.0, 2), rng.uniform(-0.4, 0.8), *rng.uniform(0.5, 2.0, 3),
         np.cos(yaw), np.sin(yaw), shape]
    )  # fmt: skip


def rays(rng, row, count):
    """Return starts about a rock, some below the ground, and directions to points of it."""
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    start = np.column_stack((6.0 * np.cos(angle), 6.0 * np.sin(angle), rng.uniform(-1, 5, count)))
    aim = row[:3] + rng.uniform(-1.2, 1.2, (count, 3)) * row[3:6]
    direction = aim - start
    return start, direction / np.linalg.norm(direction, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("shape", [0, 1, 2, 9])
def test_rays_meet_rock_or_terrain(shape, seed):
    rng = np.random.default_rng((shape, seed))
    table = shape_table()
    planes = table.planes[shape, : table.count[shape]]
    row = rock(rng, shape)
    origin, direction = rays(rng, row, 120)
    distance, found = np.empty(120), np.empty((120, 3))
    kernels.cast_on_plane(origin, direction, row[None], table.planes, table.count, distance, found)
    met = missed = agreed = 0
    for n in range(120):
        met_rock = plain.entry(origin[n], direction[n], row, planes, FAR, 0.02)
        down = origin[n, 2] >= 0.0 and direction[n, 2] < 0.0
        ground = -origin[n, 2] / direction[n, 2] if down else np.inf
        wanted = min(met_rock, ground)
        # A ray through an edge may pass between two steps.
        if distance[n] == pytest.approx(wanted, abs=1e-9):
            agreed += 1
        if wanted == ground:
            missed += 1
            assert distance[n] != wanted or found[n].tolist() == [0.0, 0.0, 1.0]
        else:
            met += 1
            up = plain.normal(origin[n] + wanted * direction[n], row, planes)
            agreed -= np.abs(up - found[n]).max() > 1e-5
    assert agreed >= 118
    assert met > 25 and missed > 15


@pytest.mark.parametrize("shape", [0, 1, 2, 9])
def test_height_is_the_highest_point_above(shape):
    rng = np.random.default_rng(shape)
    table = shape_table()
    planes = table.planes[shape, : table.count[shape]]
    row = rock(rng, shape)
    inside = 0
    for x, y in row[:2] + rng.uniform(-2.2, 2.2, (200, 2)):
        wanted = plain.top(x, y, row, planes)
        assert kernels.rock_height(x, y, row[None], 0, table.planes, table.count) == pytest.approx(
            wanted, abs=1e-9
        )
        inside += np.isfinite(wanted)
    assert 20 < inside < 180


def test_a_ray_that_starts_on_a_rock_has_left_it():
    table = shape_table()
    row = np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0]])
    distance, normal = np.empty(2), np.empty((2, 3))
    origin = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    direction = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, -1.0]])
    kernels.cast_on_plane(origin, direction, row, table.planes, table.count, distance, normal)
    assert distance[0] == np.inf  # up and away
    assert distance[1] == pytest.approx(0.0, abs=1e-12)  # down into it
