"""Surface, normals and rocks on top of a map that is longer than wide and off the origin."""

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.rocks.shapes import shape_table
from lunarsim.world.terrain import Terrain
from tests.reference import terrain as reference
from tests.worlds import long_terrain

SHAPES = shape_table().vertices


def ground(seed):
    rng = np.random.default_rng(seed)
    return rng, long_terrain(rng)


@pytest.mark.parametrize("seed", range(3))
def test_elevations_to_the_edges_of_the_map(seed):
    rng, terrain = ground(seed)
    xy = np.column_stack((rng.uniform(-3.2, 8.4, 400), rng.uniform(39.8, 68.2, 400)))
    xy[:60, 0] = rng.choice([-3.0, 8.2], 60)
    xy[60:120, 1] = rng.choice([40.0, 68.0], 60)
    wanted = reference.elevations(terrain, xy, SHAPES)
    assert np.allclose(terrain.elevation(xy), wanted, atol=1e-6, equal_nan=True)
    assert 5 < np.isnan(wanted).sum() < 150


@pytest.mark.parametrize("seed", range(3))
def test_normals_are_the_slope_of_the_surface(seed):
    rng, terrain = ground(seed)
    xy = np.column_stack((rng.uniform(-2.9, 8.1, 600), rng.uniform(40.1, 67.9, 600)))
    h = 1e-6
    steps = h * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    z = reference.elevations(terrain, xy, SHAPES)
    east, west, north, south = (reference.elevations(terrain, xy + s, SHAPES) for s in steps)
    # Differences to both sides agree unless an edge lies between.
    smooth = (np.abs(east + west - 2.0 * z) < 1e-9) & (np.abs(north + south - 2.0 * z) < 1e-9)
    slope = np.column_stack((west - east, south - north, np.full(len(xy), 2.0 * h)))
    wanted = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    assert smooth.sum() > 400
    found = terrain.normal(xy)
    assert np.allclose(found[smooth], wanted[smooth], atol=1e-3)
    assert np.array_equal(np.isnan(found).any(axis=1), np.isnan(z))


@pytest.mark.parametrize("seed", range(2))
def test_rock_on_top_of_each_cell(seed):
    _, terrain = ground(seed)
    grid = Grid(x0=-2.95, y0=40.3, posting=0.37, rows=80, cols=31)
    found = terrain.rock_raster(grid)
    points = grid.centres().reshape(-1, 2)
    relief = reference.elevations(Terrain(terrain.relief), points, SHAPES)
    rocks = terrain.rocks
    tops = np.array([reference.rock_top(rocks, k, *points.T, SHAPES) for k in range(len(rocks))])
    wanted = np.where(tops.max(axis=0) > relief, tops.argmax(axis=0), -1)  # not on no data
    assert np.mean(found.ravel() == wanted) > 0.999
    assert (wanted >= 0).sum() > 100
    assert np.array_equal(
        terrain.raster(grid), terrain.elevation(grid.centres()).astype("f4"), equal_nan=True
    )
