"""Test the rejection of isolated returns: noise counts disappear, rocks stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim import Grid
from lunarsim.api import Lander
from lunarsim.frames import sensor_axes
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapper
from lunarsim.onboard.hazards.isolated_returns import without_isolated_returns
from lunarsim.onboard.hazards.quadtree.mapper import QuadtreeMapper
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.vehicle import State
from lunarsim.world import World
from tests.worlds import flat_terrain

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
LIDAR = FlashLidar(rows=96, cols=96)
WORLD = World(flat_terrain(size=60.0, posting=1.0), 1.622)


def flash(distance=120.0, angle=0.0, lidar=LIDAR, seed=1):
    """Return a scan of flat terrain from a distance (m) and an angle off nadir (rad)."""
    position = distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
    state = State(position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    rng = np.random.default_rng(seed)
    return lidar.measure(WORLD, state, 0.0, rng, sensor_axes(-position)), position


def estimate(position):
    return Estimate(
        0.0, position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, np.diag([1.0] * 6 + [0.0] * 3)
    )


def changed(scan, pixels, height):
    """Return a scan with ranges of some pixels (row, column) reduced by a height (m)."""
    image = scan.range.reshape(scan.shape).copy()
    for row, col in pixels:
        image[row, col] -= height
    return replace(scan, range=image.ravel())


@pytest.mark.parametrize("pixel", [(40, 40), (0, 0), (95, 30), (60, 95)])
def test_a_single_high_return_is_removed_also_at_the_edges(pixel):
    scan, _ = flash()
    found = without_isolated_returns(changed(scan, [pixel], 20.0), UPRIGHT)
    removed = np.isnan(found.range.reshape(scan.shape))
    assert removed[pixel] and removed.sum() == 1
    assert without_isolated_returns(changed(scan, [pixel], -20.0), UPRIGHT).range.size == 96 * 96


@pytest.mark.parametrize("angle", [0.0, 1.0])
def test_rocks_of_one_pixel_and_large_rocks_stay(angle):
    """A rock between two pixels is at most as high as it is wide."""
    scan, _ = flash(distance=500.0, angle=angle)
    spacing = 2.0 * 0.1 * 500.0 / 96
    small = changed(scan, [(50, 50)], 2.0 * spacing)
    assert without_isolated_returns(small, UPRIGHT) is small
    scan, _ = flash(angle=angle)
    large = changed(scan, [(i, j) for i in range(30, 33) for j in range(40, 43)], 5.0)
    assert without_isolated_returns(large, UPRIGHT) is large


def test_few_returns_without_neighbours_are_kept():
    scan, _ = flash()
    image = np.full(scan.shape, np.nan)
    image[::8, ::8] = 120.0
    sparse = replace(scan, range=image.ravel())
    assert without_isolated_returns(sparse, UPRIGHT) is sparse


def test_noise_counts_are_removed_and_the_terrain_stays():
    lidar = replace(LIDAR, false_return_fraction=0.02)
    scan, position = flash(lidar=lidar)
    clean, _ = flash()
    height = scan.points(position, UPRIGHT)[:, 2]
    found = without_isolated_returns(scan, UPRIGHT)
    assert (height > 3.0).sum() > 100
    # Two noise counts at equal ranges within two pixels support each other.
    assert np.isfinite(found.range[height > 3.0]).mean() < 0.05
    assert np.array_equal(found.range[height < 1.0], scan.range[height < 1.0])
    assert without_isolated_returns(clean, UPRIGHT) is clean


@pytest.mark.parametrize("kind", ["dem", "quadtree"])
def test_noise_counts_hardly_change_a_map(kind):
    """Without the rejection, one noise count in a thousand leaves no safe cell on the DEM."""
    grid, lander = Grid.centred((0.0, 0.0), 20.0, 0.2), Lander()
    safe = []
    for fraction in (0.0, 0.01):
        scan, position = flash(lidar=replace(LIDAR, false_return_fraction=fraction))
        mapper = (
            GaussianDemMapper(grid, lander)
            if kind == "dem"
            else QuadtreeMapper(grid, lander=lander)
        )
        mapper.update(scan, estimate(position))
        safe.append(float((mapper.hazard_map().p_safe > 0.5).mean()))
    assert safe[0] > 0.1
    # A noise count within 1.5 m of the terrain remains: 1 of 8000 returns, which is a rock.
    assert safe[1] > 0.7 * safe[0]
