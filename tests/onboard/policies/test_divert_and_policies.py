from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance import DivertLimits
from lunarsim.onboard.guidance.apollo import terminal_polynomial
from lunarsim.onboard.guidance.divert import divert_cost
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.navigation import Estimate
from lunarsim.onboard.policies import Candidates, Observation
from lunarsim.onboard.policies.candidates import best_cells, candidate_sites
from lunarsim.onboard.policies.library import FuelAware, NearestSafe, NoDivert, Safest
from lunarsim.sensors.rendering.target import Target
from lunarsim.simulation.loop import make_policy

G = 1.622
LANDER = Lander()


def estimate(position=(-300.0, 0.0, 300.0), velocity=(20.0, 0.0, -15.0), mass=1480.0) -> Estimate:
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def test_cost_is_the_fuel_integral_of_the_best_trajectory():
    here = estimate()
    site = np.array([0.0, 0.0, 12.0])
    cost = divert_cost(here, site, LANDER, G)
    target = Target(site, np.array([0.0, 0.0, -2.0]))
    path = terminal_polynomial(here.position, here.velocity, target, cost.time_to_go[0])
    up = np.array([0.0, 0.0, G])
    dv = quad(lambda t: np.linalg.norm(path.at(t)[2] + up), 0.0, path.time_to_go)[0]
    propellant = here.mass * (1.0 - np.exp(-dv / LANDER.exhaust_velocity))
    assert cost.propellant[0] == pytest.approx(propellant, rel=1e-4)


def test_admissible_trajectories_keep_their_limits():
    here = estimate()
    limits = DivertLimits()
    sites = np.array([[x, y, 12.0] for x in (-40.0, 0.0, 40.0) for y in (0.0, 60.0)])
    cost = divert_cost(here, sites, LANDER, G, limits=limits)
    assert cost.feasible.any()
    for site, time_to_go in zip(sites[cost.feasible], cost.time_to_go[cost.feasible], strict=True):
        path = terminal_polynomial(
            here.position, here.velocity, Target(site, np.array([0.0, 0.0, -2.0])), time_to_go
        )
        thrust = path.at(np.linspace(0.0, time_to_go, 300))[2] + [0.0, 0.0, G]
        size = np.linalg.norm(thrust, axis=1) * here.mass
        assert size.max() <= LANDER.thrust_max
        assert size.min() >= LANDER.thrust_min
        assert (
            np.arccos(thrust[:, 2] / np.linalg.norm(thrust, axis=1)).max() < limits.max_tilt + 0.01
        )


def test_far_sites_and_empty_tanks_are_out_of_reach():
    assert not divert_cost(estimate(), [[3000.0, 0.0, 12.0]], LANDER, G).feasible[0]
    dry = estimate(mass=LANDER.dry_mass + 16.0)
    assert not divert_cost(dry, [[0.0, 0.0, 12.0]], LANDER, G).feasible[0]


def observation(p, distance, propellant, here=0.5, here_propellant=20.0) -> Observation:
    n = len(p)
    grid = Grid.centred((0.0, 0.0), 10.0, 1.0)
    position = np.column_stack((distance, np.zeros(n), np.zeros(n)))
    return Observation(
        time=1.0,
        estimate=estimate(),
        hazard_map=HazardMap.unobserved(grid),
        candidates=Candidates(position, np.array(p), np.array(distance), np.array(propellant)),
        site=np.zeros(3),
        site_p_safe=here,
        site_propellant=here_propellant,
        time_to_go=20.0,
        propellant=300.0,
    )


def test_no_divert_keeps():
    assert NoDivert().decide(observation([1.0], [5.0], [10.0])).site is None


def test_safest_takes_the_safest_reachable():
    o = observation([0.999, 0.9, 0.7], [50.0, 30.0, 5.0], [np.inf, 22.0, 20.0])
    decision = Safest().decide(o)
    assert decision.site[0] == 30.0
    assert decision.details["p_safe"] == 0.9


def test_safest_does_not_chase_small_gains():
    assert Safest().decide(observation([0.93], [30.0], [20.0], here=0.92)).site is None
    assert Safest().decide(observation([0.9999], [30.0], [20.0], here=0.9991)).site is None


def test_nearest_safe():
    o = observation([0.999, 0.96, 0.7], [50.0, 30.0, 5.0], [25.0, 22.0, 20.0])
    assert NearestSafe().decide(o).site[0] == 30.0
    assert NearestSafe().decide(observation([0.999], [9.0], [20.0], here=0.97)).site is None
    none_safe = observation([0.8, 0.4], [50.0, 5.0], [25.0, 20.0], here=0.1)
    assert NearestSafe().decide(none_safe).site[0] == 50.0


def test_fuel_aware_trades():
    o = observation([0.99, 0.95], [60.0, 10.0], [40.0, 21.0], here=0.2)
    assert FuelAware(price=0.0).decide(o).site[0] == 60.0
    assert FuelAware(price=0.25).decide(o).site[0] == 10.0


@pytest.mark.parametrize("name", ["safest", "nearest-safe", "fuel-aware"])
def test_nothing_in_reach_keeps(name):
    o = observation([0.99], [10.0], [np.inf], here=float("nan"))
    assert make_policy(name).decide(o).site is None
    assert make_policy(name).decide(observation([], [], [])).site is None


def test_unknown_policy_suggests():
    with pytest.raises(InputError, match="did you mean 'safest'"):
        make_policy("safset")


def test_best_cells_are_apart_and_best():
    rng = np.random.default_rng(1)
    aim = rng.random((60, 60)).astype(np.float32)
    cells = best_cells(aim, np.zeros((60, 60)), 0.5, 10, 3.0)
    gap = np.hypot(*(cells[:, None] - cells[None]).transpose(2, 0, 1)) * 0.5
    np.fill_diagonal(gap, np.inf)
    assert gap.min() >= 3.0
    values = aim[cells[:, 0], cells[:, 1]]
    assert values[0] == aim.max()
    assert (np.diff(values) <= 0.0).all()


def test_candidates_hold_the_nearest_safe_cell():
    grid = Grid.centred((0.0, 0.0), 60.0, 1.0)
    p = np.zeros(grid.shape, np.float32)
    p[5, 5:50] = 1.0
    p[32, 30] = 0.96
    hazard_map = HazardMap(grid, p, np.ones(grid.shape, bool), np.zeros(grid.shape, np.float32))
    c = candidate_sites(
        hazard_map, p, estimate(), np.zeros(3), LANDER, G, count=4, separation=3.0,
        approach_height=11.6, limits=DivertLimits(),
    )  # fmt: skip
    assert (np.diff(c.p_safe) <= 0.0).all()
    row, col = grid.cell(c.position[:, :2])
    assert (32, 30) in set(zip(row.tolist(), col.tolist(), strict=True))
    assert np.allclose(c.distance, np.hypot(c.position[:, 0], c.position[:, 1]))
    empty = HazardMap.unobserved(grid)
    nothing = candidate_sites(
        empty, empty.p_safe, estimate(), np.zeros(3), LANDER, G, count=4, separation=3.0,
        approach_height=11.6, limits=DivertLimits(),
    )  # fmt: skip
    assert len(nothing) == 0
