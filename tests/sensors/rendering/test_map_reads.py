"""Where in a shadow map a picture looks: all that its points read, and little else."""

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.models.pinhole import View
from lunarsim.rocks.field import RockField
from lunarsim.sensors.rendering.context import gl_context, on_render_thread
from lunarsim.sensors.rendering.programs import geometry_programs
from lunarsim.sensors.rendering.renderer import Renderer
from lunarsim.sensors.rendering.rock_renderer import RockRenderer
from lunarsim.sensors.rendering.rock_tiles import DrawnRocks
from lunarsim.sensors.rendering.shadow_frame import ShadowFrame
from lunarsim.sensors.rendering.shadow_map_reads import ShadowMapReads
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield, Terrain
from tests.worlds import random_terrain


def camera(rng, tilt):
    eye = np.array([*rng.uniform(-50.0, 50.0, 2), rng.uniform(20.0, 300.0)])
    angle = rng.uniform(0.0, 6.0)
    out = eye[2] * np.tan(tilt)
    aim = eye + [out * np.cos(angle), out * np.sin(angle), -eye[2]]
    focal = rng.uniform(400.0, 2000.0)
    return View(eye, sensor_axes(aim - eye), focal, focal, 200.0, 310.0, 640, 480)


def frame_about(rng, eye):
    angle = rng.uniform(0.0, 6.0)
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return ShadowFrame(
        lean=rng.uniform(-3.0, 3.0, 2), axes=axes, corner=rng.uniform(-400.0, 0.0, 2), texel=0.4,
        size=(1500, 1200), heights=(10.0, -10.0 - eye[2]), slack=0.0,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_all_that_a_view_shows_between_two_levels_is_read(seed):
    rng = np.random.default_rng(seed)
    view = camera(rng, rng.uniform(0.0, 0.9))
    frame = frame_about(rng, view.position)
    low, high = np.sort(rng.uniform(-8.0, 8.0, 2))
    reads = ShadowMapReads.of(view, frame, low, high)
    assert len(reads.normal) == 12
    pixel = rng.uniform([-0.5, -0.5], [639.5, 479.5], (500, 2))
    pixel[:4] = [[-0.5, -0.5], [639.5, -0.5], [639.5, 479.5], [-0.5, 479.5]]
    slant = (pixel - [view.cx, view.cy]) / [view.fx, view.fy]
    ray = np.column_stack((slant, np.ones(len(slant)))) @ view.axes.T
    level = rng.choice([low, high, 0.5 * (low + high)], len(ray))
    point = ray * ((level - view.position[2]) / ray[:, 2])[:, None]
    # To texels, step by step; a shader may read the neighbours.
    place = (point[:, :2] - point[:, 2:] * frame.lean) @ frame.axes.T
    texel = np.floor((place - frame.corner) / frame.texel)
    for shift in np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]):
        assert reads.may_shade((texel + shift + 0.5)[:, None]).all()


def test_what_lies_far_from_an_image_is_not_read():
    view = View(np.array([0.0, 0.0, 100.0]), sensor_axes([0.0, 0.0, -1.0]), 640.0, 640.0, 319.5,
                239.5, 640, 480)  # fmt: skip
    frame = ShadowFrame(
        lean=np.zeros(2), axes=np.eye(2), corner=np.array([-200.0, -200.0]), texel=0.25,
        size=(1600, 1600), heights=(10.0, -110.0), slack=0.0,
    )  # fmt: skip
    reads = ShadowMapReads.of(view, frame, 0.0, 0.0)
    # It shows 100 m by 75 m about the middle; the map's border may be read by what lies beyond.
    place = np.array([[[800.0, 800.0]], [[1030.0, 800.0]], [[800.0, 400.0]], [[2.0, 400.0]]])
    assert reads.may_shade(place).tolist() == [True, False, False, True]
    across = np.array([[[1100.0, 500.0], [500.0, 1100.0]], [[1100.0, 500.0], [1200.0, 1100.0]]])
    assert reads.may_shade(across).tolist() == [True, False]


@pytest.mark.parametrize("tilt", [1.5, 1.5707])
def test_nothing_is_known_of_a_view_that_shows_the_horizon(tilt):
    rng = np.random.default_rng(0)
    view = camera(rng, tilt)
    frame = frame_about(rng, view.position)
    reads = ShadowMapReads.of(view, frame, -1.0, 1.0)
    assert reads.normal.size == 0
    assert reads.may_shade(rng.uniform(100.0, 900.0, (50, 1, 2))).all()


def test_nothing_is_known_of_a_view_from_below_what_it_shows():
    rng = np.random.default_rng(0)
    view = camera(rng, 0.0)
    frame = frame_about(rng, view.position)
    assert ShadowMapReads.of(view, frame, 0.0, view.position[2] + 1.0).normal.size == 0


@on_render_thread
def test_elevations_of_what_is_seen_of_rocks():
    rng = np.random.default_rng(2)
    base = random_terrain(rng, rocks=40)
    context = gl_context()
    rocks = RockRenderer(context, geometry_programs(context, ()), base)
    view = camera(rng, 0.0)
    size = base.rocks.reach()
    inside = np.abs(np.stack((base.rocks.x, base.rocks.y))).max(axis=0) + 1.5 * size < 15.0
    within = np.flatnonzero(inside).astype(np.int32)[:20]
    assert within.size > 5
    low, high = rocks.elevation_bounds(DrawnRocks(np.zeros((len(within), 4), np.float32), within))
    assert high == (base.rocks.base + base.rocks.height)[within].max()
    ground = base.relief.z.min()
    assert min(ground, base.rocks.base[within].min()) - 0.011 <= low
    assert low <= base.rocks.base[within].min()
    # A side that no ground hides goes down for ever.
    over = np.append(within, np.flatnonzero(~inside)[:1]).astype(np.int32)
    assert rocks.elevation_bounds(DrawnRocks(np.zeros((len(over), 4), np.float32), over)) == (
        -np.inf, np.inf,
    )  # fmt: skip
    z = base.relief.z.copy()
    z[0, 0] = np.nan
    holed = Terrain(Heightfield(base.relief.grid, z), base.rocks)
    rocks = RockRenderer(context, geometry_programs(context, ("HOLES",)), holed)
    some = rocks.visible_rocks(replace(view, position=np.array([0.0, 0.0, 50.0])), 1.0)
    assert some.rock_indices.size
    assert rocks.elevation_bounds(some) == (-np.inf, np.inf)


def drawn(terrain, view, light):
    return Renderer(terrain).render(view, light).radiance


@pytest.mark.parametrize("seed", range(6))
def test_images_are_those_with_the_whole_map(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    base = random_terrain(rng, rocks=300, relief=0.4)
    terrain = base
    if seed == 5:  # one rock hangs over the edge of the ground
        rocks = base.rocks
        terrain = Terrain(base.relief, RockField(*(np.append(a, b) for a, b in zip(
            (rocks.x, rocks.y, rocks.base, rocks.a, rocks.b, rocks.height, rocks.yaw, rocks.shape),
            (15.0, 2.0, 1.0, 2.0, 2.0, 2.0, 0.0, 1), strict=True,
        ))))  # fmt: skip
    light = Light(azimuth=rng.uniform(0.0, 6.0), elevation=np.radians(rng.uniform(5.0, 40.0)))
    views = []
    for k in range(6):
        eye = np.array([*rng.uniform(-12.0, 12.0, 2), rng.uniform(12.0, 60.0)])
        axes = sensor_axes(np.array([*rng.uniform(-9.0, 9.0, 2), 0.0]) - eye)
        turn = rng.uniform(0.0, 6.0)
        c, s = np.cos(turn), np.sin(turn)
        axes = axes @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        sun = replace(light, diameter=0.01 * (k % 3))
        views.append((View(eye, axes, 600.0, 600.0, 79.5, 59.5, 160, 120), sun))
    found = [drawn(terrain, *view) for view in views]
    monkeypatch.setattr(ShadowMapReads, "of", lambda _, frame, *__: ShadowMapReads.anywhere(frame))
    for view, picture in zip(views, found, strict=True):
        assert np.array_equal(drawn(terrain, *view), picture)
