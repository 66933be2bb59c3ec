"""Reach as a map: cells, points, and sites chosen among what can be reached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard import site_evaluator
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.divert_cost import divert_cost
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies import Observation
from lunarsim.onboard.policies.candidates import candidate_sites
from lunarsim.onboard.policies.library import NearestSafe, Safest, SafestOrAbort
from lunarsim.onboard.policies.reachability import ReachabilityMap
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import TINY_FLIGHT

G = 1.622
LANDER = Lander()
# 70 m up, 30 m before the origin, 12 kg above the reserve: some of 60 m about it can be reached.
HERE = Estimate(
    0.0, np.array([-30.0, 0.0, 70.0]), np.array([5.0, 0.0, -5.0]), np.array([0.0, 0.0, 0.0, 1.0]),
    np.zeros(3), LANDER.dry_mass + 27.0, np.eye(9),
)  # fmt: skip


class Costs:
    """Counts what is asked."""

    def __init__(self):
        self.asked = []

    def __call__(self, sites):
        self.asked.append(sites)
        return divert_cost(HERE, Approach().end(sites, LANDER), LANDER, G)


def ground(rows=130, cols=111, posting=1.3, centre=(40.0, -20.0)) -> HazardMap:
    grid = Grid.centred(centre, cols * posting, posting, rows * posting)
    height = 0.05 * np.arange(rows)[:, None] + np.zeros(grid.shape)
    height[0, 0] = np.nan
    return HazardMap(grid, np.zeros(grid.shape, np.float32), np.ones(grid.shape, bool),
                     height.astype(np.float32))  # fmt: skip


def test_a_map_of_reach_says_of_each_cell_what_is_said_of_a_site_there():
    hazard_map, costs = ground(), Costs()
    reach = ReachabilityMap.over_map(hazard_map, np.array([0.0, 0.0, 7.0]), costs)
    assert costs.asked == []  # nobody has looked yet
    assert max(reach.grid.shape) == 100
    assert 0.05 < reach.reachable.mean() < 0.95
    assert reach.propellant.shape == reach.reachable.shape == reach.grid.shape
    assert np.array_equal(np.isfinite(reach.propellant), reach.reachable)
    assert len(costs.asked) == 1  # surveyed once
    # No cell of the map lies beyond it, and heights are the map's, or the site's.
    centres = hazard_map.grid.centres()
    assert reach.grid.contains(centres).all()
    asked = costs.asked[0].reshape(*reach.grid.shape, 3)
    assert asked[0, 0, 2] == 7.0
    row, _ = hazard_map.grid.cell(asked[50, 40, :2])
    assert asked[50, 40, 2] == pytest.approx(0.05 * row, abs=1e-6)
    rng = np.random.default_rng(2)
    for i, j in zip(rng.integers(0, 100, 12), rng.integers(0, reach.grid.cols, 12), strict=True):
        alone = costs(asked[i, j][None, :])
        assert reach.reachable[i, j] == alone.feasible[0]
        spot = asked[i, j, :2] + 0.4 * reach.grid.posting * np.array([1.0, -1.0])
        assert reach.at(spot) == alone.feasible[0]
    assert not reach.at([[1e4, 0.0], [0.0, -1e4]]).any()


def test_a_small_map_keeps_its_cells():
    reach = ReachabilityMap.over_map(ground(20, 30, 0.5), np.zeros(3), Costs())
    assert reach.grid == ground(20, 30, 0.5).grid


def test_a_survey_of_cells_that_do_not_come_out_even_leaves_none_out():
    """302 columns in fifths are 60.4: rounded down, the outermost cells would lie beyond it."""
    hazard_map = ground(500, 302, 0.5)
    reach = ReachabilityMap.over_map(hazard_map, np.zeros(3), Costs())
    assert reach.grid.shape == (100, 61)
    assert reach.grid.contains(hazard_map.grid.centres()).all()


def test_one_poor_site_in_reach_does_not_hide_better_ones():
    """The safest is out of reach, a poor spot nearest; good ground lies in reach too."""
    grid = Grid.centred((0.0, 0.0), 400.0, 2.0)
    x, y = grid.x[None, :], grid.y[:, None]
    p = np.where(np.hypot(x - 150.0, y) < 40.0, 0.999, 0.0)
    p[(x > 10.0) & (x < 20.0) & (np.abs(y) < 8.0)] = 0.9
    site = np.array([-10.0, 0.0, 0.0])
    p[(np.abs(x) < 2.0) & (np.abs(y) < 2.0)] = 0.6  # nearest at 0.5
    p = p.astype(np.float32)
    hazard_map = HazardMap(
        grid, p, np.ones(grid.shape, bool), np.zeros(grid.shape, np.float32)
    )  # fmt: skip
    costs = Costs()
    reach = ReachabilityMap.over_map(hazard_map, site, costs)

    def asked(given, count=4, board=None):
        return candidate_sites(
            hazard_map, given, site, costs, count=count, separation=3.0, reach=reach,
            mapper="dem", scoreboard=board,
        )  # fmt: skip

    seen = asked(p)
    assert seen.reachable.all()
    assert seen.p_safe[0] == pytest.approx(0.9)
    assert 0.6 in seen.p_safe.round(6)  # what was in reach stays
    assert len(np.unique(seen.position, axis=0)) == len(seen)
    assert len(seen.source) == len(seen) == len(seen.score)
    # Ranked sites in reach keep their scores, those out of reach go.
    board = Scoreboard(np.array([[4.0, 4.0, 0.0], [150.0, 0.0, 0.0]]), np.array([0.3, 0.1]), 0.5)
    ranked = asked(p, board=board)
    assert ranked.score[np.isfinite(ranked.score)].tolist() == [0.3]
    mine = int(np.flatnonzero(np.isfinite(ranked.score))[0])
    assert ranked.source[mine] == "dem: ranked"
    assert ranked.position[mine].tolist() == [4.0, 4.0, 0.0]
    # Where what is in reach is as safe, or nothing is, all stay as they were.
    good = np.where(p == np.float32(0.6), np.float32(0.995), p)
    assert not asked(good).reachable.all()
    assert asked(good).reachable.any()
    far = np.where(p > 0.99, p, np.float32(0.0))
    assert len(asked(far)) > 0
    assert not asked(far).reachable.any()
    assert len(asked(np.zeros_like(p))) == 0


def test_where_no_site_will_do_others_are_looked_for_within_reach():
    """Safest ground far away and out of reach; less safe ground, but good, within it."""
    grid = Grid.centred((0.0, 0.0), 400.0, 2.0)
    x, y = grid.x[None, :], grid.y[:, None]
    p = np.where(np.hypot(x - 150.0, y) < 40.0, 0.999, 0.0)
    site = np.array([150.0, 0.0, 0.0])  # flown to, and no longer in reach itself
    p[(x > 10.0) & (x < 20.0) & (np.abs(y) < 8.0)] = 0.97
    p = p.astype(np.float32)
    hazard_map = HazardMap(
        grid, p, np.ones(grid.shape, bool), np.zeros(grid.shape, np.float32)
    )  # fmt: skip
    costs = Costs()
    reach = ReachabilityMap.over_map(hazard_map, site, costs)
    blind = candidate_sites(hazard_map, p, site, costs, count=4, separation=3.0)
    # The nearest at 0.95 is as far.
    assert len(blind) > 0
    assert not blind.reachable.any()
    seen = candidate_sites(hazard_map, p, site, costs, count=4, separation=3.0, reach=reach)
    assert seen.reachable.all()
    assert seen.p_safe == pytest.approx(np.full(len(seen), 0.97))

    def told(candidates, p_here):
        return Observation(
            time=0.0, estimate=HERE, hazard_map=hazard_map, candidates=candidates, site=site,
            site_p_safe=p_here, site_propellant=np.inf, time_to_go=10.0, propellant=100.0,
            reachability=reach,
        )  # fmt: skip

    for policy in (Safest(), NearestSafe(), SafestOrAbort()):
        decision = policy.decide(told(seen, 0.02))
        assert decision.site is not None
        assert told(seen, 0.02).reachability.at(decision.site[:2])
        assert policy.decide(told(blind, 0.02)).site is None
    # Nothing safe within reach is answered by climbing away, however safe the site out of reach is.
    assert SafestOrAbort().decide(told(blind, 0.02)).abort
    assert SafestOrAbort().decide(told(blind, 0.999)).abort
    assert not SafestOrAbort(abort_altitude=60.0).decide(told(blind, 0.999)).abort
    assert not SafestOrAbort().decide(replace(told(blind, 0.999), site_propellant=9.0)).abort
    assert SafestOrAbort().decide(told(seen, 0.999)).site is not None
    nowhere = np.where(p == np.float32(0.97), np.float32(0.1), p)
    poor = candidate_sites(hazard_map, nowhere, site, costs, count=4, separation=3.0, reach=reach)
    assert poor.reachable.all()
    assert SafestOrAbort().decide(told(poor, 0.02)).abort
    assert not Safest().decide(told(poor, 0.02)).abort


@pytest.mark.parametrize("window", [None, {"azimuth_deg": 180.0, "upper_edge_deg": 60.0}])
def test_the_computer_hands_its_reach_to_policy_and_candidates(monkeypatch, window):
    """What no window shows is out of reach, though law and engine could fly there."""
    asked = []
    real = site_evaluator.candidate_sites

    def spied(*given, **named):
        asked.append(named["reach"])
        return real(*given, **named)

    monkeypatch.setattr(site_evaluator, "candidate_sites", spied)
    tables = {} if window is None else {"window": window}
    simulation = Simulation(Scenario.from_dict(TINY_FLIGHT | tables), 4, "no-divert")
    while not simulation.computer.updated_mappers:
        simulation.step()
    asked.clear()
    seen = simulation.computer.observe()
    assert asked == [seen.reachability]
    ground_seen = seen.reachability.grid.contains(seen.hazard_map.grid.centres())
    assert ground_seen.all()
    centres = np.column_stack((seen.reachability.grid.centres().reshape(-1, 2),
                               np.full(seen.reachability.reachable.size,
                               seen.site[2])))  # fmt: skip
    assert simulation.computer.cost_of(centres).feasible.mean() > 0.9
    assert (
        seen.reachability.reachable.mean() > 0.9
        if window is None
        else not seen.reachability.reachable.any()
    )
    assert seen.reachability.at(seen.site[:2]) == (window is None)
