"""Measure the speed of the Gaussian DEM and of the safety maps."""

from __future__ import annotations

from bench_parts.common import median_ms


def gaussian_dem() -> None:
    """Time 65,536 LiDAR returns to a safety map, relative to Qhull and ALHAT."""
    import numpy as np

    from bench_parts.brute_safety import compare
    from lunarsim.models.lander import Lander
    from lunarsim.sensors.lidar import FlashLidar

    lander = Lander()
    lidar = FlashLidar()
    terrain = _plane_with_rocks()
    points, shape = _scan(terrain, lidar, np.array([0.0, 0.0, 500.0]))
    qhull = _triangulations(points, shape)
    _safety_maps(points, shape, lidar.noise_ratio * 500.0, lander, qhull)
    _safety_tests(terrain, lander)
    compare(lander)


def _plane_with_rocks():
    """Return a flat terrain of 202 m with 500 rocks of 1 m."""
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.world.terrain import Heightfield, Terrain, place_rocks

    plane = Heightfield(Grid.centred((0.0, 0.0), 202.0, 2.0), np.zeros((101, 101), np.float32))
    return Terrain(plane, place_rocks(plane, np.full(500, 1.0), np.random.default_rng(0)))


def _scan(terrain, lidar, position):
    """Simulate a LiDAR flash straight down from a position (3,), m.

    Returns the points (n, 3), m, and rows and columns of the detector.
    """
    import numpy as np

    from lunarsim.frames import sensor_axes
    from lunarsim.vehicle import State
    from lunarsim.world import World

    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = State(position, np.zeros(3), upright, np.zeros(3), 1.0)
    down = sensor_axes([0.0, 0.0, -1.0])
    scan = lidar.measure(World(terrain, 1.622), state, 0.0, np.random.default_rng(1), down)
    return scan.points(position, upright), scan.shape


def _triangulations(points, shape) -> float:
    """Print the times of Delaunay triangulations relative to Qhull.

    `points` (n, 3) are from a detector of `shape`. Returns the time of Qhull, ms.
    """
    from scipy.spatial import Delaunay

    from lunarsim.triangulation import delaunay, delaunay_of_image

    qhull = median_ms(lambda: Delaunay(points[:, :2]), 5)
    print(f"  Delaunay: Qhull {qhull:.1f} ms; ratios to it:")
    for name, call in (
        ("detector image", lambda: delaunay_of_image(points[:, :2], shape)),
        ("any points", lambda: delaunay(points[:, :2])),
    ):
        print(f"    {name:15s} {median_ms(call) / qhull:.3f}")
    return qhull


def _safety_maps(points, shape, sigma: float, lander, qhull: float) -> None:
    """Print the time from points to safety map on increasingly fine grids.

    `sigma` is the range noise, m, and `qhull` the time of the triangulation by Qhull, ms.
    """
    from lunarsim.grid import Grid
    from lunarsim.onboard.hazards.gaussian_dem import gaussian_dem as build
    from lunarsim.safety import alhat_safety, conservative_safety, stochastic_safety

    print("  points to safety map, ratio to the Qhull triangulation; baseline / conservative:")
    for posting in (0.5, 0.3, 0.2, 0.1):
        grid = Grid.centred((0.0, 0.0), 100.0, posting)
        dem = build(points, grid, sigma_eps=sigma, image_shape=shape)
        first = median_ms(lambda g=grid: build(points, g, sigma_eps=sigma, image_shape=shape))
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


def _safety_tests(terrain, lander) -> None:
    """Print times of the true safety map, of its safe mask, and of bounds on safety.

    The functions are `exact_safety`, `safe_sites` and `bounded_safety`, each for a million cells of
    a rock field and of a rough relief.
    """
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.safety import bounded_safety, exact_safety, safe_sites
    from lunarsim.world.terrain import fractal_relief

    grid = Grid.centred((0.0, 0.0), 100.0, 0.1)
    relief = fractal_relief(grid, np.random.default_rng(1), hurst=0.85, rms_slope=np.deg2rad(8.0)).z
    print("  1000 x 1000 cells at 0.1 m: exact map, decision only, bounded test (ms)")
    for name, z in (("rock field", terrain.raster(grid)), ("relief", relief)):
        times = [
            median_ms(lambda c=call, z=z: c(z, grid, lander), 3)
            for call in (exact_safety, safe_sites, bounded_safety)
        ]
        print(f"    {name:10s} " + " ".join(f"{t:9.1f}" for t in times))
