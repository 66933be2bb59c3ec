"""What loads what: one sensor or one filter needs neither OpenGL nor a raster library."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("moderngl", "rasterio", "matplotlib", "gymnasium", "casadi", "xarray")


def loaded(module: str) -> set[str]:
    code = f"import sys, {module}; print(' '.join(m for m in {HEAVY!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "module",
    [
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
    ],
)
def test_nothing_heavy_comes_along(module):
    assert loaded(module) == set()


def test_the_check_can_fail():
    assert loaded("lunarsim.world.terrain.dtm") == {"rasterio"}
