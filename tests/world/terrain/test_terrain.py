from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.grid import Grid
from lunarsim.rocks.field import RockField
from lunarsim.rocks.shapes import CUBE, shape_table
from lunarsim.world.terrain import Heightfield, Terrain
from tests.reference import terrain as reference
from tests.worlds import flat_terrain, random_terrain, sloped_terrain

SHAPES = shape_table().vertices


@given(st.integers(0, 10_000))
def test_elevation_agrees_with_the_plain_reference(seed):
    rng = np.random.default_rng(seed)
    terrain = random_terrain(rng)
    xy = rng.uniform(-16.0, 16.0, (50, 2))
    ours = terrain.elevation(xy)
    assert np.allclose(ours, reference.elevations(terrain, xy, SHAPES), atol=1e-9, equal_nan=True)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.integers(0, 1000))
def test_planes_are_interpolated_exactly(gx, gy, seed):
    terrain = sloped_terrain((gx, gy))
    xy = np.random.default_rng(seed).uniform(-19.0, 19.0, (30, 2))
    assert np.allclose(terrain.elevation(xy), xy @ [gx, gy], atol=1e-5)
    n = np.array([-gx, -gy, 1.0]) / np.sqrt(1.0 + gx**2 + gy**2)
    assert np.allclose(terrain.normal(xy), n, atol=1e-4)


def test_posts_keep_their_elevation():
    terrain = random_terrain(np.random.default_rng(3), rocks=0)
    g = terrain.relief.grid
    assert np.allclose(terrain.elevation(g.centres()), terrain.relief.z, atol=1e-6)


def test_raster_is_elevation_at_cell_centres():
    terrain = random_terrain(np.random.default_rng(5))
    grid = Grid.centred((1.0, -2.0), 12.0, 0.17)
    assert np.allclose(terrain.raster(grid), terrain.elevation(grid.centres()), atol=1e-5)


def test_no_data_stays_no_data():
    grid = Grid.centred((0.0, 0.0), 10.0, 0.5)
    z = np.zeros(grid.shape, np.float32)
    z[10, 10] = np.nan
    terrain = Terrain(Heightfield(grid, z))
    hole = grid.centre_of(10, 10)
    assert np.isnan(terrain.elevation(hole + 0.1))
    assert np.isnan(terrain.elevation([100.0, 0.0]))
    assert np.isnan(terrain.elevation([np.nan, 0.0]))
    hits = terrain.cast([*hole, 10.0], [[0.0, 0.0, -1.0]])
    assert np.isnan(hits.range[0])
    assert hits.rock[0] == -2


@pytest.mark.parametrize("seed", range(6))
def test_rays_agree_with_marching(seed):
    rng = np.random.default_rng(seed)
    terrain = random_terrain(rng, relief=0.4)
    origin = np.array([*rng.uniform(-20.0, 20.0, 2), rng.uniform(6.0, 25.0)])
    targets = np.column_stack((rng.uniform(-13.0, 13.0, (40, 2)), np.zeros(40)))
    direction = targets - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    hits = terrain.cast(origin, direction)
    plain = reference.march(terrain, np.broadcast_to(origin, direction.shape), direction, SHAPES)
    # Marching steps over rims thinner than its step; those rays may differ, few are.
    assert np.array_equal(np.isnan(hits.range), np.isnan(plain))
    off = np.abs(hits.range - plain)
    assert np.nanmedian(off) < 1e-9
    assert np.mean(off[np.isfinite(off)] < 1e-6) >= 0.9


def test_hit_points_lie_on_the_surface():
    rng = np.random.default_rng(11)
    terrain = random_terrain(rng, relief=0.2)
    direction = rng.normal(size=(4000, 3))
    direction[:, 2] = -np.abs(direction[:, 2]) - 0.3
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.array([0.0, 0.0, 12.0])
    hits = terrain.cast(origin, direction)
    points = origin + hits.range[:, None] * direction
    found = np.isfinite(hits.range)
    gap = np.abs(terrain.elevation(points[found, :2]) - points[found, 2])
    # On vertical walls the elevation jumps; elsewhere it must agree.
    assert np.percentile(gap, 90) < 1e-9
    assert np.all(np.einsum("ij,ij->i", hits.normal[found], direction[found]) < 1e-6)


def test_hemisphere_closed_form():
    flat = flat_terrain().relief
    terrain = Terrain(flat, RockField.hemispheres(0.0, 0.0, 0.0, 2.0))
    hits = terrain.cast([0.0, 0.0, 10.0], [[0.0, 0.0, -1.0]])
    assert hits.range[0] == pytest.approx(8.0, abs=1e-12)
    d = np.array([1.0, 0.0, -1.0]) / np.sqrt(2.0)
    hits = terrain.cast([-10.0, 0.0, 10.0], [d])
    assert hits.range[0] == pytest.approx(np.sqrt(200.0) - 2.0, abs=1e-9)
    assert np.allclose(hits.normal[0], -d, atol=1e-9)
    assert hits.rock[0] == 0


def test_cube_closed_form():
    flat = flat_terrain().relief
    one = np.ones(1)
    cube = RockField(0 * one, 0 * one, 0 * one, one, one, 2 * one, 0 * one, np.array([CUBE]))
    terrain = Terrain(flat, cube)
    assert terrain.elevation([[0.99, -0.99], [1.01, 0.0]]) == pytest.approx([2.0, 0.0])
    hits = terrain.cast([-10.0, 0.0, 1.0], [[1.0, 0.0, 0.0]])
    assert hits.range[0] == pytest.approx(9.0, abs=1e-12)
    assert np.allclose(hits.normal[0], [-1.0, 0.0, 0.0])
    hits = terrain.cast([0.5, 0.5, 10.0], [[0.0, 0.0, -1.0]])
    assert hits.range[0] == pytest.approx(8.0, abs=1e-12)
    assert np.allclose(hits.normal[0], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("tilt", [0.0, 0.6, 1.2, 1.5])
def test_no_ray_passes_below_the_surface_before_its_hit(tilt):
    """The pyramid and the lists of rocks leave nothing out, at any slant."""
    rng = np.random.default_rng(int(10 * tilt))
    terrain = random_terrain(rng, rocks=400, relief=0.3)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, 2000)
    off = tilt + rng.uniform(0.0, 0.05, 2000)
    direction = np.column_stack(
        (np.sin(off) * np.cos(azimuth), np.sin(off) * np.sin(azimuth), -np.cos(off))
    )
    target = np.column_stack((rng.uniform(-14.0, 14.0, (2000, 2)), np.zeros(2000)))
    origin = target - 20.0 * direction
    hits = terrain.cast(origin, direction)
    along = np.arange(0.0, 40.0, 0.01)
    for k in range(0, 2000, 20):
        points = origin[k] + along[:, None] * direction[k]
        above = points[:, 2] - terrain.elevation(points[:, :2])
        first = np.isfinite(above).argmax()
        if above[first] < 0.0:
            continue
        sunk = np.flatnonzero(above <= -0.01)
        if np.isfinite(hits.range[k]):
            assert sunk.size == 0 or along[sunk[0]] >= hits.range[k] - 0.011
        else:
            assert sunk.size == 0


def test_range_limit():
    terrain = flat_terrain()
    down = [[0.0, 0.0, -1.0]]
    assert np.isnan(terrain.cast([0.0, 0.0, 10.0], down, max_range=9.0).range[0])
    assert terrain.cast([0.0, 0.0, 10.0], down, max_range=11.0).range[0] == pytest.approx(10.0)


def test_rays_that_look_up_or_start_below_find_nothing():
    terrain = flat_terrain()
    hits = terrain.cast([0.0, 0.0, 5.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert np.isnan(hits.range).all()
    below = terrain.cast([0.0, 0.0, -5.0], [[0.6, 0.0, -0.8]])
    assert np.isnan(below.range).all()
