from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards import HazardMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies import Candidates, Observation
from lunarsim.onboard.policies.library import (
    FuelAware,
    NearestSafe,
    NoDivert,
    Safest,
    ScoreboardChoice,
)
from lunarsim.parts import kinds, resolve

G = 1.622
LANDER = Lander()


def estimate(position=(-300.0, 0.0, 300.0), velocity=(20.0, 0.0, -15.0), mass=1480.0) -> Estimate:
    return Estimate(
        0.0, np.array(position), np.array(velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def observation(
    p, distance, propellant, here=0.5, here_propellant=20.0, *, more=None, **site
) -> Observation:
    n = len(p)
    grid = Grid.centred((0.0, 0.0), 10.0, 1.0)
    position = np.column_stack((distance, np.zeros(n), np.zeros(n)))
    return Observation(
        time=1.0,
        estimate=estimate(),
        hazard_map=HazardMap.unobserved(grid),
        candidates=Candidates(
            position, np.array(p), np.array(distance), np.array(propellant), **(more or {})
        ),
        site=np.zeros(3),
        site_p_safe=here,
        site_propellant=here_propellant,
        time_to_go=20.0,
        propellant=300.0,
        **site,
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
    assert FuelAware(propellant_weight=0.0).decide(o).site[0] == 60.0
    assert FuelAware(propellant_weight=0.25).decide(o).site[0] == 10.0


@pytest.mark.parametrize("policy", [Safest(), NearestSafe(), FuelAware()], ids=lambda p: p.name)
def test_nothing_in_reach_keeps(policy):
    o = observation([0.99], [10.0], [np.inf], here=float("nan"))
    assert policy.decide(o).site is None
    assert policy.decide(observation([], [], [])).site is None


def test_policies_go_by_the_names_of_the_registry():
    """But the one that is told the truth, which lives with the loop."""
    for name, where in kinds("policy", with_files=False).items():
        assert resolve("policy", name)().name == name, where


def test_value_decides_between_sites_equally_safe_and_sends_nobody_on():
    two = [0.999, 0.999], [9.0, 10.0], [20.0, 20.0]
    value = {"value": np.array([0.1, 0.9])}
    for policy in (Safest(), FuelAware()):
        assert policy.decide(observation(*two, here=0.2)).site[0] == 9.0
        assert policy.decide(observation(*two, here=0.2, more=value)).site[0] == 10.0
    # Value alone is no gain that is worth a divert, and safety goes first.
    for policy in (Safest(), FuelAware(propellant_weight=0.0)):
        assert policy.decide(observation(*two, here=0.999, more=value, site_value=0.1)).site is None
        risky = observation([0.97, 0.9], *two[1:], here=0.2, more=value)
        assert policy.decide(risky).site[0] == 9.0
    same = [0.99, 0.99], [9.0, 9.0], [20.0, 21.0]
    o = observation(*same, here=0.2, more=value)
    assert NearestSafe().decide(o).details["value"] == 0.9


@pytest.mark.parametrize("policy", [Safest(), NearestSafe(), FuelAware()], ids=lambda p: p.name)
def test_terrain_that_the_mission_forbids_is_left(policy):
    o = [0.97], [9.0], [20.0]
    assert policy.decide(observation(*o, here=0.999)).site is None
    assert policy.decide(observation(*o, here=0.999, site_eligible=False)).site[0] == 9.0


def board(score, here=np.inf, **options):
    n = len(score)
    ranked = np.isfinite(score)
    scores = np.where(ranked, score, 0.0)[ranked]
    return observation(
        [0.5] * n, [10.0 * (i + 1) for i in range(n)], options.pop("propellant", [20.0] * n),
        more={"score": np.array(score)},
        scoreboard=Scoreboard(np.zeros((len(scores), 3)), scores, here), **options,
    )  # fmt: skip


def test_the_scoreboard_flies_to_the_best_ranked_site_in_reach():
    choose = ScoreboardChoice().decide
    assert choose(board([3.0, 2.0, np.nan])).site[0] == 20.0
    assert choose(board([3.0, 2.0], propellant=[20.0, np.inf])).site[0] == 10.0
    assert choose(board([2.0, 2.0], propellant=[21.0, 20.0])).site[0] == 20.0
    # It stays where it is nearly as good, and leaves what is no longer eligible.
    assert choose(board([2.0], here=2.1)).site is None
    assert choose(board([2.0], here=2.3)).site[0] == 10.0
    assert choose(board([2.0], here=np.inf, here_propellant=np.inf)).site[0] == 10.0
    assert choose(board([np.nan])).site is None
    assert choose(board([2.0], propellant=[np.inf])).site is None
    assert choose(observation([0.9], [5.0], [20.0])).reason == "the mapper ranks no sites"


def test_the_scoreboard_weighs_fuel_if_asked_to():
    o = board([2.0, 2.5], propellant=[30.0, 20.0])
    assert ScoreboardChoice().decide(o).site[0] == 10.0
    assert ScoreboardChoice(propellant_weight=0.1).decide(o).site[0] == 20.0
    assert ScoreboardChoice(propellant_weight=0.1).decide(
        board([2.0], here=2.5, propellant=[30.0], here_propellant=20.0)
    ).site is None  # fmt: skip


@pytest.mark.parametrize("name", ["p_safe", "distance", "propellant", "value"])
@pytest.mark.parametrize("wrong", [np.nan, -1.0])
def test_costs_that_are_no_costs_are_refused(name, wrong):
    given = {name: np.array([0.5]) for name in ("p_safe", "distance", "propellant", "value")}
    Candidates(np.zeros((1, 3)), **given)
    with pytest.raises(InputError, match=f"candidates.{name}"):
        Candidates(np.zeros((1, 3)), **given | {name: np.array([wrong])})
    with pytest.raises(InputError, match=f"candidates.{name}"):
        Candidates(np.zeros((1, 3)), **given | {name: np.array([0.5, 0.5])})


def test_a_site_without_a_cost_is_refused():
    with pytest.raises(InputError, match="site_propellant"):
        observation([0.9], [5.0], [20.0], here_propellant=np.nan)
