"""Timing functions and terrain that several benchmarks use."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent


def median_ms(call: Callable[[], object], repeats: int = 9) -> float:
    """Return the median time of `call`, ms, after one call for compilation."""
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return 1e3 * statistics.median(times)


def reference_ms() -> float:
    """Return the time of a fixed SciPy task, ms, as a reference between machines."""
    import numpy as np
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.linspace(-50.0, 50.0, 256), np.linspace(-50.0, 50.0, 256))
    points = np.column_stack((u.ravel(), v.ravel())) + 0.05 * rng.standard_normal((65_536, 2))
    return median_ms(lambda: Delaunay(points), 3)


def alternating_medians(
    calls: dict[str, Callable[[], object]], repeats: int = 11
) -> dict[str, float]:
    """Return the median time of each function, ms, with the calls in turn.

    Slow changes of the machine's speed therefore affect all functions equally.
    """
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            began = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - began)
    return {name: 1e3 * statistics.median(one) for name, one in times.items()}


class TimedFunction:
    """Wrapper of a function that counts its calls and their total time, s."""

    def __init__(self, function):
        self.function = function
        self.seconds = 0.0
        self.calls = 0

    def __call__(self, *args, **more):
        """Call the function, add its time to the total, and return its result."""
        began = time.perf_counter()
        result = self.function(*args, **more)
        self.seconds += time.perf_counter() - began
        self.calls += 1
        return result


def make_terrain(slope_deg: float, count: int, posting: float, side: float, seed: int = 0):
    """Return a square fractal terrain with about `count` rocks of Golombek's law.

    `slope_deg` is the RMS slope, `posting` the grid spacing and `side` the side, m.
    """
    import numpy as np

    from lunarsim.grid import Grid
    from lunarsim.rocks.field import RockModel
    from lunarsim.rocks.size_distribution import golombek_number, sample_diameters
    from lunarsim.world.terrain import Terrain, fractal_relief, place_rocks

    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), side, posting)
    relief = fractal_relief(grid, rng, hurst=0.8, rms_slope=np.radians(slope_deg))
    # Minimum diameter at which a cover of 5 % gives this number of rocks.
    sizes = np.geomspace(0.05, 2.0, 400)
    least = float(np.interp(-count / side**2, -golombek_number(sizes, 0.05), sizes))
    diameters = sample_diameters(side**2, 0.05, least, 3.0, rng)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("mixed")))
