"""Measure the speed of rock detection, tracking and mapping from shadows."""

from __future__ import annotations

import time

from bench_parts.common import ROOT, TimedFunction, make_terrain, median_ms, reference_ms


def _rock_filter(count, seed=0):
    """Return a rock filter with `count` rocks, its camera and true positions (n, 2)."""
    from dataclasses import replace

    import numpy as np

    from lunarsim.models.gimbal import gimbal_mount
    from lunarsim.onboard.navigation.inertial import StrapdownState
    from lunarsim.onboard.navigation.rock_filter import RockFilter
    from lunarsim.sensors.camera import Camera

    rng = np.random.default_rng(seed)
    position = np.array([-20.0, 10.0, 80.0])
    level = np.array([0.0, 0.0, 0.0, 1.0])
    rocks = RockFilter.of(StrapdownState(position, np.zeros(3), level, 1.622), capacity=count)
    camera = replace(Camera(), mount=gimbal_mount(level, -position))
    xy = rng.uniform(-30.0, 30.0, (count, 2))
    noise = np.tile(0.25 * np.eye(2), (count, 1, 1))
    points = np.column_stack((xy, np.zeros(count)))
    rocks.add(camera, points, noise, np.full(count, 0.5), np.full(count, 0.01))
    return rocks, camera, xy


def shadows() -> None:
    """Time detection, filter and map of rocks from shadows, and complete flights."""
    import numpy as np

    from lunarsim.onboard.perception.shadow_model import ShadowModel

    elevation = np.radians(20.0)
    model = ShadowModel(elevation)
    rng = np.random.default_rng(0)
    _detection(model, elevation, rng)
    _images(rng)
    _update_only()
    _evidence(elevation)
    _maps(model)
    _flights()


def _detection(model, elevation: float, rng) -> None:
    """Print rock-detection times by number of rocks; `elevation` is the Sun's, rad."""
    import numpy as np

    from lunarsim.frames import direction_from_angles
    from lunarsim.onboard.perception.detector import detect_rocks
    from lunarsim.vehicle import State
    from lunarsim.world import World
    from lunarsim.world.light import Light

    for count in (300, 700, 1200):
        terrain = make_terrain(0.0, count, 2.0, 120.0)
        _, camera, _ = _rock_filter(1)
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
        peer = median_ms(lambda c=counts: _plain_detection(c), 5)
        print(
            f"  detection: {seen.labels.max()} visible shadows, {len(seen)} rocks: {ms:.1f} ms; "
            f"filters, labels and moments by SciPy {peer:.1f} ms, "
            f"{peer / ms:.1f} times"
        )
        args = (counts, camera, state, sun, seen, model)
        ms = median_ms(lambda a=args: _check_image(*a))
        print(f"    image check: {ms:.1f} ms")


def _plain_detection(counts):
    """Detect shadows by threshold, labels and moments with SciPy, as a reference.

    `counts` (rows, cols) is the image. Returns first and second moments of each shadow.
    """
    import numpy as np
    from scipy import ndimage

    grey = counts.astype(float)
    dark = grey < 0.5 * ndimage.uniform_filter(grey, 77)
    labels, count = ndimage.label(dark, np.ones((3, 3)))
    index = np.arange(1, count + 1)
    rows, cols = np.indices(grey.shape)
    return [
        ndimage.mean(v, labels, index) for v in (rows, cols, rows**2, cols**2, rows * cols)
    ]  # fmt: skip


def _check_image(counts, camera, state, sun, detections, model):
    """Run the quality check of an image (rows, cols) whose rocks are already detected."""
    import numpy as np

    from lunarsim.onboard.perception.image_quality import ImageQualityCheck
    from lunarsim.onboard.perception.shadow_direction import measure_shadow_angle

    health = ImageQualityCheck()
    first = health.before_detection(counts, camera, state)
    points = np.column_stack((detections.terrain_xy, np.zeros(len(detections))))
    noise = first.metrics["noise"]
    turn = measure_shadow_angle(detections, camera.view(state), points, sun, model, noise)
    return health.after_detection(detections, turn, noise)


def _images(rng) -> None:
    """Print the time of association and filter update per image, by number of rocks."""
    for count in (100, 200, 500, 1000, 2000):
        rocks, camera, _ = _rock_filter(count)
        seen = min(150, count)
        ms = median_ms(lambda r=rocks, c=camera, s=seen: _one_image(r, c, s, rng), 9)
        print(f"  filter: {count:4d} tracked rocks, {seen} detected: {ms:6.1f} ms per image")


def _one_image(rocks, camera, seen: int, rng) -> None:
    """Associate an image's detections with a filter's rocks and update the filter.

    The first `seen` rocks of the filter are detected, with random pixel noise.
    """
    import numpy as np

    from lunarsim.onboard.hazards.shadows.association import associate

    sight = rocks.project_rocks(camera)
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


def _update_only() -> None:
    """Print the time of a filter update, and of filterpy's with the same states."""
    import numpy as np
    from filterpy.kalman import ExtendedKalmanFilter
    from threadpoolctl import threadpool_limits

    rocks, camera, _ = _rock_filter(500)
    seen = 150
    sight, noise = rocks.project_rocks(camera), np.tile(0.25 * np.eye(2), (seen, 1, 1))
    index, flat = np.arange(seen), np.full(seen, 0.01)
    size = 15 + 3 * 500
    dense = ExtendedKalmanFilter(size, 2 * seen)
    dense.P = rocks.covariance.copy()
    h = np.zeros((2 * seen, size))
    for j in range(seen):
        h[2 * j : 2 * j + 2, [0, 1, 2, 9, 10, 11]] = sight.jacobian_by_pose[j]
        h[2 * j : 2 * j + 2, 15 + 3 * j : 18 + 3 * j] = sight.jacobian_by_rock[j]
    z, r = np.zeros(2 * seen), 0.25 * np.eye(2 * seen)
    with threadpool_limits(1, "blas"):
        ours = median_ms(
            lambda: rocks.update_rocks(index, sight, sight.pixel[:seen], noise, flat + 0.49, flat),
            9,
        )
        peer = median_ms(lambda: dense.update(z, lambda x: h, lambda x: h @ x, R=r), 3)
    print(
        f"    500 rocks, 150 detected, update only, one thread: {ours:.1f} ms; dense "
        f"filterpy update of the same states {peer:.1f} ms, {peer / ours:.1f} times"
    )


def _evidence(elevation: float) -> None:
    """Print the time to mark rock-free terrain from one image, first and repeated.

    `elevation` is the elevation of the Sun, rad.
    """
    import numpy as np

    from lunarsim.frames import direction_from_angles
    from lunarsim.grid import Grid
    from lunarsim.onboard.hazards.shadows.clear_evidence import ClearEvidence
    from lunarsim.onboard.perception.detection_rates import DetectionRates
    from lunarsim.onboard.perception.detector import detect_rocks
    from lunarsim.onboard.perception.shape_mixture import ShapeMixture
    from lunarsim.vehicle import State
    from lunarsim.world import World
    from lunarsim.world.light import Light

    model, sun = ShapeMixture(elevation), direction_from_angles(0.0, elevation)
    _, camera, _ = _rock_filter(1)
    place, level = np.array([-20.0, 10.0, 80.0]), np.array([0.0, 0.0, 0.0, 1.0])
    state = State(place, np.zeros(3), level, np.zeros(3), 1.0)
    world = World(make_terrain(0.0, 700, 2.0, 120.0), 1.622, Light(0.0, elevation))
    counts = camera.expose(world, state, 0.0, np.random.default_rng(0)).counts
    seen, view = detect_rocks(counts, camera, state, sun, model=model), camera.view(state)
    sizes = 0.5 * 1.2 ** np.arange(10)
    evidence = ClearEvidence(
        Grid.centred((0.0, 0.0), 104.0, 0.2), model, sizes, np.ones(10), DetectionRates()
    )

    def look(restart: bool) -> None:
        if restart:
            evidence.forget()
        evidence.add_image(view, sun, seen, lambda xy: np.zeros(len(xy)))

    first, again = median_ms(lambda: look(True), 7), median_ms(lambda: look(False), 7)
    print(f"  evidence at {evidence.lit.shape} cells: {first:.1f} ms, repeated {again:.1f} ms")


def _maps(model) -> None:
    """Print the time of probability maps of rocks, by number of tracked rocks."""
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.onboard.hazards.shadows import ProbabilityMap, RockTracker

    for count in (100, 500, 2000):
        rocks, _, _ = _rock_filter(count)
        tracker = RockTracker(rocks, model)
        tracker.existence = np.full(count, 0.99)
        mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 160.0, 0.25), model)
        ms = median_ms(lambda m=mapping, t=tracker: m.probability(t), 5)
        disc = median_ms(lambda m=mapping, t=tracker: m.hazard_map(t, 1.1), 5)
        print(
            f"  map: 640 x 640 cells, {count:4d} rocks: {ms:6.1f} ms; over the lander footprint "
            f"{disc:6.1f} ms"
        )


def _flights() -> None:
    """Print the time of complete flights with shadow mapping, relative to real time."""
    from lunarsim.scenario import Scenario

    for name in ("nominal", "modified"):
        scenario = Scenario.load(ROOT / "scenarios" / f"shadow_{name}.toml")
        # Compiles the kernels and computes the Sun tables; rocks are visible by then.
        _time_flight(scenario, 25.0)
        before = reference_ms()
        flown, took, mapped, shutter = _time_flight(scenario)
        reference = 0.5 * (before + reference_ms())
        drawn, images = shutter.seconds, shutter.calls
        print(
            f"  flight, {name}: {flown:.0f} s simulated in {took:.1f} s, {flown / took:.2f} times "
            f"real "
            f"time ({images} images: {drawn:.1f} s for rendering and exposure; maps {mapped:.1f} "
            f"s; "
            f"rest: detection, tracking, flight); without rendering {flown / (took - drawn):.2f} "
            f"times\n    in units of the reference task ({reference:.0f} ms, before and after): "
            f"simulated second "
            f"{1e3 * took / flown / reference:.1f}; limit of twice real time: reference task on "
            f"two cores "
            f"in {0.5 * flown / took * reference:.0f} ms"
        )


def _time_flight(
    scenario, until: float = float("inf")
) -> tuple[float, float, float, TimedFunction]:
    """Fly a scenario up to time `until` (s) and measure its computing times.

    Returns simulated time, computing time, map time, s, and the timer of camera images.
    """
    from lunarsim.rng import flight_seed
    from lunarsim.sensors.camera import Camera
    from lunarsim.simulation import Simulation

    simulation = Simulation(scenario, flight_seed(1, 0))
    began = time.perf_counter()
    mapped = refreshed = 0.0
    expose = Camera.expose
    shutter = TimedFunction(expose)
    Camera.expose = lambda self, *a, s=shutter, **k: s(self, *a, **k)
    try:
        while not simulation.done and simulation.time < until:
            simulation.step()
            if simulation.time >= refreshed + 1.0:
                refreshed = simulation.time
                start = time.perf_counter()
                simulation.computer.mappers["rocks"].hazard_map()
                mapped += time.perf_counter() - start
    finally:
        Camera.expose = expose
    return simulation.time, time.perf_counter() - began, mapped, shutter
