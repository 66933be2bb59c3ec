"""Forked processes, several threads, other threading layers, kernels without compilation."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.worlds import ROOT

# A flight of two seconds without compiled kernels.
_FLIGHT = """
import concurrent.futures as cf, multiprocessing as mp, os, sys
import numba
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation

SCENARIO = {
    "name": "tiny",
    "terrain": {"size_m": 30.0, "posting_m": 1.0, "detail_m": 0.0},
    "rocks": {"cover": 0.04, "min_diameter_m": 0.4},
    "target": {"scatter_m": [2.0, 2.0]},
    "sensors": {
        "imu": {"kind": "imu"},
        "fix": {"kind": "navigation-fix"},
        "flash": {"kind": "flash-lidar", "rows": 12, "cols": 12},
    },
    "mappers": {"dem": {"kind": "gaussian-dem", "posting_m": 1.0, "size_m": 12.0}},
}


def fly(index):
    flight = Simulation(Scenario.from_dict(SCENARIO), flight_seed(1, index), "safest").run()
    return flight.outcome.safe, flight.propellant_used, flight.divert_distance
"""

_FORKS = (
    _FLIGHT
    + """
def result(call):
    try:
        return call()
    except Exception as error:
        return type(error).__name__, str(error)

print(fly(0))
with mp.get_context("fork").Pool(1) as pool:
    print(result(lambda: pool.map(fly, [1])))
with cf.ProcessPoolExecutor(1, mp_context=mp.get_context("fork")) as pool:
    print(result(lambda: pool.submit(fly, 1).result()))
child = os.fork()
if child == 0:
    print(result(lambda: fly(1)), flush=True)
    os._exit(0)
os.waitpid(child, 0)
"""
)

# Parallel kernels in three threads at once abort a process with this layer.
_WORKQUEUE = (
    _FLIGHT
    + """
import threading
from threading import Barrier
from lunarsim._work_partition import PartitionedKernel
from lunarsim.onboard.navigation._rock_filter_kernels import subtract_square_from_rows
from lunarsim.sensors.rendering import renderer_of
from lunarsim.models.pinhole import View
from lunarsim.frames import sensor_axes
from lunarsim.world.light import Light
from tests.worlds import flat_terrain
import numpy as np

p, w, rows = np.zeros((300, 300)), np.ones((2, 300)), np.arange(300)
subtract_square_from_rows(p.copy(), w, rows)
start = Barrier(3)

def subtract(_):
    own = p.copy()
    start.wait()
    for _ in range(40):
        subtract_square_from_rows(own, w, rows)
    return float(own[0, 0])

with cf.ThreadPoolExecutor(3) as pool:
    print(list(pool.map(subtract, range(3))), numba.threading_layer())

terrain = flat_terrain()
view = View(np.array([0.0, 0.0, 30.0]), sensor_axes([0.0, 0.0, -1.0]), 60, 60, 15.5, 11.5, 32, 24)
draw = lambda: renderer_of(terrain).render(view, Light()).radiance.mean() > 0.0
print(draw(), flush=True)
child = os.fork()
if child == 0:
    try:
        draw()
    except RuntimeError as error:
        print(error, flush=True)
    os._exit(0)
os.waitpid(child, 0)

def outlive():
    threading.main_thread().join()
    twice = PartitionedKernel(lambda share, out: out.append(share))
    twice(shares := [])
    twice(shares)
    print(draw(), sorted(shares), flush=True)

threading.Thread(target=outlive).start()
"""
)


def _lines(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=300,
        cwd=ROOT, env=os.environ | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def forked():
    """Return what a flight gives, then what flights in forked processes give."""
    return _lines(_FORKS)


def test_forked_processes_are_refused_with_the_line_to_type(forked):
    flown, *refused = forked
    assert flown.startswith("(True, ")
    assert len(refused) == 3
    for line in refused:
        assert line.startswith("('RuntimeError', ")
        assert 'multiprocessing.get_context("spawn")' in line


def test_workqueue_runs_kernels_in_turn_and_its_children_may_not_render():
    sums, drawn, refused, outlived = _lines(
        _WORKQUEUE, NUMBA_THREADING_LAYER="workqueue", NUMBA_NUM_THREADS="2"
    )
    assert sums == "[-80.0, -80.0, -80.0] workqueue"
    assert drawn == "True"
    assert 'multiprocessing.get_context("spawn")' in refused
    # A thread draws and divides its work after the main thread has ended.
    divided = "True [(0, 1), (0, 2), (1, 2)]"
    # Since Python 3.12 no thread can start if the interpreter has begun to end by then.
    undivided = "True [(0, 1), (0, 1)]"
    assert outlived == divided or (sys.version_info >= (3, 12) and outlived == undivided)


def test_a_flight_without_compilation_is_the_compiled_one(forked):
    assert _lines(_FLIGHT + "print(fly(0))", NUMBA_DISABLE_JIT="1") == forked[:1]


_OVERFLOW = """
import warnings; warnings.simplefilter("error")
import numpy as np
from lunarsim._jit import kernel

@kernel()
def squared(x):
    return x * x

print(squared(np.uint64(2**63 + 3)))
"""


def test_kernels_without_compilation_raise_no_warning():
    assert _lines(_OVERFLOW, NUMBA_DISABLE_JIT="1") == ["9"]
