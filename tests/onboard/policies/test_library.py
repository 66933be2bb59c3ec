from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies import Candidates, Observation
from lunarsim.onboard.policies.library import FuelAware, NearestSafe, NoDivert, Safest
from lunarsim.parts import CONTRACTS, resolve

G = 1.622
LANDER = Lander()


def estimate(position=(-300.0, 0.0, 300.0), velocity=(20.0, 0.0, -15.0), mass=1480.0) -> Estimate:
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


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


@pytest.mark.parametrize("policy", [Safest(), NearestSafe(), FuelAware()], ids=lambda p: p.name)
def test_nothing_in_reach_keeps(policy):
    o = observation([0.99], [10.0], [np.inf], here=float("nan"))
    assert policy.decide(o).site is None
    assert policy.decide(observation([], [], [])).site is None


def test_policies_go_by_the_names_of_the_registry():
    """But the one that is told the truth, which lives with the loop."""
    for name, where in CONTRACTS["policy"].kinds.items():
        assert resolve("policy", name)().name == name, where
