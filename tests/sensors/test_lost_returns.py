"""Test the spacing of returns if some are lost: gaps and random losses differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim import Grid
from lunarsim.api import Lander
from lunarsim.frames import sensor_axes
from lunarsim.messages.measurements import local_return_fraction
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapper
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.vehicle import State
from lunarsim.world import World
from tests.worlds import flat_terrain

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
POSITION = np.array([0.0, 0.0, 150.0])


def fraction_by_loops(has_return, n=8):
    """Return the fraction of the best complete square at each pixel."""
    rows, cols = has_return.shape
    out = np.zeros(has_return.shape)
    for i in range(rows):
        for j in range(cols):
            for top in (i - n + 1, i):
                for left in (j - n + 1, j):
                    if min(top, left) >= 0 and top + n <= rows and left + n <= cols:
                        count = has_return[top : top + n, left : left + n].sum()
                        out[i, j] = max(out[i, j], count)
    return np.maximum(out, 1.0) / n**2


def test_it_is_the_best_of_four_squares():
    lost = np.random.default_rng(1).random((19, 23)) < 0.4
    lost[3:9, 10:22] = True
    assert local_return_fraction(~lost) == pytest.approx(fraction_by_loops(~lost))


def test_random_losses_are_found_and_gaps_are_not():
    lost = np.random.default_rng(2).random((64, 64)) < 0.7
    assert np.median(local_return_fraction(~lost)) == pytest.approx(0.3, abs=0.1)
    gap = np.ones((64, 64), bool)
    gap[20:26, 30:40] = gap[:, :5] = False
    assert (local_return_fraction(gap)[gap] == 1.0).all()
    assert local_return_fraction(np.zeros((4, 3), bool)).min() > 0.0
    assert local_return_fraction(np.ones((0, 5), bool)).shape == (0, 5)


def scan_with_loss(loss):
    world = World(flat_terrain(size=60.0, posting=1.0), 1.622)
    state = State(POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    rng = np.random.default_rng(3)
    scan = FlashLidar().measure(world, state, 0.0, rng, sensor_axes(-POSITION))
    return replace(scan, range=np.where(rng.random(scan.range.size) < loss, np.nan, scan.range))


def test_spacing_grows_with_the_loss_and_is_unchanged_without():
    full, half = (np.nanmedian(scan_with_loss(loss).spacing(UPRIGHT)) for loss in (0.0, 0.5))
    assert full == pytest.approx(150.0 * 0.2 / 256, rel=0.01)
    assert half == pytest.approx(full * np.sqrt(2.0), rel=0.06)


def test_the_observed_terrain_falls_gently_with_the_loss():
    """A rule by the nominal spacing leaves 65 %, 7 % and nothing of the terrain observed."""
    grid, own = Grid.centred((0.0, 0.0), 24.0, 0.2), np.diag([1.0] * 6 + [0.0] * 3)
    inner = np.abs(grid.x) < 9.0
    pose = Estimate(0.0, POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, own)
    observed = []
    for loss in (0.0, 0.2, 0.3, 0.7):
        mapper = GaussianDemMapper(grid, Lander())
        mapper.update(scan_with_loss(loss), pose)
        hazards = mapper.hazard_map()
        observed.append(float(hazards.observed[np.ix_(inner, inner)].mean()))
    assert observed[0] == 1.0
    assert observed[1] > 0.95
    assert observed[2] > 0.7
    assert observed[3] > 0.1
