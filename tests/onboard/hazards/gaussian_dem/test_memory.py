"""Test the memory use of the Gaussian DEM and of its safety map."""

from __future__ import annotations

import ctypes
import gc
import resource
import threading
from pathlib import Path

import numpy as np

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.gaussian_dem import gaussian_dem
from lunarsim.safety import (
    bounded_safety,
    conservative_safety,
    exact_safety,
    stochastic_safety,
)

LANDER = Lander()
STATM = Path("/proc/self/statm")


def detector(side: int, width: float, seed: int = 0) -> np.ndarray:
    """Return the returns of a detector over rolling terrain, row by row (side^2, 3)."""
    rng = np.random.default_rng(seed)
    line = np.linspace(-0.5 * width, 0.5 * width, side)
    x, y = np.meshgrid(line, line)
    z = 0.3 * np.sin(x / 4.0) + 0.02 * rng.standard_normal(x.shape)
    jitter = 0.1 * width / side * rng.standard_normal((2, side, side))
    return np.stack((x + jitter[0], y + jitter[1], z), axis=-1).reshape(-1, 3)


def chain(points: np.ndarray, grid: Grid, side: int) -> None:
    dem = gaussian_dem(points, grid, image_shape=(side, side))
    stochastic_safety(dem.mean, dem.variance, grid, LANDER)
    for test in (conservative_safety, bounded_safety, exact_safety):
        test(dem.mean, grid, LANDER)


def resident() -> float:
    """Return the resident memory of this process (MB)."""
    return int(STATM.read_text().split()[1]) * resource.getpagesize() / 1e6


def trimmed() -> float:
    """Return freed memory to the system, which later allocations would reuse unnoticed."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return resident()


def test_a_million_cells_take_less_than_300_megabytes():
    """Map of 100 x 100 m at 0.1 m, sampled while kernels run (they release the lock)."""
    chain(detector(16, 12.0), Grid.centred((0.0, 0.0), 12.0, 0.2), 16)
    points, grid = detector(256, 100.0), Grid.centred((0.0, 0.0), 100.0, 0.1)
    before = trimmed()
    seen = []
    done = threading.Event()

    def watch() -> None:
        while not done.wait(0.002):
            seen.append(resident())

    watcher = threading.Thread(target=watch)
    watcher.start()
    chain(points, grid, 256)
    done.set()
    watcher.join()
    # Mean, variance and the result of `exact_safety` take at least 17 MB.
    assert 17.0 < max(seen) - before < 300.0


def test_repeated_calls_keep_nothing():
    points, grid = detector(16, 12.0), Grid.centred((0.0, 0.0), 12.0, 0.2)
    for _ in range(200):
        chain(points, grid, 16)
    before = trimmed()
    for _ in range(1000):
        chain(points, grid, 16)
    # One additional map of each kind per call would take 60 MB.
    assert trimmed() - before < 3.0
