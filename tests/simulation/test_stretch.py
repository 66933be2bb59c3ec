"""Decisions that time_scale the time-to-go: what the whole simulation flies then."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.divert_cost import divert_cost
from lunarsim.onboard.policies.contract import Decision
from lunarsim.simulation import Simulation

AWAY = np.array([18.0, -12.0, 0.0])


def deciding(scenario):
    """Return a flight that has kept its site once and is to decide again."""
    simulation = Simulation(scenario, 6, None)
    while not simulation.decision_due:
        simulation.move()
    simulation.apply(Decision.keep("first"))
    simulation.move()
    while not simulation.decision_due:
        simulation.move()
    return simulation


@pytest.fixture
def small_scenario(small_scenario):
    """The small scenario with control cycles of the default length."""
    return small_scenario.changed(simulation={"cycle_s": 0.1})


@pytest.fixture
def flying(small_scenario):
    return deciding(small_scenario)


def cheapest(simulation, site):
    return float(simulation.computer.cost_of(site[None]).time_to_go[0])


def refusals(simulation):
    told = simulation.computer.telemetry
    return [(name, d["reason"]) for _, name, d in told if name.endswith("-refused")]


@pytest.mark.parametrize("away", [AWAY, None], ids=["new", "present"])
@pytest.mark.parametrize("time_scale", [1, 1.1, np.float32(1.25)])
def test_a_time_scale_multiplies_the_cheapest_time(flying, away, time_scale):
    site = None if away is None else flying.site + away
    goal = flying.site if site is None else site
    left = cheapest(flying, goal)
    # The arrival that is flown was chosen a second before: planned afresh it is another.
    assert abs(flying.computer.time_to_go - left) > 0.01
    assert flying.apply(Decision(site, "slowly", time_scale=time_scale))
    assert flying.computer.time_to_go == pytest.approx(time_scale * left, rel=1e-12)
    assert np.array_equal(flying.site, goal) and refusals(flying) == []
    flight = flying.run()
    assert flight.outcome.touchdown is not None
    assert np.hypot(*flying.state.velocity[:2]) < 0.6


def test_without_one_a_kept_site_keeps_its_arrival_and_a_new_one_gets_the_cheapest(flying):
    before = flying.computer.time_to_go
    assert flying.apply(Decision(None, "stay"))
    assert flying.computer.time_to_go == before
    goal = flying.site + AWAY
    left = cheapest(flying, goal)
    assert flying.apply(Decision(goal, "go"))
    assert flying.computer.time_to_go == pytest.approx(left, rel=1e-12)


@pytest.mark.parametrize("away", [AWAY, None], ids=["new", "present"])
@pytest.mark.parametrize("time_scale", [0.4, 8.0])
def test_what_breaks_a_limit_gives_way_to_the_cheapest(flying, away, time_scale):
    """Too short for thrust and tilt; too long for the tanks."""
    site = None if away is None else flying.site + away
    goal = flying.site.copy() if site is None else site
    left = cheapest(flying, goal)
    assert flying.apply(Decision(site, "quickly", time_scale=time_scale))
    assert flying.computer.time_to_go == pytest.approx(left, rel=1e-12)
    assert np.array_equal(flying.site, goal)
    time, name, told = flying.computer.telemetry[-1]
    assert (time, name) == (flying.time, "time-scale-refused")
    assert told["reason"] == "beyond the limits" and told["time_scale"] == time_scale
    assert np.array_equal(told["site"], goal)
    # It is in the record, with all that was told.
    (event,) = (e for e in flying.flight().events if e["name"] == "time-scale-refused")
    assert event["time_scale"] == time_scale


def test_sites_out_of_reach_are_refused_as_ever(flying):
    before, left = flying.site.copy(), flying.computer.time_to_go
    assert not flying.apply(Decision(before + [5000.0, 0.0, 0.0], "far", time_scale=1.1))
    assert refusals(flying) == [("divert-refused", "out of reach")]
    flying.computer.site = before + [5000.0, 0.0, 0.0]
    assert flying.apply(Decision(None, "stay", time_scale=1.1))
    assert refusals(flying)[1:] == [("time-scale-refused", "out of reach")]
    assert flying.computer.time_to_go == left


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"approach": {"time_to_go_s": 34.0}}, "the mission sets the time-to-go"),
        ({"guidance": {"kind": "optimal"}}, "the law plans its own arrival"),
    ],
)
def test_where_others_set_the_time_the_site_is_taken_alone(small_scenario, changes, reason):
    flying = deciding(small_scenario.changed(**changes))
    before, goal = flying.computer.time_to_go, flying.site + AWAY
    assert flying.apply(Decision(None, "later", time_scale=1.2))
    assert flying.computer.time_to_go == before
    left = cheapest(flying, goal)
    assert flying.apply(Decision(goal, "elsewhere", time_scale=1.2))
    assert np.array_equal(flying.site, goal)
    assert flying.computer.time_to_go == pytest.approx(left, rel=1e-12)
    assert refusals(flying) == [("time-scale-refused", reason)] * 2


def test_below_the_approach_there_is_no_time_to_scale(flying):
    while flying.altitude > 8.0:
        flying.move()
    flying.apply(Decision(None, "late", time_scale=1.2))
    assert refusals(flying) == [("time-scale-refused", "not on the approach")]


@dataclass(frozen=True)
class Plain(ApolloLaw):
    """A law of somebody's own whose cost knows of no given times."""

    def cost(self, estimate, end, lander, gravity, limits=None):
        return divert_cost(estimate, end, lander, gravity, limits=limits, shape=self.shape)


def test_a_law_that_knows_no_times_flies_without_time_scales(small_scenario, monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", __name__)
    own = small_scenario.changed(guidance={"kind": f"{__name__}:Plain"})
    flying = deciding(own)
    assert flying.apply(Decision(flying.site + AWAY, "go"))


@pytest.mark.parametrize("time_scale", [0.0, -1.0, np.nan, np.inf, "1", True, [1.1]], ids=str)
def test_what_is_no_time_scale_is_refused(time_scale):
    with pytest.raises(InputError, match=r"decision\.time_scale"):
        Decision(None, "stay", time_scale=time_scale)


def test_an_abort_has_no_time_scale():
    with pytest.raises(InputError, match=r"decision\.time_scale: must be None if abort is True"):
        replace(Decision.climb_away("up"), time_scale=1.1)
