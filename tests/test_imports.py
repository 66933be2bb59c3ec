"""What loads what: one sensor or one filter needs neither OpenGL nor a raster library."""

from __future__ import annotations

import subprocess
import sys

HEAVY = (
    "moderngl", "rasterio", "matplotlib", "gymnasium", "casadi", "xarray", "scipy.stats",
)  # fmt: skip


MODULES = (
    "lunarsim.sensors.altimeter",
    "lunarsim.sensors.camera",
    "lunarsim.sensors.imu",
    "lunarsim.sensors.lidar",
    "lunarsim.sensors.navigation_fix",
    "lunarsim.onboard.navigation.rock_filter",
    "lunarsim.onboard.navigation.navigator",
    "lunarsim.onboard.hazards.gaussian_dem",
    "lunarsim.onboard.hazards.shadows",
    "lunarsim.onboard.hazards.quadtree",
    "lunarsim.onboard.computer",
    "lunarsim.scenario",
)

# What the command line may not load before it knows what it is to do.
SLOW = ("rich", "numpy", "scipy", "numba", "pydantic", "pyarrow")

# Imports one module after the other and prints what is loaded after each.
CODE = """
import importlib, sys
heavy, *modules = sys.argv[1:]
for module in modules:
    importlib.import_module(module)
    print(module, *(name for name in heavy.split(",") if name in sys.modules))
"""


def loaded(*modules: str, heavy: tuple[str, ...] = HEAVY) -> dict[str, set[str]]:
    """Return what is loaded after each module, all of them imported by one process in turn."""
    command = [sys.executable, "-c", CODE, ",".join(heavy), *modules]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    return {module: set(found) for module, *found in lines}


def test_nothing_heavy_comes_along():
    assert loaded(*MODULES) == {module: set() for module in MODULES}


def test_an_environment_loads_no_plots_before_it_renders():
    module = "lunarsim_envs.retarget"
    assert loaded(module, heavy=("matplotlib", "scipy.stats", "rasterio")) == {module: set()}


def test_help_waits_for_nothing():
    """`lunarsim --help` loads what it prints, and no library that takes time."""
    assert loaded("lunarsim.cli", heavy=SLOW) == {"lunarsim.cli": set()}


def test_the_check_can_fail():
    name = "lunarsim.world.terrain.dtm"
    assert loaded(name) == {name: {"rasterio"}}
