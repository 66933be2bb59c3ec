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


@click.command()
@click.argument("parts", nargs=-1)
def main(parts: tuple[str, ...]) -> None:
    """Run the named PARTS, or all of them."""
    unknown = [name for name in parts if name not in PARTS]
    if unknown:
        raise click.UsageError(f"no such part: {unknown[0]}; there are {', '.join(PARTS)}")
    print(f"{os.cpu_count()} cores, {numba.get_num_threads()} threads")
    for name in parts or PARTS:
        print(f"{name}: {(PARTS[name].__doc__ or '').strip().splitlines()[0]}")
        PARTS[name]()


if __name__ == "__main__":
    main()
