"""Test the alignment of a scan with the samples of earlier scans."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper, SamplePool
from lunarsim.onboard.navigation import Estimate
from lunarsim.onboard.phases import Phase
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import TINY_FLIGHT

FINE = Grid.centred((0.0, 0.0), 8.0, 0.2)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
KNOWN = np.zeros((9, 9))


def rock_terrain(xy):
    """Return heights of terrain with a slope, waves and rocks of 0.4 to 1 m."""
    x, y = xy.T
    z = 0.05 * x + 0.1 * np.sin(0.7 * x) * np.cos(0.5 * y)
    for k in range(24):
        east, north = (
            3.4 * np.sin(2.4 * k) * (k / 24) ** 0.5,
            3.4 * np.cos(2.4 * k) * (k / 24) ** 0.5,
        )
        radius = 0.2 + 0.3 * (k % 5) / 4
        z = z + np.sqrt(np.maximum(radius**2 - (x - east) ** 2 - (y - north) ** 2, 0.0))
    return z


def scan_of_rocks(rng, count=4000):
    xy = rng.uniform(-3.9, 3.9, (count, 2))
    return np.column_stack((xy, rock_terrain(xy) + rng.normal(0.0, 0.005, count)))


@pytest.mark.parametrize("shift", [(0.4, 0.0, 0.0), (-0.3, 0.7, 0.2), (0.9, -0.9, -0.5)])
def test_a_scan_of_rocks_shows_by_how_much_the_samples_are_displaced(shift):
    pool = SamplePool(FINE)
    pool.add(scan_of_rocks(np.random.default_rng(3)), 0.005, 0.1)
    points = scan_of_rocks(np.random.default_rng(4)) + shift
    points[::50, 2] += 5.0  # single returns far from the terrain
    offset = pool.offset(points)
    assert offset.shift == pytest.approx(shift, abs=0.05)
    assert np.abs(pool.shifted(offset.shift).offset(points).shift).max() < 0.02


def test_scans_in_place_or_of_terrain_without_features_are_not_shifted():
    pool, flat = SamplePool(FINE), SamplePool(FINE)
    pool.add(scan_of_rocks(np.random.default_rng(3)), 0.005, 0.1)
    level = [0.0, 0.0, 1.0]
    for seed in range(5, 15):
        rng = np.random.default_rng(seed)
        assert np.all(pool.offset(scan_of_rocks(rng)).shift[:2] == 0.0)
        points = np.column_stack((rng.uniform(-3.9, 3.9, (4000, 2)), rng.normal(0.0, 0.01, 4000)))
        if seed == 5:
            flat.add(points, 0.01, 0.1)
        assert np.all(flat.offset(points + level).shift[:2] == 0.0)


def test_the_map_moves_to_the_position_of_the_newest_scan():
    mapper = GaussianDemMapper(FINE, Lander())
    here, shift = FINE.centre, np.array([0.5, -0.3, 0.1])
    pool = SamplePool(FINE)
    pool.add(scan_of_rocks(np.random.default_rng(3)), 0.005, 0.1)
    for seed, by in ((3, np.zeros(3)), (4, shift)):
        rays = scan_of_rocks(np.random.default_rng(seed)) - [0.0, 0.0, 60.0]
        reach = np.linalg.norm(rays, axis=1)
        axes = np.diag([1.0, -1.0, -1.0])
        scan = LidarScan(
            float(seed), reach, (rays / reach[:, None]) @ axes, axes, np.full(len(rays), 0.005),
            (1, len(rays)),
        )  # fmt: skip
        mapper.update(
            scan,
            Estimate(0.0, by + [0.0, 0.0, 60.0], np.zeros(3), UPRIGHT, np.zeros(3), 1.0, KNOWN),
        )
    assert np.subtract(mapper.grid.centre, here) == pytest.approx(shift[:2], abs=0.05)
    assert mapper.hazard_map().grid == mapper.grid
    assert mapper.displacement == pytest.approx(shift, abs=0.05)
    points, _, _ = mapper.pool.vertices()
    true = rock_terrain(points[:, :2] - shift[:2]) + shift[2]
    assert np.median(np.abs(points[:, 2] - true)) < 0.02


def test_a_scan_that_contradicts_the_map_changes_no_height():
    mapper = GaussianDemMapper(FINE, Lander())
    before = None
    for k, noise in enumerate((0.0, 0.0, 0.3)):
        rng = np.random.default_rng(20 + k)
        rays = scan_of_rocks(rng) - [0.0, 0.0, 60.0]
        rays[:, 2] += np.abs(rng.normal(0.0, noise, len(rays)))
        reach = np.linalg.norm(rays, axis=1)
        axes = np.diag([1.0, -1.0, -1.0])
        scan = LidarScan(
            float(k), reach, rays / reach[:, None] @ axes, axes, np.full(len(rays), 0.005),
            (1, len(rays)),
        )  # fmt: skip
        pose = np.array([0.0, 0.0, 60.0])
        mapper.update(scan, Estimate(float(k), pose, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, KNOWN))
        hazards = mapper.hazard_map()
        if noise:
            np.testing.assert_array_equal(hazards.elevation, before.elevation)
            assert (mapper.displacement == 0.0).all()
            assert not hazards.in_domain.any()
        before = hazards


def test_a_site_that_was_chosen_on_the_map_moves_with_it(monkeypatch):
    scenario = Scenario.from_dict({
        **TINY_FLIGHT, "decisions": {"last_altitude_m": 60.0},
        "tasking": {"flash": {"kind": "periodic", "rate_hz": 1.0}},
    })  # fmt: skip
    flight = Simulation(scenario, 3, "safest")
    computer, scans = flight.computer, []
    monkeypatch.setattr(
        GaussianDemMapper, "displacement",
        property(lambda self: np.array([0.1, -0.2, 0.0]) * len(scans)),
    )  # fmt: skip
    update = GaussianDemMapper.update

    def take(self, measurement, estimate):
        update(self, measurement, estimate)
        scans.append(measurement.time)

    monkeypatch.setattr(GaussianDemMapper, "update", take)
    # Scans before and after the first divert, and in the vertical descent.
    scanned = {(False, Phase.APPROACH): 0, (True, Phase.APPROACH): 0, (True, Phase.VERTICAL): 0}
    while flight.outcome is None:
        before, count, diverts = computer.site, len(scans), len(computer.diverts)
        flight.step()
        if len(computer.diverts) == diverts:
            new = len(scans) - count
            moves = diverts > 0 and computer.phase == Phase.APPROACH
            expected = np.array([0.1, -0.2]) * new * moves
            assert (computer.site - before)[:2] == pytest.approx(expected, abs=1e-9)
            scanned[diverts > 0, computer.phase] += new
    assert min(scanned.values()) > 0
