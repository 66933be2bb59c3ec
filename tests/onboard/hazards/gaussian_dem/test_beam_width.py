"""The Gaussian DEM accounts for the width of the LiDAR beam."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim import Grid, Heightfield, Terrain, site_safety
from lunarsim.api import Lander
from lunarsim.frames import sensor_axes
from lunarsim.models.instruments import LidarInstrument
from lunarsim.onboard.hazards.gaussian_dem.mapper import (
    GaussianDemMapper,
    GaussianDemMapperSettings,
)
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.terrain import place_rocks

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
GRID = Grid.centred((0.0, 0.0), 24.0, 0.2)
POSITION = np.array([0.0, 0.0, 200.0])


def rocky_terrain():
    rng = np.random.default_rng(3)
    grid = Grid.centred((0.0, 0.0), 50.0, 0.5)
    relief = Heightfield(grid, np.zeros(grid.shape, np.float32))
    diameters = sample_diameters(50.0**2, 0.05, 0.1, 2.0, rng)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("ellipsoid")))


@pytest.fixture(scope="module")
def terrain():
    return rocky_terrain()


def hazard_map(terrain, divergence, known=True):
    lidar = FlashLidar(divergence=divergence)
    state = State(POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    rng = np.random.default_rng(4)
    scan = lidar.measure(World(terrain, 1.622), state, 0.0, rng, sensor_axes(-POSITION))
    ratio = lidar.calibration().beam_ratio if known else 0.0
    mapper = GaussianDemMapper(GRID, Lander(), beam_ratio=ratio)
    own = np.diag([1.0] * 6 + [0.0] * 3)
    mapper.update(scan, Estimate(0.0, POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, own))
    return mapper.hazard_map()


def claimed(hazards):
    return float(((hazards.p_safe > 0.95) & hazards.in_domain).mean())


def test_beam_ratio_is_the_beam_sigma_over_the_pixel():
    assert LidarInstrument(np.pi).beam_ratio == 0.0
    lidar = replace(FlashLidar(), divergence=0.8e-3)
    # 2 sigma at 100 m is 0.08 m, and the pixels are 0.1 / 128 rad apart.
    assert lidar.calibration().beam_ratio == pytest.approx(0.04 / (100.0 * 0.1 / 128))


def test_claims_with_a_wide_beam_are_safe_and_at_most_a_tenth_more_than_with_a_line_beam(terrain):
    """A beam as wide as a pixel also shows rocks between the pixels; a wider one hides them."""
    safe, _ = site_safety(terrain, GRID, Lander())
    inner = np.abs(GRID.x) < 9.0
    maps = [hazard_map(terrain, mrad * 1e-3) for mrad in (0.0, 0.2, 0.4, 0.8, 1.5)]
    found = [claimed(hazards) for hazards in maps]
    assert found[0] > 0.2
    assert found[2] < found[1] < found[0]
    assert max(found) < 1.1 * found[0]
    assert found[3] > 0.1
    assert found[4] == 0.0
    for hazards in maps[:4]:
        claims = (hazards.p_safe > 0.95) & hazards.in_domain & np.outer(inner, inner)
        assert safe[claims].mean() > 0.99
    # A map that does not know the width claims more.
    assert claimed(hazard_map(terrain, 0.8e-3, known=False)) > found[0]


def test_with_the_same_scan_a_wider_stated_beam_never_raises_p_safe(terrain):
    scan_with_line_beam = hazard_map(terrain, 0.0)
    lidar = FlashLidar()
    state = State(POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    rng = np.random.default_rng(4)
    scan = lidar.measure(World(terrain, 1.622), state, 0.0, rng, sensor_axes(-POSITION))
    own = np.diag([1.0] * 6 + [0.0] * 3)
    before = scan_with_line_beam.p_safe.mean()
    for ratio in (0.1, 0.3, 0.6, 1.2):
        mapper = GaussianDemMapper(GRID, Lander(), beam_ratio=ratio)
        mapper.update(scan, Estimate(0.0, POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, own))
        mean = mapper.hazard_map().p_safe.mean()
        assert mean < before
        before = mean


def test_the_mapper_of_a_flight_takes_the_beam_from_the_calibration(terrain):
    lidar, own = FlashLidar(divergence=0.8e-3), np.diag([1.0] * 6 + [0.0] * 3)
    briefing = SimpleNamespace(
        target=np.zeros(3), lander=Lander(), rocks=None, instruments={"flash": lidar.calibration()}
    )
    state = State(POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    rng = np.random.default_rng(4)
    scan = lidar.measure(World(terrain, 1.622), state, 0.0, rng, sensor_axes(-POSITION))
    mapper = GaussianDemMapperSettings(size=24.0).build(briefing, None)
    mapper.update(scan, Estimate(0.0, POSITION, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, own))
    expected = hazard_map(terrain, 0.8e-3)
    assert np.array_equal(mapper.hazard_map().p_safe, expected.p_safe)
