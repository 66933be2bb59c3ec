"""Speed, as ratios to a reference in the same run.

    python scripts/bench.py              # everything
    python scripts/bench.py flight       # one part

Every part warms its kernels first and prints medians. Only ratios within one run mean anything
across machines.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import click
import numba

ROOT = Path(__file__).parent.parent
PARTS: dict[str, Callable[[], None]] = {}


def part(function: Callable[[], None]) -> Callable[[], None]:
    PARTS[function.__name__] = function
    return function


def median_ms(call: Callable[[], object], repeats: int = 9) -> float:
    """Return the median time of `call`, ms, after one call to warm up."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * statistics.median(times)


@part
def flight() -> None:
    """One closed-loop flight on one thread, against real time."""
    from lunarsim.rng import flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation

    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    for name in ("hirise", "golombek"):
        scenario = Scenario.load(ROOT / "scenarios" / f"{name}.toml")
        Simulation(scenario, flight_seed(1, 0), "safest").run()
        for index in range(1, 4):
            began = time.perf_counter()
            record = Simulation(scenario, flight_seed(1, index), "safest").run()
            took = time.perf_counter() - began
            scans = sum(event["name"] == "scan" for event in record.events)
            print(
                f"  {name:9s} flight {index}: {record.duration:5.1f} s flown in {took:5.2f} s, "
                f"{record.duration / took:5.1f} times real time ({scans} scans, map at "
                f"{scenario.mapper.posting_m} m, world built too)"
            )
    numba.set_num_threads(threads)


@part
def gaussian_dem() -> None:
    """65,536 returns from 500 m straight above to a safety map, against Qhull and ALHAT."""
    import numpy as np
    from scipy.spatial import Delaunay

    from lunarsim.frames import sensor_axes
    from lunarsim.grid import Grid
    from lunarsim.hazards.gaussian_dem import gaussian_dem as build
    from lunarsim.hazards.safety import (
        alhat_safety,
        bounded_safety,
        conservative_safety,
        exact_safety,
        safe_sites,
        stochastic_safety,
    )
    from lunarsim.sensors import FlashLidar
    from lunarsim.terrain import Heightfield, Terrain, fractal_relief, place_rocks
    from lunarsim.triangulation import delaunay, delaunay_of_image
    from lunarsim.vehicle import Lander, State
    from lunarsim.world import World

    lander = Lander()
    plane = Heightfield(Grid.centred((0.0, 0.0), 202.0, 2.0), np.zeros((101, 101), np.float32))
    rocks = place_rocks(plane, np.full(500, 1.0), np.random.default_rng(0))
    world = World(Terrain(plane, rocks), 1.622)
    here = np.array([0.0, 0.0, 500.0])
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = State(here, np.zeros(3), upright, np.zeros(3), 1.0)
    lidar = FlashLidar()
    scan = lidar.measure(world, state, 0.0, np.random.default_rng(1), sensor_axes([0.0, 0.0, -1.0]))
    points = scan.points(here, upright)
    sigma = lidar.noise_ratio * 500.0

    qhull = median_ms(lambda: Delaunay(points[:, :2]), 5)
    print(f"  Delaunay: Qhull {qhull:.1f} ms; as ratios to it:")
    for name, call in (
        ("detector image", lambda: delaunay_of_image(points[:, :2], scan.shape)),
        ("any points", lambda: delaunay(points[:, :2])),
    ):
        print(f"    {name:15s} {median_ms(call) / qhull:.3f}")
    print("  points to safety map, ratio to Qhull's triangulation alone; baseline / conservative:")
    for posting in (0.5, 0.3, 0.2, 0.1):
        grid = Grid.centred((0.0, 0.0), 100.0, posting)
        dem = build(points, grid, sigma_eps=sigma, image_shape=scan.shape)
        first = median_ms(lambda g=grid: build(points, g, sigma_eps=sigma, image_shape=scan.shape))
        second = median_ms(lambda g=grid, d=dem: stochastic_safety(d.mean, d.variance, g, lander))
        cheap = median_ms(lambda g=grid, d=dem: conservative_safety(d.mean, g, lander))
        base = median_ms(
            lambda g=grid, d=dem: alhat_safety(d.mean, g, lander, sigma=sigma), repeats=3
        )
        print(
            f"    {posting} m: DEM {first:6.1f} + safety {second:6.1f} ms = "
            f"{(first + second) / qhull:.3f}; ALHAT-style {base:8.1f} / conservative "
            f"{cheap:6.1f} ms = {base / cheap:6.1f}"
        )
    grid = Grid.centred((0.0, 0.0), 100.0, 0.1)
    relief = fractal_relief(grid, np.random.default_rng(1), hurst=0.85, rms_slope=np.deg2rad(8.0)).z
    field = world.terrain.raster(grid)
    print("  1000 x 1000 cells at 0.1 m: exact map, decision alone, bounded test (ms)")
    for name, z in (("rock field", field), ("relief", relief)):
        times = [
            median_ms(lambda c=call, z=z: c(z, grid, lander), 3)
            for call in (exact_safety, safe_sites, bounded_safety)
        ]
        print(f"    {name:10s} " + " ".join(f"{t:9.1f}" for t in times))


def _square(slope_deg: float, count: int, posting: float, side: float, seed: int = 0):
    """Return a square of fractal relief with `count` rocks by the Golombek law."""
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.terrain import (
        RockModel,
        Terrain,
        fractal_relief,
        golombek_number,
        place_rocks,
        sample_diameters,
    )

    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), side, posting)
    relief = fractal_relief(grid, rng, hurst=0.8, rms_slope=np.radians(slope_deg))
    # The least diameter at which a cover of 5 % gives this many rocks.
    sizes = np.geomspace(0.05, 2.0, 400)
    least = float(np.interp(-count / side**2, -golombek_number(sizes, 0.05), sizes))
    diameters = sample_diameters(side**2, 0.05, least, 3.0, rng)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("mixed")))


@part
def render() -> None:
    """640 x 480 pictures, shadow pass and read-back included, Sun at 20 degrees."""
    import numpy as np

    from lunarsim.frames import sensor_axes
    from lunarsim.light import Light
    from lunarsim.sensors.rendering import View, renderer_of
    from lunarsim.sensors.rendering.context import gl_context

    print(f"  {gl_context().info['GL_RENDERER']}")
    light = Light(1.5708, np.radians(20.0))
    took = {}
    for count in (10_000, 50_000):
        terrain = _square(4.0, count, 1.0, 512.0)
        began = time.perf_counter()
        renderer = renderer_of(terrain)
        made = time.perf_counter() - began
        for altitude in (100.0, 600.0):
            position = np.array([0.0, 0.0, float(terrain.elevation([0.0, 0.0])) + altitude])
            axes = sensor_axes([0.0, 0.0, -1.0])
            view = View(position, axes, 554.3, 554.3, 319.5, 239.5, 640, 480)
            ms = median_ms(lambda r=renderer, v=view: r.render(v, light), 15)
            took[count, altitude] = ms
            truth = median_ms(lambda r=renderer, v=view: r.render(v, light, truth=True), 5)
            rays = view.rays().reshape(-1, 3)
            cast = median_ms(lambda t=terrain, p=position, d=rays: t.cast(p, d, normals=False), 5)
            print(
                f"  {len(terrain.rocks):6d} rocks, {altitude:3.0f} m: {1e3 / ms:5.1f} frames/s "
                f"({ms:.1f} ms); with range, normal and identity {truth:.1f} ms; "
                f"casting a ray a pixel, without shadows: {cast / ms:.2f} of a frame"
            )
        print(f"    buffers made in {1e3 * made:.0f} ms")
    for altitude in (100.0, 600.0):
        ratio = took[50_000, altitude] / took[10_000, altitude]
        print(f"  five times the rocks at {altitude:.0f} m: {ratio:.2f} times as long")


@part
def lidar() -> None:
    """65,536 rays from 500 m against Embree on the same triangles, one thread each."""
    import numpy as np

    from lunarsim.frames import sensor_axes
    from lunarsim.grid import Grid
    from lunarsim.sensors import FlashLidar
    from lunarsim.terrain import Heightfield, Terrain, fractal_relief, place_rocks

    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError:
        raise SystemExit(
            'error: this part compares with Embree: pip install "lunarsim[bench]"'
        ) from None
    rng = np.random.default_rng(0)
    side, posting = 2001, 0.1
    grid = Grid(-100.0, -100.0, posting, side, side)
    flat = Heightfield(grid, np.zeros(grid.shape, np.float32))
    rough = fractal_relief(grid, rng, hurst=0.8, rms_slope=np.radians(8.0))
    rough = rough.scaled(22.0 / float(np.ptp(rough.z)))
    threads = numba.get_num_threads()
    for name, relief, tilt in (
        ("flat, 500 rocks, nadir", flat, 0.0),
        ("22 m relief, 60 deg", rough, 60.0),
    ):
        diameters = rng.uniform(0.3, 1.5, 500)
        began = time.perf_counter()
        terrain = Terrain(relief, place_rocks(relief, diameters, rng))
        ours_built = time.perf_counter() - began
        boresight = np.array([np.sin(np.radians(tilt)), 0.0, -np.cos(np.radians(tilt))])
        rays = np.ascontiguousarray(FlashLidar().directions() @ sensor_axes(boresight).T)
        origin = -500.0 * boresight
        began = time.perf_counter()
        surface = terrain.raster(grid)
        xx, yy = np.meshgrid(grid.x, grid.y)
        vertices = np.stack((xx, yy, surface), axis=-1).reshape(-1, 3).astype(np.float32)
        first = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
        around = (first, first + 1, first + side + 1, first, first + side + 1, first + side)
        scene = rtcore_scene.EmbreeScene()
        mesh = TriangleMesh(scene, vertices, np.stack(around, 1).reshape(-1, 3).astype(np.int32))
        starts = np.broadcast_to(origin, rays.shape).astype(np.float32).copy()
        directions = rays.astype(np.float32)
        theirs = np.asarray(scene.run(starts, directions, query="DISTANCE"))
        embree_built = time.perf_counter() - began
        numba.set_num_threads(1)
        one = median_ms(lambda t=terrain, o=origin, d=rays: t.cast(o, d, normals=False))
        numba.set_num_threads(min(2, threads))
        two = median_ms(lambda t=terrain, o=origin, d=rays: t.cast(o, d, normals=False))
        embree = median_ms(
            lambda s=scene, o=starts, d=directions: s.run(o, d, query="DISTANCE"), repeats=5
        )
        # The very triangles that Embree has.
        same = Terrain(Heightfield(grid, surface)).cast(origin, rays, normals=False).range
        seen = np.isfinite(same) & (theirs < 1e6)
        gap = np.abs(same[seen] - theirs[seen])
        print(
            f"  {name}: {one:.1f} ms against Embree's {embree:.1f} ms: {embree / one:.2f} times "
            f"its rays a second; on two threads {two:.1f} ms"
        )
        print(
            f"    built in {ours_built:.2f} s against {embree_built:.2f} s; memory "
            f"{terrain.nbytes / 1e6:.0f} MB against {_mesh_megabytes(vertices, first):.0f} MB of "
            "triangles alone"
        )
        alone = np.mean(np.isfinite(same) != (theirs < 1e6))
        print(
            f"    same triangles: median difference {1e3 * np.median(gap):.3f} mm, greatest "
            f"{1e3 * gap.max():.2f} mm, seen by one only {alone:.1e}"
        )
        del mesh, scene
    numba.set_num_threads(threads)


def _mesh_megabytes(vertices, cells) -> float:
    return (vertices.nbytes + cells.size * 2 * 3 * 4) / 1e6


class _Timed:
    """A function that counts its calls and their time."""

    def __init__(self, function):
        self.function = function
        self.seconds = 0.0
        self.calls = 0

    def __call__(self, *args, **more):
        began = time.perf_counter()
        result = self.function(*args, **more)
        self.seconds += time.perf_counter() - began
        self.calls += 1
        return result


def _rock_filter(count, seed=0):
    """Return a filter of `count` rocks seen from 80 m, its camera and the true places."""
    from dataclasses import replace

    import numpy as np

    from lunarsim.hazards.shadows import RockFilter
    from lunarsim.navigation.inertial import InertialState
    from lunarsim.sensors import Camera
    from lunarsim.sensors.gimbal import gimbal_mount

    rng = np.random.default_rng(seed)
    position = np.array([-20.0, 10.0, 80.0])
    level = np.array([0.0, 0.0, 0.0, 1.0])
    rocks = RockFilter(InertialState(position, np.zeros(3), level, 1.622), capacity=count)
    camera = replace(Camera(), mount=gimbal_mount(level, -position))
    xy = rng.uniform(-30.0, 30.0, (count, 2))
    noise = np.tile(0.25 * np.eye(2), (count, 1, 1))
    rocks.add(camera, xy, noise, np.full(count, 0.5), np.full(count, 0.01))
    return rocks, camera, xy


@part
def shadows() -> None:
    """Detection, filter, map and a whole flight of the shadow pipeline."""
    import numpy as np
    from filterpy.kalman import ExtendedKalmanFilter
    from threadpoolctl import threadpool_limits

    from lunarsim.frames import direction_from_angles
    from lunarsim.grid import Grid
    from lunarsim.hazards.shadows import ProbabilityMap, RockTracker, ShadowModel, detect_rocks
    from lunarsim.hazards.shadows.association import associate
    from lunarsim.light import Light
    from lunarsim.rng import flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.sensors import Camera
    from lunarsim.simulation import Simulation
    from lunarsim.vehicle import State
    from lunarsim.world import World

    elevation = np.radians(20.0)
    model = ShadowModel(elevation)
    rng = np.random.default_rng(0)

    for count in (300, 1200):
        terrain = _square(0.0, count, 2.0, 120.0)
        rocks, camera, _ = _rock_filter(1)
        state = State(
            np.array([-20.0, 10.0, 80.0]), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]),
            np.zeros(3), 1.0,
        )  # fmt: skip
        world = World(terrain, 1.622, Light(0.0, elevation))
        counts = camera.expose(world, state, 0.0, rng).counts
        sun = direction_from_angles(0.0, elevation)
        seen = detect_rocks(counts, camera, state, sun, model=model)
        ms = median_ms(
            lambda c=counts, e=camera, p=state, s=sun: detect_rocks(c, e, p, s, model=model), 15
        )
        print(f"  detection: {seen.labels.max()} shadows in view, {len(seen)} rocks: {ms:.1f} ms")

    def one_update(rocks, camera, xy, seen):
        """Associate and update as for one image in which the first `seen` rocks are found."""
        sight = rocks.sight(camera)
        noise = np.tile(0.25 * np.eye(2), (seen, 1, 1))
        pixel = sight.pixel[:seen] + 0.5 * rng.standard_normal((seen, 2))
        radius, variance = np.full(seen, 0.5), np.full(seen, 0.01)
        _, index, _, _ = associate(
            pixel, noise, radius, variance, sight.pixel, rocks.innovation_covariance(sight),
            rocks.radius, rocks.radius_variance,
        )  # fmt: skip
        index = np.unique(index)[:seen]
        n = len(index)
        rocks.update_rocks(index, sight, sight.pixel[index], noise[:n], radius[:n], variance[:n])

    for count in (100, 200, 500, 1000, 2000):
        rocks, camera, xy = _rock_filter(count)
        seen = min(150, count)
        ms = median_ms(lambda r=rocks, c=camera, x=xy, s=seen: one_update(r, c, x, s), 9)
        print(f"  filter: {count:4d} rocks tracked, {seen} seen: {ms:6.1f} ms an image")
    rocks, camera, xy = _rock_filter(500)
    seen = 150
    sight, noise = rocks.sight(camera), np.tile(0.25 * np.eye(2), (seen, 1, 1))
    index, flat = np.arange(seen), np.full(seen, 0.01)
    size = 15 + 2 * 500
    dense = ExtendedKalmanFilter(size, 2 * seen)
    dense.P = rocks.covariance.copy()
    h = np.zeros((2 * seen, size))
    for j in range(seen):
        h[2 * j : 2 * j + 2, [0, 1, 2, 9, 10, 11]] = sight.by_pose[j]
        h[2 * j : 2 * j + 2, 15 + 2 * j : 17 + 2 * j] = sight.by_rock[j]
    z, r = np.zeros(2 * seen), 0.25 * np.eye(2 * seen)
    with threadpool_limits(1, "blas"):
        ours = median_ms(
            lambda: rocks.update_rocks(index, sight, sight.pixel[:seen], noise, flat + 0.49, flat),
            9,
        )
        peer = median_ms(lambda: dense.update(z, lambda x: h, lambda x: h @ x, R=r), 3)
    print(
        f"    500 rocks, 150 seen, the update alone, one thread: {ours:.1f} ms; filterpy's dense "
        f"update of the same states {peer:.1f} ms, {peer / ours:.1f} times"
    )

    for count in (100, 500, 2000):
        rocks, _, _ = _rock_filter(count)
        tracker = RockTracker(rocks, model)
        tracker.existence = np.full(count, 0.99)
        mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 160.0, 0.25), model)
        ms = median_ms(lambda m=mapping, t=tracker: m.probability(t), 5)
        print(f"  map: 640 x 640 cells, {count:4d} rocks: {ms:6.1f} ms")

    for name in ("nominal", "modified"):
        scenario = Scenario.load(ROOT / "scenarios" / f"shadow_{name}.toml")
        simulation = Simulation(scenario, flight_seed(1, 0))
        began = time.perf_counter()
        mapped = 0.0
        expose = Camera.expose
        shutter = _Timed(expose)
        Camera.expose = lambda self, *a, s=shutter, **k: s(self, *a, **k)
        refreshed = 0.0
        while not simulation.done:
            simulation.step()
            if simulation.time >= refreshed + 1.0:
                refreshed = simulation.time
                start = time.perf_counter()
                simulation.eyes.mapper.hazard_map()
                mapped += time.perf_counter() - start
        took = time.perf_counter() - began
        Camera.expose = expose
        drawn, pictures = shutter.seconds, shutter.calls
        print(
            f"  flight, {name}: {simulation.time:.0f} s flown in {took:.1f} s, "
            f"{simulation.time / took:.2f} times real time ({pictures} pictures: {drawn:.1f} s to "
            f"draw and expose; maps {mapped:.1f} s; the rest detects, tracks and flies); without "
            f"drawing {simulation.time / (took - drawn):.2f} times"
        )


@part
def terrain() -> None:
    """Building: a square kilometre at 0.5 m with 50,000 rocks, and how placement grows."""
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.terrain import Heightfield, RockModel, place_rocks, sample_diameters

    _square(4.0, 1000, 1.0, 64.0)
    began = time.perf_counter()
    built = _square(4.0, 50_000, 0.5, 1000.0)
    print(
        f"  1 km^2 at 0.5 m with {len(built.rocks)} rocks: {time.perf_counter() - began:.2f} s, "
        f"{built.nbytes / 1e6:.0f} MB kept"
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
            f"{1e6 * ms / diameters.size:.0f} ns a rock"
        )


@part
def quadtree() -> None:
    """Points into the quadtree against SciPy's KD-tree and binned means; sites as the map grows."""
    import numpy as np
    from scipy.spatial import cKDTree
    from scipy.stats import binned_statistic_2d

    from lunarsim.hazards.quadtree import QuadtreeMap, SiteSelector

    rng = np.random.default_rng(0)

    def cloud(count: int, width: float, centre=(0.0, 0.0)):
        xy = rng.uniform(-0.5 * width, 0.5 * width, (count, 2)) + centre
        bump = np.hypot(xy[:, 0] % 9.0 - 4.0, xy[:, 1] % 11.0 - 5.0) < 0.5
        z = 0.1 * np.sin(xy[:, 0] / 7.0) + 0.005 * xy[:, 1] + 0.45 * bump
        return np.column_stack((xy, z + rng.normal(0.0, 0.02, count)))

    QuadtreeMap((0.0, 0.0), 100.0).insert(cloud(10_000, 99.0))
    print("  points at once, 100 x 100 m, least cells of 0.1 m")
    for count in (100_000, 1_000_000, 10_000_000):
        points = cloud(count, 99.0)
        quadtree = QuadtreeMap((0.0, 0.0), 100.0)
        began = time.perf_counter()
        quadtree.insert(points)
        ours = time.perf_counter() - began
        began = time.perf_counter()
        binned_statistic_2d(points[:, 0], points[:, 1], points[:, 2], "mean", bins=1000)
        binned = time.perf_counter() - began
        line = (
            f"    {count:10,d}: {ours:6.2f} s ({1e9 * ours / count:4.0f} ns a point, "
            f"{quadtree.nbytes / count:.0f} bytes a point), {ours / binned:.2f} of SciPy's binned "
            "mean at the least size alone"
        )
        if count <= 1_000_000:
            began = time.perf_counter()
            cKDTree(points[:, :2])
            line += f", {ours / (time.perf_counter() - began):.2f} of a KD-tree"
        print(line)
    print("  flashes of 128 x 128 points on 8 x 8 m, one after the other; then one update of sites")
    quadtree = QuadtreeMap((0.0, 0.0), 100.0)
    selector = SiteSelector(quadtree)
    shown = [10_000, 100_000, 1_000_000, 3_000_000, 10_000_000]
    inserted = 0.0
    while shown:
        flash = cloud(16_384, 8.0, rng.uniform(-45.0, 45.0, 2))
        began = time.perf_counter()
        quadtree.insert(flash)
        inserted += time.perf_counter() - began
        if quadtree.count < shown[0]:
            if rng.random() < 0.05:
                selector.update()
            continue
        selector.update()
        steps = []
        for _ in range(9):
            flash = cloud(16_384, 8.0, rng.uniform(-45.0, 45.0, 2))
            began = time.perf_counter()
            quadtree.insert(flash)
            middle = time.perf_counter()
            selector.update()
            steps.append((middle - began, time.perf_counter() - middle))
        insert, update = (1e3 * statistics.median(column) for column in zip(*steps, strict=True))
        fresh = median_ms(lambda q=quadtree: SiteSelector(q).update(), 3)
        box = median_ms(lambda q=quadtree: q.points_in(0.0, 2.0, 0.0, 2.0))
        band = median_ms(lambda q=quadtree: q.band(0.8, 1.6))
        print(
            f"    {quadtree.count:10,d} points: insert {insert:.1f} + update {update:.1f} ms; from "
            f"scratch {fresh:.1f} ms, {fresh / update:.0f} times as long; 4 m2 of points {box:.2f} "
            f"ms, band of {len(quadtree.band(0.8, 1.6))} cells {band:.2f} ms"
        )
        shown.pop(0)
    print(f"    all flashes together {inserted:.2f} s")
    print("  the same number of points to a square metre on larger maps, one flash more")
    for side in (100.0, 200.0, 400.0):
        quadtree = QuadtreeMap((0.0, 0.0), side)
        quadtree.insert(cloud(round(100 * side**2), side - 1.0))
        selector = SiteSelector(quadtree)
        selector.update()
        steps = []
        for _ in range(5):
            flash = cloud(16_384, 8.0, rng.uniform(-45.0, 45.0, 2))
            began = time.perf_counter()
            quadtree.insert(flash)
            selector.update()
            steps.append(time.perf_counter() - began)
        print(
            f"    {side:4.0f} m, {quadtree.count:10,d} points, {len(selector.mesh.nodes):5d} mesh "
            f"nodes: {1e3 * statistics.median(steps):.1f} ms"
        )


def _yardstick() -> float:
    """Return the time of a fixed piece of other people's work, ms, by which to compare machines."""
    import numpy as np
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(-50.0, 50.0, 256), np.linspace(-50.0, 50.0, 256))
    points = np.column_stack((u.ravel(), v.ravel())) + 0.05 * rng.standard_normal((65_536, 2))
    return median_ms(lambda: Delaunay(points), 3)


@click.command()
@click.argument("parts", nargs=-1)
def main(parts: tuple[str, ...]) -> None:
    """Run the named PARTS, or all of them."""
    unknown = [name for name in parts if name not in PARTS]
    if unknown:
        raise click.UsageError(f"no such part: {unknown[0]}; there are {', '.join(PARTS)}")
    print(
        f"{os.cpu_count()} cores, {numba.get_num_threads()} threads; yardstick: SciPy triangulates "
        f"the returns of one scan in {_yardstick():.0f} ms"
    )
    for name in parts or PARTS:
        print(f"{name}: {(PARTS[name].__doc__ or '').strip().splitlines()[0]}")
        PARTS[name]()


if __name__ == "__main__":
    main()
