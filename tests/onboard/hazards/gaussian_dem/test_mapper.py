"""When the Gaussian DEM's mapper draws its map."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.onboard.navigation import Estimate
from lunarsim.sensors.lidar import FlashLidar

GRID = Grid.centred((0.0, 0.0), 8.0, 0.5)
LIDAR = FlashLidar(rows=32, cols=32)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def flash(mapper: GaussianDemMapper, east: float = 0.0) -> None:
    """Look straight down on level ground from 50 m."""
    down = LIDAR.directions()
    mount = np.diag([1.0, -1.0, -1.0])
    scan = LidarScan(0.0, 50.0 / down[:, 2], down, mount, np.full(len(down), 0.01), (32, 32))
    here = np.array([east, 0.0, 50.0])
    mapper.update(scan, Estimate(0.0, here, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, np.eye(9)))


def test_a_map_is_drawn_once_an_interval():
    mapper = GaussianDemMapper(GRID, Lander(), interval=1.0)
    flash(mapper)
    first = mapper.hazard_map()
    assert first.elevation is not None
    mapper.refresh(0.9)
    flash(mapper)
    assert mapper.hazard_map() is first, "not yet due"
    mapper.refresh(1.0)
    second = mapper.hazard_map()
    assert second is not first
    mapper.refresh(5.0)
    assert mapper.hazard_map() is second, "nothing new"


def test_a_map_that_is_laid_elsewhere_is_due_at_once():
    mapper = GaussianDemMapper(GRID, Lander(), interval=10.0)
    flash(mapper)
    assert mapper.hazard_map().observed.shape == GRID.shape
    mapper.recentre(np.array([20.0, 0.0, 0.0]))
    assert not np.isfinite(mapper.hazard_map().elevation_at(np.array([20.0, 0.0])))
    flash(mapper, east=20.0)
    assert mapper.hazard_map().elevation_at(np.array([20.0, 0.0])) == pytest.approx(0.0, abs=0.05)


def test_samples_stay_where_they_are_when_the_map_is_laid_anew():
    mapper = GaussianDemMapper(GRID, Lander())
    flash(mapper, east=3.0)
    before = {tuple(np.round(p, 6)) for p in mapper.pool.vertices()[0]}
    mapper.recentre(np.array([0.3, 0.0, 0.0]))
    assert mapper.grid == GRID, "not worth it"
    side = GRID.cols * GRID.posting
    mapper.recentre(np.array([0.3 * side, -0.2 * side, 0.0]))
    after = {tuple(np.round(p, 6)) for p in mapper.pool.vertices()[0]}
    assert after <= before
    west, _, _, north = mapper.grid.extent
    gone = np.array(sorted(before - after)).reshape(-1, 3)
    assert ((gone[:, 0] < west) | (gone[:, 1] > north)).all()
    assert len(after) > 50


@pytest.mark.parametrize("interval", [-1.0, np.nan, np.inf])
def test_impossible_intervals_are_refused(interval):
    with pytest.raises(InputError, match="interval"):
        GaussianDemMapper(GRID, Lander(), interval=interval)


@pytest.mark.parametrize("safety", ["typo", "", None, "Calibrated"])
def test_a_safety_that_there_is_not_is_refused(safety):
    with pytest.raises(InputError, match="calibrated, level or planes"):
        GaussianDemMapper(GRID, Lander(), safety=safety)
