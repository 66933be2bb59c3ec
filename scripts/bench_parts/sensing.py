"""Measure the speed of terrain generation, images and rays."""

from __future__ import annotations

import importlib.util
import time
from dataclasses import replace

import numba

from bench_parts.common import alternating_medians, make_terrain, median_ms
from bench_parts.plain_renderer import PlainRenderer


def terrain() -> None:
    """Time the generation of 1 km^2 with 50,000 rocks, and rock placement by cover."""
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.rocks.field import RockModel
    from lunarsim.rocks.size_distribution import sample_diameters
    from lunarsim.world.terrain import Heightfield, place_rocks

    make_terrain(4.0, 1000, 1.0, 64.0)
    began = time.perf_counter()
    built = make_terrain(4.0, 50_000, 0.5, 1000.0)
    print(
        f"  1 km^2 at 0.5 m with {len(built.rocks)} rocks: {time.perf_counter() - began:.2f} s, "
        f"{built.nbytes / 1e6:.0f} MB"
    )
    flat = Heightfield(Grid.centred((0.0, 0.0), 500.0, 2.0), np.zeros((250, 250), np.float32))
    for cover in (0.01, 0.05, 0.2):
        rng = np.random.default_rng(1)
        diameters = sample_diameters(250_000.0, cover, 0.3, 3.0, rng)
        ms = median_ms(
            lambda d=diameters, r=rng: place_rocks(flat, d, r, model=RockModel("mixed")), 3
        )
        print(
            f"  {diameters.size:7d} rocks placed at {100 * cover:.0f} % cover: {ms:6.1f} ms, "
            f"{1e6 * ms / diameters.size:.0f} ns per rock"
        )


def render() -> None:
    """Time images of 640 x 480 pixels with shadows and read-back, Sun at 20 degrees."""
    import numpy as np

    from lunarsim.frames import sensor_axes
    from lunarsim.models.pinhole import View
    from lunarsim.sensors.rendering import renderer_of
    from lunarsim.sensors.rendering.context import gl_context, on_render_thread
    from lunarsim.world.light import Light

    device = on_render_thread(lambda: gl_context().info["GL_RENDERER"])
    print(f"  {device()}")
    light = Light(1.5708, np.radians(20.0))
    took = {}
    for count in (10_000, 50_000):
        terrain = make_terrain(4.0, count, 1.0, 512.0)
        began = time.perf_counter()
        renderer = renderer_of(terrain)
        made = time.perf_counter() - began
        for altitude in (100.0, 600.0):
            position = np.array([0.0, 0.0, float(terrain.elevation([0.0, 0.0])) + altitude])
            axes = sensor_axes([0.0, 0.0, -1.0])
            view = View(position, axes, 554.3, 554.3, 319.5, 239.5, 640, 480)
            ms = median_ms(lambda r=renderer, v=view: r.render(v, light), 15)
            took[count, altitude] = ms
            plain = PlainRenderer(terrain)
            peer = median_ms(lambda p=plain, v=view: p.render(v, light.direction), 7)
            truth = median_ms(lambda r=renderer, v=view: r.render(v, light, truth=True), 5)
            rays = view.rays().reshape(-1, 3)
            cast = median_ms(lambda t=terrain, p=position, d=rays: t.cast(p, d, normals=False), 5)
            print(
                f"  {len(terrain.rocks):6d} rocks, {altitude:3.0f} m: {1e3 / ms:5.1f} frames/s "
                f"({ms:.1f} ms); with range, normal and rock index {truth:.1f} ms; "
                f"one ray per pixel, without shadows: {cast / ms:.2f} frames; simple "
                f"renderer with instanced cubes: {peer / ms:.2f} frames"
            )
        print(f"    buffers created in {1e3 * made:.0f} ms")
    for altitude in (100.0, 600.0):
        ratio = took[50_000, altitude] / took[10_000, altitude]
        print(f"  five times the rocks at {altitude:.0f} m: {ratio:.2f} times the time")
    _lights()
    terrain = _small_square_of_cubes(10_000)
    position = np.array([0.0, 0.0, float(terrain.elevation([0.0, 0.0])) + 100.0])
    view = View(position, sensor_axes([0.0, 0.0, -1.0]), 554.3, 554.3, 319.5, 239.5, 640, 480)
    ours = median_ms(lambda: renderer_of(terrain).render(view, light), 15)
    plain = PlainRenderer(terrain)
    peer = median_ms(lambda: plain.render(view, light.direction), 9)
    print(
        f"  256 x 256 posts and {len(terrain.rocks)} cubes, 100 m: {ours:.1f} ms; simple "
        f"renderer {peer:.1f} ms, {peer / ours:.2f} times the time"
    )


def _lights() -> None:
    """Print the rendering time of each light effect relative to the plain light."""
    import numpy as np

    from lunarsim.frames import sensor_axes
    from lunarsim.models.pinhole import View
    from lunarsim.sensors.rendering import renderer_of
    from lunarsim.world.light import FULL_EARTH_IRRADIANCE_RATIO, SUN_DIAMETER_RAD, Light

    parts = {
        "Hapke": {"photometry": "hapke"},
        "the Sun's disc": {"diameter": SUN_DIAMETER_RAD},
        "scattered light": {"scattered_light": True},
        "mottles and boulders": {
            "albedo_variation": 0.05,
            "boulder_albedo": 1.3,
            "boulder_albedo_variation": 0.15,
        },
    }
    combined = {"earthshine": FULL_EARTH_IRRADIANCE_RATIO}
    for settings in parts.values():
        combined |= settings
    terrain = make_terrain(4.0, 10_000, 1.0, 512.0)
    renderer = renderer_of(terrain)
    axes = sensor_axes([0.0, 0.0, -1.0])
    print("  light effects, time relative to the plain light (point Sun, lunar-Lambert):")
    for elevation in (20.0, 5.0):
        for altitude in (100.0, 600.0):
            height = float(terrain.elevation([0.0, 0.0])) + altitude
            views = [
                View(np.array([0.0, 0.0, height]), axes, 554.3 * n, 554.3 * n, 320.0 * n - 0.5,
                     240.0 * n - 0.5, 640 * n, 480 * n) for n in (1, 2)
            ]  # fmt: skip
            plain = Light(1.5708, np.radians(elevation))
            drawn = {"plain": (views[0], plain)}
            for name, settings in (parts | {"all": combined}).items():
                drawn[name] = (views[0], replace(plain, **settings))
            drawn["all, four rays per pixel"] = (views[1], drawn["all"][1])
            took = alternating_medians({
                name: lambda v=view, one=one: renderer.render(v, one)
                for name, (view, one) in drawn.items()
            })  # fmt: skip
            rest = ", ".join(f"{name} {took[name] / took['plain']:.2f}" for name in list(took)[1:])
            print(f"    Sun {elevation:g} deg, {altitude:.0f} m: {took['plain']:.1f} ms; {rest}")


def _small_square_of_cubes(count: int):
    """Return a terrain of 256 m with `count` cube rocks of 0.2 to 0.5 m."""
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.rocks.field import RockModel
    from lunarsim.world.terrain import Terrain, fractal_relief, place_rocks

    rng = np.random.default_rng(0)
    grid = Grid.centred((0.0, 0.0), 256.0, 1.0)
    relief = fractal_relief(grid, rng, hurst=0.8, rms_slope=np.radians(4.0))
    diameters = rng.uniform(0.2, 0.5, count)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("cube")))


def lidar() -> None:
    """Time 65,536 LiDAR rays from 500 m; compare with Embree, one thread each.

    Embree is a ray tracer.
    """
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief, place_rocks

    if importlib.util.find_spec("embreex") is None:
        raise SystemExit(
            'error: embreex is missing. Install it in the clone: pip install ".[bench]"'
        )
    rng = np.random.default_rng(0)
    side, posting = 2001, 0.1
    grid = Grid(-100.0, -100.0, posting, side, side)
    flat = Heightfield(grid, np.zeros(grid.shape, np.float32))
    rough = fractal_relief(grid, rng, hurst=0.8, rms_slope=np.radians(8.0))
    rough = rough.scaled(22.0 / float(np.ptp(rough.z)))
    for name, relief, tilt in (
        ("flat, 500 rocks, nadir", flat, 0.0),
        ("22 m relief, 60 deg", rough, 60.0),
    ):
        diameters = rng.uniform(0.3, 1.5, 500)
        began = time.perf_counter()
        terrain = Terrain(relief, place_rocks(relief, diameters, rng))
        build_time = time.perf_counter() - began
        print(f"  {name}:")
        _compare_with_embree(terrain, grid, np.radians(tilt), build_time)


def _compare_with_embree(terrain, grid, tilt: float, build_time: float) -> None:
    """Print ray times of lunarsim and Embree on the same terrain.

    `tilt` is the angle of the LiDAR from nadir, rad; `build_time` is the generation time of the
    terrain, s.
    """
    import numpy as np

    from lunarsim.frames import sensor_axes
    from lunarsim.sensors.lidar import FlashLidar
    from lunarsim.world.terrain import Heightfield, Terrain

    boresight = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    rays = np.ascontiguousarray(FlashLidar().directions() @ sensor_axes(boresight).T)
    origin = -500.0 * boresight
    began = time.perf_counter()
    surface = terrain.raster(grid)
    vertices, triangles = _triangles_of(grid, surface)
    embree = _EmbreeScene(vertices, triangles)
    starts = np.broadcast_to(origin, rays.shape).astype(np.float32).copy()
    directions = rays.astype(np.float32)
    embree_ranges = embree.ranges(starts, directions)
    embree_build_time = time.perf_counter() - began
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    one = median_ms(lambda: terrain.cast(origin, rays, normals=False))
    numba.set_num_threads(min(2, threads))
    two = median_ms(lambda: terrain.cast(origin, rays, normals=False))
    numba.set_num_threads(threads)
    peer = median_ms(lambda: embree.ranges(starts, directions), repeats=5)
    # The same triangles as in Embree.
    ours = Terrain(Heightfield(grid, surface)).cast(origin, rays, normals=False).range
    print(
        f"    {one:.1f} ms, Embree {peer:.1f} ms: {peer / one:.2f} times its rays per "
        f"second; on two threads {two:.1f} ms"
    )
    print(
        f"    built in {build_time:.2f} s, Embree {embree_build_time:.2f} s; memory "
        f"{terrain.nbytes / 1e6:.0f} MB, Embree {(vertices.nbytes + triangles.nbytes) / 1e6:.0f} "
        "MB (triangles only)"
    )
    _print_range_difference(ours, embree_ranges)


def _print_range_difference(ours, embree_ranges) -> None:
    """Print the difference of two sets of ranges (n,), m, over the same triangles."""
    import numpy as np

    seen = np.isfinite(ours) & (embree_ranges < 1e6)
    gap = np.abs(ours[seen] - embree_ranges[seen])
    alone = np.mean(np.isfinite(ours) != (embree_ranges < 1e6))
    print(
        f"    same triangles: median difference {1e3 * np.median(gap):.3f} mm, maximum "
        f"{1e3 * gap.max():.2f} mm, hit by only one {alone:.1e}"
    )


def _triangles_of(grid, surface):
    """Return vertices (n, 3) and triangles (m, 3) of an elevation raster `surface`."""
    import numpy as np

    rows, cols = grid.shape
    xx, yy = np.meshgrid(grid.x, grid.y)
    vertices = np.stack((xx, yy, surface), axis=-1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    around = (first, first + 1, first + cols + 1, first, first + cols + 1, first + cols)
    return vertices, np.stack(around, 1).reshape(-1, 3).astype(np.int32)


class _EmbreeScene:
    """Scene of triangles for ray casting by the library Embree."""

    def __init__(self, vertices, triangles):
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene = rtcore_scene.EmbreeScene()
        self._mesh = TriangleMesh(self._scene, vertices, triangles)

    def ranges(self, starts, directions):
        """Return the distances (n,) along rays from `starts` (n, 3) to the triangles, m."""
        import numpy as np

        return np.asarray(self._scene.run(starts, directions, query="DISTANCE"))
