"""Rendered pictures against ray casting and closed forms."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.frames import sensor_axes
from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.shapes import CUBE
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.rendering import Renderer, renderer_of
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief, place_rocks
from tests.worlds import flat_terrain


def look(distance, tilt=0.0, azimuth=0.0, *, target=(0.0, 0.0, 0.0), pixels=(320, 240), fov=40.0):
    w, h = pixels
    boresight = np.array(
        [np.sin(tilt) * np.sin(azimuth), np.sin(tilt) * np.cos(azimuth), -np.cos(tilt)]
    )
    f = 0.5 * w / np.tan(0.5 * np.radians(fov))
    position = np.asarray(target) - distance * boresight
    return View(position, sensor_axes(boresight), f, f, 0.5 * (w - 1), 0.5 * (h - 1), w, h)


@pytest.fixture(scope="module")
def rocky():
    rng = np.random.default_rng(5)
    relief = fractal_relief(
        Grid.centred((0.0, 0.0), 120.0, 0.5), rng, hurst=0.8, rms_slope=np.radians(8.0)
    )
    diameters = rng.uniform(0.3, 3.0, 1500)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("mixed")))


@pytest.mark.parametrize(
    ("distance", "tilt"), [(20.0, 0.0), (60.0, 0.8), (90.0, 1.3), (600.0, 0.3)]
)
def test_range_normal_and_identity_are_those_of_the_ray_caster(rocky, distance, tilt):
    view = look(distance, tilt, 0.7)
    image = renderer_of(rocky).render(view, Light(), truth=True)
    rays = view.rays().reshape(-1, 3)
    hits = rocky.cast(view.position, rays)
    seen = np.isfinite(hits.range)
    assert np.all((np.isfinite(image.range.ravel()) == seen) | _edge(hits, view))
    same = (image.identity.ravel() == hits.rock) & seen
    assert same.sum() > 0.998 * seen.sum()  # the rest is on silhouettes
    gap = np.abs(image.range.ravel()[same] - hits.range[same])
    inside = ndimage.minimum_filter(same.reshape(view.height, view.width), 3).ravel()[same]
    limit = 0.002 + 0.001 * hits.range[same]
    inside &= ~_edge(hits, view)[same]
    assert np.all(gap[inside] < limit[inside])
    turn = np.einsum("ij,ij->i", image.normal.reshape(-1, 3)[same], hits.normal[same])
    assert np.mean(turn > 0.9999) > 0.99
    # The same point, asked of the terrain itself; walls of rocks are upright, so relief only.
    ground = same & (hits.rock == -1)
    points = view.position + image.range.ravel()[ground, None] * rays[ground]
    assert np.percentile(np.abs(rocky.elevation(points[:, :2]) - points[:, 2]), 99.5) < 0.003


def _edge(hits, view):
    """Pixels on a silhouette: where the range jumps to a neighbour."""
    r = np.nan_to_num(hits.range, nan=1e6).reshape(view.height, view.width)
    jump = ndimage.maximum_filter(r, 3) - ndimage.minimum_filter(r, 3)
    return (jump > 0.05 * r).ravel()


def lit_by_rays(terrain, view, light):
    """Which pixels (height, width) show ground that a ray to the Sun leaves freely."""
    rays = view.rays().reshape(-1, 3)
    hits = terrain.cast(view.position, rays)
    seen = np.isfinite(hits.range)
    points = view.position + hits.range[:, None] * rays + 0.002 * hits.normal
    sun = np.broadcast_to(light.direction, points.shape)
    lit = np.zeros(seen.size, bool)
    free = np.isnan(terrain.cast(points[seen], sun[seen], normals=False).range)
    lit[seen] = free & (hits.normal[seen] @ light.direction > 0.0)
    return lit.reshape(view.height, view.width)


@pytest.mark.parametrize("elevation", [8.0, 20.0, 45.0])
def test_shadows_are_those_that_rays_to_the_sun_find(rocky, elevation):
    view = look(50.0, 0.5, 2.0)
    light = Light(1.0, np.radians(elevation))
    lit = lit_by_rays(rocky, view, light)
    wrong = (renderer_of(rocky).render(view, light).radiance > 0.0) != lit
    assert wrong.mean() < 0.012
    # What is wrong lies on the edge of a shadow: no acne, no detached shadow, no leak of light.
    edge = ndimage.maximum_filter(lit, 3) != ndimage.minimum_filter(lit, 3)
    assert np.mean(wrong[~edge]) < (1e-3 if elevation < 10.0 else 2e-4)


@pytest.mark.parametrize("elevation", [4.0, 8.0])
def test_light_does_not_leak_through_ridges(elevation):
    """Rough relief at several levels of detail, most of it in the shadow of ridges."""
    rng = np.random.default_rng(3)
    grid = Grid.centred((0.0, 0.0), 300.0, 0.5)
    terrain = Terrain(fractal_relief(grid, rng, hurst=0.9, rms_slope=np.radians(9.0)))
    view = look(300.0, 0.3, 2.0)
    light = Light(1.0, np.radians(elevation))
    lit = lit_by_rays(terrain, view, light)
    wrong = (renderer_of(terrain).render(view, light).radiance > 0.0) != lit
    dark = ~ndimage.maximum_filter(lit, 3)
    assert dark.mean() > 0.1
    assert wrong[dark].mean() < 0.015


@pytest.mark.parametrize("turn", [0.0, 1.5, np.pi])
@pytest.mark.parametrize("tilt", [0.9, 1.2, 1.4])
def test_shadows_reach_as_far_as_the_terrain_in_view(turn, tilt):
    """Where the upper rows look past the terrain, the ground below them still has its shadows."""
    rng = np.random.default_rng(2)
    plane = flat_terrain(200.0, 2.0).relief
    rocks = place_rocks(plane, rng.uniform(1.0, 3.0, 300), rng, model=RockModel("cube"))
    terrain = Terrain(plane, rocks)
    view = look(110.0, tilt, 0.5 * np.pi, fov=60.0)
    light = Light(0.5 * np.pi + turn, np.radians(20.0))
    lit = lit_by_rays(terrain, view, light)
    wrong = (renderer_of(terrain).render(view, light).radiance > 0.0) != lit
    edge = ndimage.maximum_filter(lit, 3) != ndimage.minimum_filter(lit, 3)
    assert np.mean(wrong[~edge]) < 1e-3


def _one(shape, height, size):
    one = size * np.ones(1)
    number = None if shape is None else np.array([shape])
    field = RockField(0 * one, 0 * one, 0 * one, one, one, height * one, 0 * one, number)
    return Terrain(flat_terrain(80.0, 2.0).relief, field)


# Tip of the shadow from the centre of a rock with unit semi-axes, from its height and cot(Sun).
_TIPS = {
    "cube": (CUBE, 2.0, lambda h, c: 1.0 + h * c),
    "hemisphere": (None, 1.0, lambda h, c: np.sqrt(1.0 + (h * c) ** 2)),
    "ellipsoid": (None, 0.6, lambda h, c: np.sqrt(1.0 + (h * c) ** 2)),
}


@pytest.mark.parametrize("name", list(_TIPS))
@pytest.mark.parametrize("elevation", [5.0, 10.0, 20.0, 45.0])
@pytest.mark.parametrize("tilt", [0.0, 0.785])
@pytest.mark.parametrize(("distance", "size"), [(600.0, 1.0), (100.0, 1.0), (10.0, 0.2)])
def test_length_of_a_shadow_is_the_analytic_one(name, elevation, distance, size, tilt):
    shape, height, tip = _TIPS[name]
    light = Light(1.5 * np.pi, np.radians(elevation))  # the Sun in the west: the shadow points east
    length = size * tip(height, 1.0 / np.tan(light.elevation))
    target = np.array([0.5 * length, 0.0, 0.0])
    fov = 2.0 * np.degrees(np.arctan(max(0.8 * length, 3.0 * size) / distance))
    view = look(distance, tilt, 0.0, target=target, pixels=(640, 480), fov=min(fov, 60.0))
    terrain = _one(shape, height, size)
    image = Renderer(terrain).render(view, light, truth=True)
    points = view.position + image.range[..., None] * view.rays()
    dark = (image.radiance == 0.0) & (image.identity == -1)
    beside = np.abs(points[..., 1]) < size * (0.35 if name == "cube" else 0.1)
    row = dark & beside
    assert row.any()
    end = np.nanmax(points[..., 0][row])
    pixel = np.linalg.norm(target - view.position) / view.fx
    assert end == pytest.approx(length, abs=max(pixel, 0.02 * length))


def test_lambert_and_lunar_lambert_on_a_plane():
    view = look(50.0, 0.6, 0.3)
    sun = Light(1.0, 0.7, 0.2, photometry="lambert")
    renderer = renderer_of(_PLANE)
    lambert = renderer.render(view, sun).radiance
    assert np.allclose(lambert, 0.2 * np.sin(0.7), rtol=1e-4)
    image = renderer.render(view, Light(1.0, 0.7, 0.2))
    rays = view.rays()
    mu0, mu = np.sin(0.7), -rays[..., 2]
    phase = np.degrees(np.arccos(-rays @ sun.direction))
    part = 1.0 - 0.019 * phase + 2.42e-4 * phase**2 - 1.46e-6 * phase**3
    expected = 0.2 * (2.0 * part * mu0 / (mu0 + mu) + (1.0 - part) * mu0)
    assert np.allclose(image.radiance, expected, rtol=2e-3)


_PLANE = flat_terrain(400.0, 4.0)


def test_sky_night_and_underground_are_defined():
    renderer = renderer_of(_PLANE)
    axes = sensor_axes([0.1, 0.0, 1.0])
    up = View(np.array([0.0, 0.0, 10.0]), axes, 50.0, 50.0, 15.5, 15.5, 32, 32)
    sky = renderer.render(up, Light(), truth=True)
    assert np.all(sky.radiance == 0.0)
    assert np.isnan(sky.range).all() and np.all(sky.identity == -2)
    night = renderer.render(look(20.0), Light(0.0, -0.1))
    assert np.all(night.radiance == 0.0)
    earthshine = renderer.render(look(20.0), Light(0.0, -0.1, 0.2, 1e-4))
    assert np.allclose(earthshine.radiance, 2e-5, rtol=1e-4)
    far_away = renderer.render(look(20.0, target=(5000.0, 0.0, 0.0)), Light())
    assert np.all(far_away.radiance == 0.0)
    with pytest.raises(InputError, match="above the terrain"):
        renderer.render(look(20.0, target=(0.0, 0.0, -30.0)), Light())


def test_no_data_is_left_out():
    grid = Grid.centred((0.0, 0.0), 40.0, 0.5)
    z = np.zeros(grid.shape, np.float32)
    z[30:50, 30:50] = np.nan
    terrain = Terrain(Heightfield(grid, z))
    view = look(30.0)
    image = Renderer(terrain).render(view, Light(0.3, 0.5), truth=True)
    hits = terrain.cast(view.position, view.rays().reshape(-1, 3))
    assert np.mean(np.isnan(image.range.ravel()) == np.isnan(hits.range)) > 0.999


def test_small_rocks_that_are_left_out_change_no_pixel(rocky):
    """A picture is the same, bit for bit, whether rocks between pixels are drawn or not."""
    view = look(300.0)
    image = renderer_of(rocky).render(view, Light(1.0, 0.6), truth=True)
    hits = rocky.cast(view.position, view.rays().reshape(-1, 3), normals=False)
    stones = hits.rock >= 0
    assert np.mean(image.identity.ravel()[stones] == hits.rock[stones]) > 0.97


def test_coarse_relief_moves_nothing_by_more_than_its_bound(rocky):
    view = look(500.0, 0.2)
    renderer = renderer_of(rocky)
    light = Light(1.0, 0.9)
    coarse = renderer.render(view, light).radiance
    fine = renderer.render(view, light, truth=True).radiance
    changed = np.abs(coarse - fine) > 0.02 * fine.max()
    assert changed.mean() < 0.01


@pytest.mark.parametrize(
    ("distance", "tilt", "share"),
    [(100.0, 0.2, 5e-5), (600.0, 0.2, 6e-4), (300.0, 1.2, 1.3e-3)],
    ids=["near", "far", "slant"],
)
@pytest.mark.parametrize("elevation", [10.0, 20.0, 45.0])
def test_coarse_relief_changes_few_pixels_by_more_than_noise(distance, tilt, share, elevation):
    # The scene and lens of the benchmark. What changes is a pixel on an edge here and there: the
    # finest relief moves as many when its place on the graphics device is rounded otherwise (on the
    # slant 1.2e-3 of the pixels on an NVIDIA H100).
    rng = np.random.default_rng(0)
    relief = fractal_relief(
        Grid.centred((0.0, 0.0), 512.0, 1.0), rng, hurst=0.8, rms_slope=np.radians(4.0)
    )
    diameters = rng.uniform(0.3, 2.0, 5000)
    terrain = Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("mixed")))
    camera = Camera()
    view = look(distance, tilt, pixels=(640, 480), fov=60.0)
    light = Light(np.pi / 2, np.radians(elevation))
    renderer = renderer_of(terrain)
    gain = camera.sensitivity * camera.exposure
    drawn = gain * renderer.render(view, light).radiance
    finest = gain * renderer.render(view, light, truth=True).radiance
    step = camera.full_well / 2**camera.bits
    noise = np.sqrt(finest + camera.read_noise**2 + step**2 / 12.0)
    assert (np.abs(drawn - finest) > noise).mean() <= share


def test_same_view_same_bits(rocky):
    view = look(40.0, 0.4)
    first = Renderer(rocky).render(view, Light(0.2, 0.3)).radiance
    second = Renderer(rocky).render(view, Light(0.2, 0.3)).radiance
    assert np.array_equal(first, second)


@pytest.mark.parametrize("truth", [False, True])
def test_what_was_drawn_before_leaves_no_trace(rocky, truth):
    # Other sizes of picture and shadow map, coarse relief and fine, small rocks and large.
    light = Light(0.2, 0.3)
    views = [look(d, 0.4, pixels=p) for d in (15.0, 60.0, 400.0) for p in ((160, 120), (320, 240))]
    fresh = [Renderer(rocky).render(view, light, truth=truth).radiance for view in views]
    used = Renderer(rocky)
    rng = np.random.default_rng(0)
    for k in rng.integers(len(views), size=30):
        assert np.array_equal(used.render(views[k], light, truth=truth).radiance, fresh[k])


_CYCLES = """
import gc, resource, sys
import numpy as np
from lunarsim.models.pinhole import View
from lunarsim.sensors.rendering import Renderer, renderer_of
from lunarsim.frames import sensor_axes
from lunarsim.world.light import Light
from tests.worlds import flat_terrain

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6

axes = sensor_axes([0.0, 0.0, -1.0])
view = View(np.array([0.0, 0.0, 30.0]), axes, 60.0, 60.0, 31.5, 23.5, 64, 48)
sizes = []
for cycle in range(int(sys.argv[1])):
    renderer_of(flat_terrain()).render(view, Light())
    if cycle % 50 == 49:
        gc.collect()
        sizes.append(resident())
print(sizes[len(sizes) // 4], sizes[-1])
"""


@pytest.mark.parametrize("cycles", [100, pytest.param(2000, marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_terrains_made_and_dropped(cycles):
    done = subprocess.run(
        [sys.executable, "-c", _CYCLES, str(cycles)], capture_output=True, text=True, check=True
    )
    early, late = map(float, done.stdout.split())
    assert late < early + 30.0


def test_any_thread_renders_the_image_of_the_main_thread(rocky):
    view, light = look(60.0), Light(0.5, 0.3)

    def draw(_=None):
        return renderer_of(rocky).render(view, light).radiance

    expected = draw()
    with ThreadPoolExecutor(1) as pool:  # first another thread, then the main thread again
        images = [pool.submit(draw).result(), draw()]
    with ThreadPoolExecutor(3) as pool:
        images += pool.map(draw, range(6))
    assert expected.std() > 0.0
    assert all(np.array_equal(image, expected) for image in images)


def test_a_terrain_first_drawn_in_a_thread_is_drawn_alike_later():
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(_picture, 3).result()
    assert np.array_equal(first, _picture(3))


_THREADS = """
import gc, os, threading
from tests.sensors.rendering.test_renderer import Light, flat_terrain, look, renderer_of

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6

def draw():
    renderer_of(flat_terrain()).render(look(30.0, pixels=(64, 48)), Light())

for count in range(200):
    thread = threading.Thread(target=draw)
    thread.start()
    thread.join()
    if count == 50:
        gc.collect()
        early = resident(), len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd"))
gc.collect()
print(*early, resident(), len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd")))
"""


def test_nothing_is_kept_of_short_lived_threads_that_render():
    done = subprocess.run(
        [sys.executable, "-c", _THREADS], capture_output=True, text=True, check=True
    )
    memory, threads, files, *late = map(float, done.stdout.split())
    assert late[0] < memory + 30.0
    assert late[1:] == [threads, files]


def test_without_opengl_there_is_one_clear_error():
    code = (
        "from tests.sensors.rendering.test_renderer import flat_terrain, renderer_of\n"
        "import moderngl\n"
        "def none(**kw): raise Exception('libEGL.so not loaded')\n"
        "moderngl.create_context = none\n"
        "try: renderer_of(flat_terrain())\n"
        "except Exception as e: print(type(e).__name__, e)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("RenderingError")
    assert "apt-get install libegl1" in done.stdout


def _picture(seed):
    rng = np.random.default_rng(seed)
    ground = flat_terrain(60.0).relief
    terrain = Terrain(ground, place_rocks(ground, rng.uniform(0.3, 2.0, 100), rng))
    return Renderer(terrain).render(look(40.0), Light(0.5, 0.3)).radiance


def test_processes_render_side_by_side_and_alike():
    here = [_picture(seed) for seed in (1, 2, 1, 2)]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        there = list(pool.map(_picture, (1, 2, 1, 2)))
    assert all(np.array_equal(a, b) for a, b in zip(here, there, strict=True))


@pytest.mark.parametrize("bits", ["128", "512"])
def test_vectors_that_end_the_process_are_refused(tmp_path, bits):
    """Processors without AVX have 128 bits too. Other drivers than llvmpipe ignore the variable."""
    env = os.environ | {"LP_NATIVE_VECTOR_WIDTH": bits, "LIBGL_ALWAYS_SOFTWARE": "1"}
    words = [
        "-m",
        "lunarsim",
        "render",
        "hirise",
        "--altitude",
        "60",
        "--out",
        str(tmp_path / "a.png"),
    ]
    done = subprocess.run(
        [sys.executable, *words], check=False, capture_output=True, text=True, env=env
    )
    assert done.returncode == 1
    assert "LP_NATIVE_VECTOR_WIDTH=256" in done.stderr
    assert "Traceback" not in done.stderr
