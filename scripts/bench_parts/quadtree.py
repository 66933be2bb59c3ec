"""Measure the speed of the quadtree map, its sites, and localisation."""

from __future__ import annotations

import statistics
import time

from bench_parts.common import ROOT, TimedFunction, median_ms


def quadtree() -> None:
    """Time point insertion relative to SciPy, and site selection as the map grows."""
    import numpy as np

    from lunarsim.onboard.hazards.quadtree import QuadtreeMap

    rng = np.random.default_rng(0)
    QuadtreeMap((0.0, 0.0), 100.0).insert(_cloud(rng, 10_000, 99.0))
    _points_at_once(rng)
    _memory()
    _flash_after_flash(rng)
    _larger_maps(rng)


def _cloud(rng, count: int, width: float, centre=(0.0, 0.0)):
    """Return random points (n, 3), m, on a square of smooth terrain with bumps."""
    import numpy as np

    xy = rng.uniform(-0.5 * width, 0.5 * width, (count, 2)) + centre
    bump = np.hypot(xy[:, 0] % 9.0 - 4.0, xy[:, 1] % 11.0 - 5.0) < 0.5
    z = 0.1 * np.sin(xy[:, 0] / 7.0) + 0.005 * xy[:, 1] + 0.45 * bump
    return np.column_stack((xy, z + rng.normal(0.0, 0.02, count)))


def _flash(rng):
    """Return the points of a LiDAR flash (128 x 128) at a random place of a 100 m map."""
    return _cloud(rng, 16_384, 8.0, rng.uniform(-45.0, 45.0, 2))


def _flash_ms(rng, quadtree, selector) -> tuple[float, float]:
    """Return the median times (ms) to insert a flash and to update the sites."""
    steps = []
    for _ in range(9):
        flash = _flash(rng)
        began = time.perf_counter()
        quadtree.insert(flash)
        middle = time.perf_counter()
        selector.update()
        steps.append((middle - began, time.perf_counter() - middle))
    insert, update = (1e3 * statistics.median(column) for column in zip(*steps, strict=True))
    return insert, update


def _points_at_once(rng) -> None:
    """Print the times to insert up to ten million points in one call."""
    from scipy.spatial import cKDTree
    from scipy.stats import binned_statistic_2d

    from lunarsim.onboard.hazards.quadtree import QuadtreeMap

    print("  all points at once, 100 x 100 m, minimum cell 0.1 m")
    for count in (100_000, 1_000_000, 10_000_000):
        points = _cloud(rng, count, 99.0)
        quadtree = QuadtreeMap((0.0, 0.0), 100.0)
        began = time.perf_counter()
        quadtree.insert(points)
        ours = time.perf_counter() - began
        began = time.perf_counter()
        binned_statistic_2d(points[:, 0], points[:, 1], points[:, 2], "mean", bins=1000)
        binned = time.perf_counter() - began
        line = (
            f"    {count:10,d}: {ours:6.2f} s ({1e9 * ours / count:4.0f} ns per point, "
            f"{quadtree.nbytes / count:.0f} bytes per point), {ours / binned:.2f} times SciPy's "
            f"binned "
            "mean at the minimum size"
        )
        if count <= 1_000_000:
            began = time.perf_counter()
            cKDTree(points[:, :2])
            line += f", {ours / (time.perf_counter() - began):.2f} times a KD-tree"
        print(line)
    points = _cloud(rng, 10_000_000, 999.0)
    quadtree = QuadtreeMap((0.0, 0.0), 1000.0)
    began = time.perf_counter()
    quadtree.insert(points)
    took = time.perf_counter() - began
    print(f"    10,000,000 random points on 1 km^2: {took:.2f} s, {quadtree.cell_count:,d} cells")


def _memory() -> None:
    """Print the memory of a process with a quadtree map and one site selection."""
    import subprocess
    import sys

    print("  resident memory of a separate process after one site selection, and its maximum")
    for insertion, count in (
        ("flashes", 1_000_000),
        ("flashes", 4_000_000),
        ("at once", 4_000_000),
    ):
        subprocess.run(
            [sys.executable, "-c", f"from bench_parts.quadtree import resident; "
             f"resident({insertion!r}, {count})"], check=True, cwd=ROOT / "scripts",
        )  # fmt: skip


def resident(insertion: str, count: int) -> None:
    """Print the memory growth of this process by a quadtree map of `count` points.

    `insertion` is "at once" (one insertion) or "flashes" (one insertion per LiDAR flash).
    """
    import resource
    from pathlib import Path

    import numpy as np

    from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector

    def now() -> int:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        return int(pages) * resource.getpagesize()

    rng = np.random.default_rng(0)
    warm = QuadtreeMap((0.0, 0.0), 100.0)
    warm.insert(_cloud(rng, 20_000, 20.0))
    SiteSelector(warm, thorough=True).update()
    # The points themselves are not counted.
    blocks = [_cloud(rng, count, 99.0)] if insertion == "at once" else []
    before = now()
    quadtree = QuadtreeMap((0.0, 0.0), 100.0)
    if blocks:
        quadtree.insert(blocks[0])
    while quadtree.count < count:
        quadtree.insert(_flash(rng))
    held = now() - before
    selector = SiteSelector(quadtree, thorough=True)
    selector.update()
    after = now() - before
    status = Path("/proc/self/status").read_text(encoding="ascii")
    most = 1024 * int(status.partition("VmHWM:")[2].split()[0]) - before
    print(
        f"    {quadtree.count:10,d} points, {insertion}: "
        f"{after / quadtree.count:.0f} bytes per point "
        f"({held / quadtree.count:.0f} before the selection, {most / quadtree.count:.0f} maximum; "
        f"{quadtree.nbytes / quadtree.count:.0f} in the arrays of the map)"
    )


def _flash_after_flash(rng) -> None:
    """Print insertion and query times while a map grows flash by flash."""
    from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector

    print("  successive flashes of 128 x 128 points on 8 x 8 m; then one update of the sites")
    quadtree = QuadtreeMap((0.0, 0.0), 100.0)
    selector = SiteSelector(quadtree)
    shown = [10_000, 100_000, 1_000_000, 3_000_000, 10_000_000]
    inserted = 0.0
    while shown:
        flash = _flash(rng)
        began = time.perf_counter()
        quadtree.insert(flash)
        inserted += time.perf_counter() - began
        if quadtree.count < shown[0]:
            if rng.random() < 0.05:
                selector.update()
            continue
        selector.update()
        _time_queries(rng, quadtree, selector)
        shown.pop(0)
    print(f"    all flashes: {inserted:.2f} s")


def _time_queries(rng, quadtree, selector) -> None:
    """Print the times of one more flash and of queries at the current map size."""
    from lunarsim.onboard.hazards.quadtree import SiteSelector

    insert, update = _flash_ms(rng, quadtree, selector)
    fresh = median_ms(lambda: SiteSelector(quadtree).update(), 3)
    box = median_ms(lambda: quadtree.points_in(0.0, 2.0, 0.0, 2.0))
    band = median_ms(lambda: quadtree.band(0.8, 1.6))
    places = rng.uniform(-45.0, 45.0, (1000, 2))
    cell = median_ms(lambda: [quadtree.cell_at(xy) for xy in places])
    print(
        f"    {quadtree.count:10,d} points: insert {insert:.1f} + update {update:.1f} ms; from "
        f"scratch {fresh:.1f} ms, {fresh / update:.0f} times as long; points in 4 m^2 {box:.2f} "
        f"ms, band of {len(quadtree.band(0.8, 1.6))} cells {band:.2f} ms, cell at a position "
        f"{cell:.1f} us"
    )


def _larger_maps(rng) -> None:
    """Print the time of one more flash on larger maps of equal point density."""
    from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector

    print("  equal point density on larger maps, one more flash")
    for side in (100.0, 200.0, 400.0):
        quadtree = QuadtreeMap((0.0, 0.0), side)
        quadtree.insert(_cloud(rng, round(100 * side**2), side - 1.0))
        selector = SiteSelector(quadtree)
        selector.update()
        insert, update = _flash_ms(rng, quadtree, selector)
        print(
            f"    {side:4.0f} m, {quadtree.count:10,d} points, {len(selector.mesh.nodes):5d} mesh "
            f"nodes: {insert + update:.1f} ms"
        )


def lidar_inertial() -> None:
    """Time the registration of scans on a prior map and the initial position search."""
    from functools import partialmethod

    from lunarsim.onboard.navigation import map_matcher as navigation
    from lunarsim.rng import flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation

    kept = navigation.register_scan, navigation.PlaceSearch.search
    scenario = Scenario.load(ROOT / "scenarios" / "morpheus.toml")
    for index in range(3):
        fit, search = (TimedFunction(function) for function in kept)
        navigation.register_scan = fit
        navigation.PlaceSearch.search = partialmethod(search)
        simulation = Simulation(scenario, flight_seed(1, index))
        while not simulation.done and simulation.time < 20.0:
            simulation.step()
        navigation.register_scan, navigation.PlaceSearch.search = kept
        print(
            f"  flight {index}: {fit.calls} registrations of {1e3 * fit.seconds / fit.calls:.1f} "
            f"ms, {search.calls} searches of {1e3 * search.seconds / max(search.calls, 1):.0f} ms"
        )
