"""The Gaussian DEM and safety maps."""

from __future__ import annotations

from bench_parts.common import median_ms


def gaussian_dem() -> None:
    """65,536 returns from 500 m straight above to a safety map, against Qhull and ALHAT."""
    import numpy as np
    from scipy.spatial import Delaunay

    from lunarsim.frames import sensor_axes
    from lunarsim.grid import Grid
    from lunarsim.models.lander import Lander
    from lunarsim.onboard.hazards.gaussian_dem import gaussian_dem as build
    from lunarsim.safety import (
        alhat_safety,
        bounded_safety,
        conservative_safety,
        exact_safety,
        safe_sites,
        stochastic_safety,
    )
    from lunarsim.sensors.lidar import FlashLidar
    from lunarsim.triangulation import delaunay, delaunay_of_image
    from lunarsim.vehicle import State
    from lunarsim.world import World
    from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief, place_rocks

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
