"""Images of far terrain: its outline, its brightness, and its shadow on the map."""

import math

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.grid import Grid
from lunarsim.models.gravity import RoundMoon
from lunarsim.models.pinhole import View
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.rendering import render_world, renderer_of
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.far_terrain import FarTerrain, FarTerrainSettings
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield, Terrain
from tests.reference.far_terrain import Cone

CONE = Cone(0.0, 5_000.0, 900.0, 2_500.0)
DEG = math.pi / 180.0


def _world(moon=None, **light):
    grid = Grid.centred((0.0, 0.0), 800.0, 2.0)
    terrain = Terrain(Heightfield(grid, np.zeros(grid.shape, np.float32)))
    g = Grid.centred((0.0, 0.0), 20_000.0, 10.0)
    around = Heightfield(g, CONE.z(*np.meshgrid(g.x, g.y)).astype(np.float32))
    settings = FarTerrainSettings(sizes=(20_000.0,), postings=(10.0,), rms_slopes=(0.0,))
    far = FarTerrain(terrain, moon, settings, lambda n: around)
    return World(terrain, 1.622, moon=moon, light=Light(**light), far_terrain=far)


def _view(position, direction, width=96, height=72, focal=60.0):
    axes = sensor_axes(np.array(direction) / np.linalg.norm(direction))
    middle = 0.5 * (width - 1), 0.5 * (height - 1)
    return View(np.array(position, float), axes, focal, focal, *middle, width, height)


def _hits(view):
    """Return the ranges (height, width) of all pixels on cone and plane."""
    rays = view.rays().reshape(-1, 3)
    return np.array([CONE.hit(view.position, r) for r in rays]).reshape(view.height, view.width)


@pytest.mark.parametrize(
    ("position", "direction"),
    [((0.0, -900.0, 400.0), (0.0, 1.0, -0.1)), ((50.0, 20.0, 300.0), (0.1, 1.0, -0.2))],
)
def test_far_terrain_fills_the_sky_where_rays_hit_it(position, direction):
    world = _world(azimuth=math.pi, elevation=30.0 * DEG)
    view = _view(position, direction)
    image, wanted = render_world(world, view, truth=True), _hits(view)
    # Pixels on the outline of the cone or on the horizon may differ.
    same = np.isfinite(wanted) == np.isfinite(image.range)
    assert (~same).sum() <= view.width
    assert (image.radiance[np.isnan(image.range)] == 0.0).all()
    near = np.isfinite(wanted) & np.isfinite(image.range) & (wanted < 8_000.0)
    assert image.range[near] == pytest.approx(wanted[near], rel=0.02)
    bare = renderer_of(world.terrain).render(view, world.light, truth=True)
    on_map = bare.identity == -1
    assert on_map.sum() > 50
    assert (~on_map & near).sum() > 500
    assert np.array_equal(image.radiance[on_map], bare.radiance[on_map])
    # Both parts of the plane have the brightness of the photometric model.
    points = view.position + wanted[..., None] * view.rays()
    on_plane = near & (points[..., 2] < 1.0) & (np.abs(points[..., :2]).max(-1) > 420.0)
    # Normals at the foot of the cone are rounded over the spacing of the posts.
    on_plane &= np.abs(np.hypot(points[..., 0], points[..., 1] - CONE.y) - CONE.base) > 30.0
    sun = world.light.direction
    to_camera = -view.rays()[on_plane]
    model = world.light.radiance_factor(sun[2], to_camera[:, 2], to_camera @ sun)
    assert image.radiance[on_plane] == pytest.approx(model, rel=1e-3)


def test_the_shadow_of_far_terrain_crosses_the_edge_of_the_map():
    light = {"azimuth": 0.0, "elevation": 9.7 * DEG, "diameter": 0.53 * DEG, "ambient": 0.05}
    world = _world(**light)
    view = _view((0.0, 0.0, 1_200.0), (0.0, 1e-6, -1.0), 81, 81, 60.0)
    image = render_world(world, view)
    shift = np.array([0.0, 0.0, 1e-6])
    bare = render_world(World(world.terrain, 1.622, light=world.light), view, truth=True)
    on_map = bare.identity == -1
    points = (view.position + (1_200.0 / -view.rays()[..., 2:]) * view.rays())[on_map] + shift
    some = np.random.default_rng(1).permutation(len(points))[:150]
    lit = np.array([CONE.visible(p, 0.0, 9.7 * DEG, 0.53 * DEG, rays=40) for p in points[some]])
    assert ((lit > 0.05) & (lit < 0.95)).sum() > 8
    assert 10 < (lit == 1.0).sum() < 140
    dark = 0.05 * world.light.albedo
    wanted = dark + lit * (bare.radiance[on_map][some] - dark)
    assert image.radiance[on_map][some] == pytest.approx(
        wanted, abs=0.1 * float(bare.radiance.max())
    )


def test_a_camera_sees_a_ridge_in_front_of_the_map():
    world = _world(azimuth=0.0, elevation=40.0 * DEG)
    view = _view((0.0, 9_000.0, 300.0), (0.0, -1.0, -0.02))
    image = render_world(world, view, truth=True)
    wanted = _hits(view)
    middle = (35, 47)
    assert image.range[middle] == pytest.approx(wanted[middle], rel=0.01)
    assert wanted[middle] < 3_000.0


def test_cameras_see_far_terrain_on_a_round_moon():
    moon = RoundMoon().gravity(1.622)
    up = np.array([0.0, 0.0, 0.0, 1.0])
    state = State(np.array([2_000.0, 0.0, 600.0]), np.zeros(3), up, np.zeros(3), 1e3, 0.0)
    camera = Camera.with_field_of_view(32, 32, 40.0, shot_noise=False, read_noise=0.0)
    rng = np.random.default_rng(1)
    for one in (None, moon):
        world = _world(one, azimuth=0.3, elevation=40.0 * DEG)
        assert (camera.measure(world, state, 0.0, rng).counts > 0).all()
        bare = World(world.terrain, 1.622, moon=one, light=world.light)
        assert (camera.measure(bare, state, 0.0, rng).counts == 0).all()
        exposed = camera.expose(world, state, 0.0, rng, truth=True)
        assert (exposed.truth.identity == -1).all()
