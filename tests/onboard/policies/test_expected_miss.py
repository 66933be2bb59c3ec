"""By how much a lander misses a site on its own map, and who is told."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.onboard.policies.contract import Candidates, Observation
from lunarsim.onboard.policies.expected_miss import expected_miss
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.oracle import TruthOracle
from tests.given_truth import GivenTruth
from tests.worlds import TINY_FLIGHT

# Instruments in place of fixes.
OWN = {
    "fix": None,
    "altimeter": {"kind": "radar-altimeter"},
    "velocimeter": {"kind": "velocimeter"},
    "stars": {"kind": "star-tracker"},
}


def estimate(speed: tuple[float, float, float]) -> Estimate:
    covariance = np.eye(9)
    covariance[3:6, 3:6] = np.diag(np.square(speed))
    return Estimate(
        0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 1.0, covariance
    )


def test_the_velocity_error_adds_up_until_touchdown():
    miss = expected_miss(0.3, estimate((0.03, 0.05, 9.0)), True, [0.0, 20.0, 40.0, -1.0])
    rate = np.sqrt(0.5 * (0.03**2 + 0.05**2))
    assert miss == pytest.approx(np.hypot(0.3, rate * np.array([0.0, 20.0, 40.0, 0.0])))
    held = expected_miss(0.3, estimate((0.03, 0.05, 9.0)), False, [0.0, 20.0])
    assert held.tolist() == [0.3, 0.3]


def test_the_reported_value_is_that_of_the_drift():
    """Drawn drifts, constant over the time, have the standard deviation told."""
    rng = np.random.default_rng(3)
    drawn = rng.standard_normal((20_000, 2)) * [0.03, 0.05] * 25.0
    drawn += 0.3 * rng.standard_normal(drawn.shape)
    told = expected_miss(0.3, estimate((0.03, 0.05, 1.0)), True, 25.0)[0]
    assert np.sqrt(np.mean(drawn**2)) == pytest.approx(told, rel=0.02)


def test_a_map_spread_at_points_is_the_map_spread():
    rng = np.random.default_rng(5)
    grid = Grid(3.0, -7.0, 0.4, 50, 70)
    seen = rng.random(grid.shape) < 0.8
    p = np.where(seen, rng.random(grid.shape), 0.0).astype(np.float32)
    hazard_map = HazardMap(grid, p, seen)
    # Corners and borders too.
    row = np.r_[0, 49, 0, 49, rng.integers(0, 50, 40)]
    col = np.r_[0, 0, 69, 69, rng.integers(0, 70, 40)]
    xy = grid.centre_of(row, col)
    for sigma in (0.0, 0.05, 0.3, 1.7, 6.0):
        got = hazard_map.dispersed_p_safe_at(xy, np.full(len(xy), sigma))
        assert got == pytest.approx(hazard_map.dispersed_p_safe(sigma)[row, col], abs=2e-6)
    for wrong in (np.nan, -0.1, np.inf):
        with pytest.raises(InputError, match="sigma"):
            hazard_map.dispersed_p_safe_at(xy[:2], np.array([0.1, wrong]))


def first_mapped(changes):
    """Return a flight in the cycle of its first scan, and what its policy is shown then."""
    simulation = Simulation(Scenario.from_dict(TINY_FLIGHT).changed(**changes), flight_seed(4, 0))
    while not simulation.computer.updated_mappers:
        simulation.step()
    return simulation, simulation.computer.observe()


def test_a_lander_held_by_fixes_expects_what_is_stated_and_another_its_drift():
    _, held = first_mapped({})
    assert held.expected_miss == 0.3
    simulation, adrift = first_mapped({"sensors": OWN})
    computer = simulation.computer
    # The map is of this cycle: all the time is still to come.
    seconds = adrift.time_to_go + computer.approach.vertical_altitude / 2.0
    rate = np.sqrt(0.5 * np.trace(adrift.estimate.covariance[3:5, 3:5]))
    assert adrift.expected_miss == pytest.approx(np.hypot(0.3, rate * seconds), rel=1e-9)
    assert adrift.expected_miss > 0.5
    # Each candidate is judged by its own time.
    sites = adrift.candidates.position
    times = computer.cost_of(sites).time_to_go
    seconds = np.where(np.isfinite(times), times, adrift.time_to_go)
    seconds += computer.approach.vertical_altitude / 2.0
    own = adrift.hazard_map.dispersed_p_safe_at(sites[:, :2], np.hypot(0.3, rate * seconds))
    assert adrift.candidates.p_safe == pytest.approx(own, abs=1e-9)
    assert np.ptp(seconds) > 0.2
    # What was mapped gets older.
    for _ in range(20):
        simulation.step()
    assert not computer.updated_mappers
    later = computer.observe()
    rate = np.sqrt(0.5 * np.trace(later.estimate.covariance[3:5, 3:5]))
    until = later.time_to_go + computer.approach.vertical_altitude / 2.0
    assert later.expected_miss > np.hypot(0.3, rate * until)


@pytest.mark.parametrize(("miss", "row"), [(0.1, 6), (0.9, 14), (40.0, 26)])
def test_the_oracle_asks_for_room_for_the_miss(miss, row):
    """Bands of safe ground, 3, 7 and 15 m wide: the nearest with room enough, else the roomiest."""
    grid = Grid.centred((0.0, 0.0), 90.0, 1.0)
    middle = grid.rows // 2
    safe = np.zeros(grid.shape, bool)
    for north, half in ((6, 1), (14, 3), (27, 7)):
        safe[middle + north - half : middle + north + half + 1] = True
    truth = GivenTruth(grid, safe)
    observation = Observation(
        time=1.0, estimate=estimate((0.0, 0.0, 0.0)), hazard_map=HazardMap.unobserved(grid),
        candidates=Candidates(np.zeros((0, 3)), *(np.zeros(0),) * 3),
        site=np.append(grid.centre_of(middle, middle), 0.0), site_p_safe=0.5, site_propellant=1.0,
        time_to_go=20.0, propellant=100.0, expected_miss=miss,
    )  # fmt: skip

    def cost_of(sites):
        n = len(sites)
        return DivertCost(np.ones(n), np.full(n, 20.0), np.ones(n), np.zeros(n))

    site = TruthOracle().decide_by_truth(observation, truth, np.zeros(3), cost_of).site
    clearance = distance_transform_edt(safe)
    here = clearance[tuple(int(v) for v in grid.cell(site[:2]))]
    assert here >= min(max(1.0, 2.5 * miss), 0.8 * clearance.max())
    assert abs(site[1] - observation.site[1] - row) <= 1.0


def test_the_map_is_spread_afresh_by_a_new_miss():
    simulation, _ = first_mapped({"sensors": OWN})
    computer = simulation.computer
    for _ in range(20):
        simulation.step()
    assert not computer.updated_mappers
    later = computer.observe()
    cell = tuple(int(v) for v in later.hazard_map.grid.cell(later.site[:2]))
    expected = later.hazard_map.dispersed_p_safe(later.expected_miss)[cell]
    assert later.site_p_safe == pytest.approx(float(expected), abs=1e-7)


def test_a_variance_that_rounding_has_eaten_gives_the_stated_miss():
    spoilt = estimate((0.0, 0.0, 0.0))
    spoilt.covariance[3, 3] = spoilt.covariance[4, 4] = -1e-12
    assert expected_miss(0.3, spoilt, True, [20.0]).tolist() == [0.3]


def test_navigation_that_says_nothing_of_it_is_adrift():
    assert Navigation.is_drifting.fget(None) is True


def test_a_miss_that_is_no_number_or_beyond_all_sites_is_the_greatest():
    spoilt = estimate((0.1, 0.1, 0.1))
    assert expected_miss(0.3, spoilt, True, [np.inf, np.nan, 1e9]).tolist() == [30.0] * 3
    spoilt.covariance[3, 3] = np.nan
    assert expected_miss(0.3, spoilt, True, [20.0]).tolist() == [30.0]
    assert expected_miss(50.0, spoilt, False, [20.0]).tolist() == [50.0]


def test_beyond_the_map_nothing_is_safe():
    grid = Grid.centred((0.0, 0.0), 4.0, 1.0)
    ones = np.ones(grid.shape, np.float32)
    hazard_map = HazardMap(grid, ones, ones > 0.0)
    beyond = np.array([[500.0, 0.0], [-60.0, -60.0], [-3.0, 0.5]])
    assert hazard_map.dispersed_p_safe_at(beyond, np.full(3, 0.5)).tolist() == [0.0] * 3
