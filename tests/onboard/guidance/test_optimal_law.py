"""The law of least propellant in flight: what it spends, when it falls back, what it tells."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lunarsim.errors import InputError
from lunarsim.models.gravity import RoundMoon
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance import optimal_law
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.approach import Approach
from lunarsim.onboard.guidance.contract import PhaseEnd, PlansArrival
from lunarsim.onboard.guidance.divert_cost import divert_cost
from lunarsim.onboard.guidance.optimal_law import OptimalLaw
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.optimal.errors import SolverError
from lunarsim.optimal.final_time import minimize_propellant, remaining_log_mass
from lunarsim.optimal.planner import Planner
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.optimal.cases import MOON, moon
from tests.worlds import SMALL_FLIGHT

UP = np.array([0.0, 0.0, MOON])
LANDER = Lander()
BRIEFING = SimpleNamespace(
    surface_gravity=MOON,
    nonuniform_gravity=None,
    lander=LANDER,
    software=SimpleNamespace(approach=Approach().__class__(max_tilt=0.7)),
)
END = PhaseEnd(np.array([0.0, 0.0, 11.6]), np.array([0.0, 0.0, -2.0]))
R, V = np.array([-600.0, 0.0, 500.0]), np.array([28.0, 0.0, -18.0])


def estimate(position=R, velocity=V, mass=1500.0, time=0.0) -> Estimate:
    return Estimate(
        time, np.asarray(position, float), np.asarray(velocity, float),
        np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), mass, np.eye(9),
    )  # fmt: skip


def flown(law, time_to_go=34.0, ends=lambda t: END, until=80.0, briefing=BRIEFING, pull=None):
    """Fly a point mass with commands held for 0.1 s; return its state and the law."""
    flight = law.build(briefing, 0.0)
    r, v, mass, t, cycle = R.copy(), V.copy(), 1500.0, 0.0, 0.1
    while t < until:
        wanted = flight.command(estimate(r, v, mass, t), ends(t), t, time_to_go - t)
        wanted = wanted * min(1.0, LANDER.thrust_max / mass / np.linalg.norm(wanted))
        if flight.arrival - t <= 0.0:
            break
        step = min(cycle, flight.arrival - t)
        a = wanted - UP if pull is None else wanted + pull(r, v)
        r, v = r + step * v + 0.5 * step**2 * a, v + step * a
        mass *= np.exp(-step * float(np.linalg.norm(wanted)) / LANDER.exhaust_velocity)
        t += step
        if step < cycle:
            break
    return r, v, mass, flight


@pytest.fixture(scope="module")
def nominal():
    return flown(OptimalLaw())


def test_it_spends_the_optimum_and_ends_where_it_should(nominal):
    r, v, mass, flight = nominal
    assert np.linalg.norm(r - END.position) < 0.5
    assert np.linalg.norm(v - END.velocity) < 0.3
    best = minimize_propellant(Planner(60), moon()).propellant
    assert 0.995 * best < 1500.0 - mass < 1.02 * best
    assert flight.events == []
    assert flight.plans >= 20
    assert isinstance(flight, PlansArrival)


def test_it_repeats_bit_for_bit(nominal):
    again = flown(OptimalLaw())
    for mine, other in zip(nominal[:3], again[:3], strict=True):
        assert np.array_equal(mine, other)


def test_a_plan_that_takes_too_long_is_late_and_the_apollo_law_flies():
    late = OptimalLaw(iterations=1, intervals=10).build(BRIEFING, 0.0)
    apollo = ApolloLaw().build(BRIEFING, 0.0)
    for t in (0.0, 0.1, 1.1, 2.1):
        got = late.command(estimate(time=t), END, t, 34.0 - t)
        assert np.array_equal(got, apollo.command(estimate(), END, t, late.arrival - t))
    assert [(t, name, details["reason"]) for t, name, details in late.events] == [
        (0.0, "guidance-fallback", "late")
    ]
    assert late.plans == 0


def test_a_plan_is_late_by_one_iteration_more_than_it_may_take():
    never = OptimalLaw(iterations=1, intervals=10).build(BRIEFING, 0.0)
    never.command(estimate(), END, 0.0, 34.0)
    taken = never.events[0][2]["iterations"]
    for most, plans in ((taken, 1), (taken - 1, 0)):
        law = OptimalLaw(iterations=most, intervals=10).build(BRIEFING, 0.0)
        law.command(estimate(), END, 0.0, 34.0)
        assert (law.plans, len(law.events)) == (plans, 1 - plans)


def test_what_cannot_be_reached_falls_back_once_and_plans_again_when_it_can():
    far = PhaseEnd(END.position + [0.0, 900.0, 0.0], END.velocity)

    def ends(t):
        return far if t < 0.95 else END

    _, _, _, flight = flown(OptimalLaw(intervals=15), ends=ends, until=1.25)
    names = [(round(t, 3), name) for t, name, _ in flight.events]
    assert names == [(0.0, "guidance-fallback"), (1.0, "guidance-planned")]
    assert flight.events[0][2]["reason"] == "infeasible"


def test_on_a_round_moon_that_turns_it_makes_up_for_what_it_feels(nominal):
    """Turned a hundred times too fast, so that it shows within half a minute."""
    field = RoundMoon(spin=3e-4, latitude=0.4).gravity(MOON)
    briefing_with_field = SimpleNamespace(**{**vars(BRIEFING), "nonuniform_gravity": field})
    r, v, mass, flight = flown(
        OptimalLaw(intervals=20), briefing=briefing_with_field, pull=field.free_fall_acceleration
    )
    untold = flown(OptimalLaw(intervals=20), pull=field.free_fall_acceleration)
    plain = flown(OptimalLaw(intervals=20))
    off = [np.linalg.norm(end[0] - plain[0]) for end in ((r, v), untold)]
    assert off[0] < 0.1
    assert off[1] > 5.0 * off[0]
    assert np.linalg.norm(v - END.velocity) < 0.3
    assert flight.events == []
    assert 1500.0 - mass == pytest.approx(1500.0 - plain[2], rel=0.1)  # it weighs less
    # Where there is no plan, the Apollo law makes up for it.
    late = OptimalLaw(iterations=1, intervals=10).build(briefing_with_field, 0.0)
    apollo = ApolloLaw().build(briefing_with_field, 0.0)
    got = late.command(estimate(), END, 0.0, 34.0)
    assert np.array_equal(got, apollo.command(estimate(), END, 0.0, late.arrival))


def test_a_divert_is_planned_at_once():
    other = PhaseEnd(END.position + [40.0, -30.0, 0.0], END.velocity)

    def ends(t):
        return END if t < 5.25 else other

    r, v, mass, flight = flown(OptimalLaw(), ends=ends)
    assert np.linalg.norm(r - other.position) < 0.6
    assert flight.events == []


bad = st.sampled_from([np.nan, np.inf, -np.inf])
lengths = arrays(np.float64, 3, elements=st.floats(-1000.0, 1000.0))
speeds = arrays(np.float64, 3, elements=st.floats(-50.0, 50.0))


@settings(max_examples=300)
@given(value=bad, which=st.integers(0, 7), r=lengths, v=speeds, left=st.floats(-100.0, 1e3))
def test_what_is_not_finite_is_refused(value, which, r, v, left):
    state = [*r, *v, 1500.0, left]
    state[which] = value
    flight = OptimalLaw().build(BRIEFING, 0.3)
    with pytest.raises(InputError, match="guidance"):
        flight.command(estimate(state[:3], state[3:6], state[6]), END, 0.0, state[7])


def all_finite(count, seed=8):
    """Ask from states near and absurd alike; return how many had a plan."""
    rng, planned = np.random.default_rng(seed), 0
    for _ in range(count):
        scale = 10.0 ** rng.uniform(-3.0, 6.0)
        mass = rng.choice([LANDER.dry_mass, LANDER.dry_mass + 1.0, 1300.0, 1500.0])
        here = estimate(scale * rng.normal(size=3), 0.1 * scale * rng.normal(size=3), mass)
        left = rng.choice([-1e3, -1.0, 0.0, 1e-9, 0.05, 1.0, 30.0, 1e4])
        flight = OptimalLaw(intervals=8).build(BRIEFING, rng.choice([0.0, 0.4]))
        for t in (0.0, 0.1, 1.2):
            got = flight.command(here, END, t, left - t)
            assert got.shape == (3,)
            assert np.isfinite(got).all(), (here, left, t)
        assert np.isfinite(flight.arrival)
        planned += flight.plans > 0
    return planned


def test_states_that_nobody_lands_from_still_have_finite_commands():
    all_finite(30)


@pytest.mark.slow
def test_ten_thousand_states_never_give_a_command_that_is_not_finite():
    assert all_finite(10_000) > 100


@pytest.fixture
def searches(monkeypatch):
    """Return what is searched for as a law plans: descent and path, one of each plan."""
    found, search = [], optimal_law.search_near

    def noted(planner, descent, first, **given):
        path = search(planner, descent, first, **given)
        found.append((descent, path))
        return path

    monkeypatch.setattr(optimal_law, "search_near", noted)
    return found


def test_plans_are_made_under_the_limits_of_the_approach(searches):
    approach = replace(Approach(), reserve=40.0, glideslope=0.3, max_tilt=0.6, throttle_margin=0.1)
    changed = SimpleNamespace(**{**vars(BRIEFING), "software": SimpleNamespace(approach=approach)})
    OptimalLaw(intervals=10).build(changed, 0.0).command(estimate(), END, 0.0, 34.0)
    d, throttle = searches[0][0], LANDER.thrust_max - LANDER.thrust_min
    assert d.dry_mass == LANDER.dry_mass + 40.0
    assert (d.glideslope, d.max_tilt, d.apex_depth) == (0.3, 0.6, 0.5)
    assert d.thrust_min == LANDER.thrust_min + 0.1 * throttle
    assert d.thrust_max == LANDER.thrust_max - 0.1 * throttle
    assert d.thrust_slack == 0.1 * throttle
    assert (d.max_final_tilt, d.tilt_rate) == (OptimalLaw().max_final_tilt, OptimalLaw().tilt_rate)


@pytest.mark.parametrize("margin", [0.0, 0.01])
def test_some_thrust_is_kept_back_whatever_the_margin(searches, margin):
    """A plan that takes all the engine has leaves nothing to answer a disturbance with."""
    approach = replace(Approach(), throttle_margin=margin)
    changed = SimpleNamespace(**{**vars(BRIEFING), "software": SimpleNamespace(approach=approach)})
    OptimalLaw(intervals=10).build(changed, 0.0).command(estimate(), END, 0.0, 34.0)
    d, throttle = searches[0][0], LANDER.thrust_max - LANDER.thrust_min
    assert d.thrust_max == pytest.approx(LANDER.thrust_max - 0.04 * throttle)
    assert d.thrust_max + d.thrust_slack == pytest.approx(LANDER.thrust_max)
    assert d.thrust_min == pytest.approx(LANDER.thrust_min + margin * throttle)


def test_a_lander_off_its_plan_is_pulled_back_to_it():
    """Critically damped: w^2 of the distance and 2 w of the speed, against both."""
    off, faster = np.array([0.3, -0.2, 0.1]), np.array([0.05, 0.02, -0.04])
    law = OptimalLaw(intervals=10, frequency=0.5)
    got = []
    for dr, dv in ((0.0, 0.0), (off, 0.0), (0.0, faster)):
        flight = law.build(BRIEFING, 0.0)
        flight.command(estimate(), END, 0.0, 34.0)
        here = estimate(R + 0.1 * V + dr, V + dv, time=0.1)
        got.append(flight.command(here, END, 0.1, 33.9))
    assert np.allclose(got[1] - got[0], -0.25 * off, atol=1e-9)
    assert np.allclose(got[2] - got[0], -1.0 * faster, atol=1e-9)


def test_a_plan_begins_when_its_first_command_takes_effect(searches):
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.5)
    got = flight.command(estimate(), END, 0.0, 34.0)
    path = searches[0][1]
    assert np.allclose(path.position[0], R + 0.5 * V, atol=1e-5)
    assert np.allclose(got, path.thrust_acceleration[0], atol=1e-4)
    assert flight.arrival == path.duration


def test_a_divert_is_seen_before_the_next_plan_is_due(searches):
    other = PhaseEnd(END.position + [30.0, 0.0, 0.0], END.velocity)
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.0)
    for t, end in ((0.0, END), (0.1, END), (0.2, other), (0.3, other)):
        flight.command(estimate(R + t * V, V, time=t), end, t, 34.0 - t)
    assert [d.end_position[0] for d, _ in searches] == [0.0, 30.0]
    assert flight.plans == 2


def test_apollo_takes_over_with_a_time_of_its_own():
    one = replace(END, position=END.position[None, :])
    limits = BRIEFING.software.approach.limits
    optimal_time = float(divert_cost(estimate(), one, LANDER, MOON, limits=limits).time_to_go[0])
    flight = OptimalLaw(iterations=1, intervals=10).build(BRIEFING, 0.0)
    flight.command(estimate(), END, 0.0, optimal_time + 25.0)
    assert flight.arrival == pytest.approx(optimal_time)


def test_a_plan_that_breaks_the_limits_of_thrust_is_not_flown(monkeypatch):
    monkeypatch.setattr(optimal_law, "is_flyable", lambda path: False)
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.0)
    flight.command(estimate(), END, 0.0, 34.0)
    assert flight.plans == 0
    assert [(name, details["reason"]) for _, name, details in flight.events] == [
        ("guidance-fallback", "thrust")
    ]


def test_after_a_fallback_it_plans_again_only_for_another_site(monkeypatch):
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.0)
    flight.command(estimate(), END, 0.0, 34.0)
    assert flight.plans == 1
    search = optimal_law.search_near
    monkeypatch.setattr(optimal_law, "search_near", lambda *given, **more: None)
    flight.command(estimate(R + V, V, time=1.0), END, 1.0, 33.0)
    monkeypatch.setattr(optimal_law, "search_near", search)
    for t in (2.0, 3.0, 4.0):
        flight.command(estimate(R + t * V, V, time=t), END, t, 34.0 - t)
    assert flight.plans == 1
    other = replace(END, position=END.position + [2.0, 0.0, 0.0])
    flight.command(estimate(R + 4.1 * V, V, time=4.1), other, 4.1, 29.9)
    flight.command(estimate(R + 5.1 * V, V, time=5.1), other, 5.1, 28.9)
    assert flight.plans == 3
    assert [name for _, name, _ in flight.events] == ["guidance-fallback", "guidance-planned"]


def test_apollo_takes_over_from_a_plan_too(monkeypatch):
    """A plan that was made before is flown no further: it told what was to be then."""
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.0)
    flight.command(estimate(), END, 0.0, 34.0)
    monkeypatch.setattr(optimal_law, "search_near", lambda *given, **more: None)
    here = estimate(R + V, V, time=1.0)
    got = flight.command(here, END, 1.0, 33.0)
    apollo = ApolloLaw().build(BRIEFING, 0.0).command(here, END, 1.0, flight.arrival - 1.0)
    assert np.allclose(got, apollo)
    assert [(t, name) for t, name, _ in flight.events] == [(1.0, "guidance-fallback")]


@pytest.mark.parametrize("expected", [34.0, 24.0])
def test_a_solver_that_finds_no_path_where_there_is_one_is_reported(monkeypatch, expected):
    """At 24 s there is none, a little later there is."""
    monkeypatch.setattr(optimal_law, "search_near", lambda *given, **more: None)
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.0)
    flight.command(estimate(), END, 0.0, expected)
    assert [details["reason"] for _, _, details in flight.events] == ["solver"]


def test_a_second_solver_that_fails_is_no_proof(monkeypatch):
    def fails(*given, **more):
        raise SolverError("it gave up")

    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.0)
    monkeypatch.setattr(optimal_law, "search_near", lambda *given, **more: None)
    monkeypatch.setattr(Planner, "at_time", fails)
    flight.command(estimate(), END, 0.0, 34.0)
    assert [details["reason"] for _, _, details in flight.events] == ["solver"]


def test_a_lander_short_of_fuel_or_low_over_the_end_plans_under_limits_that_it_can_keep(searches):
    low = END.position + np.array([-600.0, 0.0, 600.0 * np.tan(np.deg2rad(5.0)) - 0.5])
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.0)
    flight.command(estimate(low, [20.0, 0.0, 0.0], LANDER.dry_mass + 10.0), END, 0.0, 34.0)
    descent = searches[0][0]
    assert descent.dry_mass == LANDER.dry_mass + 5.0
    assert descent.glideslope == pytest.approx(np.deg2rad(4.5), abs=1e-6)
    assert not descent.violates_glideslope


def test_masses_of_the_last_plan_are_taken_over_but_not_at_a_divert(monkeypatch):
    taken, search = [], optimal_law.search_near

    def noted(planner, descent, first, **given):
        path = search(planner, descent, first, **given)
        taken.append((path, given["log_mass"]))
        return path

    monkeypatch.setattr(optimal_law, "search_near", noted)
    flight = OptimalLaw(intervals=10).build(BRIEFING, 0.5)
    other = PhaseEnd(END.position + [2.0, 0.0, 0.0], END.velocity)
    for t, end in ((0.0, END), (1.0, END), (1.1, other)):
        flight.command(estimate(R + t * V, V, time=t), end, t, 34.0 - t)
    assert [masses is None for _, masses in taken] == [True, False, True]
    assert np.allclose(taken[1][1], remaining_log_mass(taken[0][0], 1.0, 10))


def test_after_its_end_the_end_of_a_plan_is_held(searches):
    law = OptimalLaw(intervals=10, frequency=0.5, interval=60.0)
    flight = law.build(BRIEFING, 0.0)
    flight.command(estimate(), END, 0.0, 34.0)
    path = searches[0][1]
    late = path.duration + 2.0
    r, v, push = path.at(path.duration)
    got = flight.command(estimate(r, v, time=late), END, late, -2.0)
    assert np.allclose(got, push)


def test_reach_is_that_of_the_law_that_it_falls_back_to():
    sites = np.array([[0.0, 0.0, 11.6], [80.0, 40.0, 11.6]])
    ends = replace(END, position=sites)
    mine = OptimalLaw().cost(estimate(), ends, LANDER, MOON)
    apollo = ApolloLaw().cost(estimate(), ends, LANDER, MOON)
    assert np.array_equal(mine.propellant, apollo.propellant)


def test_a_flight_records_what_happened_to_guidance():
    table = {**SMALL_FLIGHT, "guidance": {"kind": "optimal", "iterations": 1}}
    flight = Simulation(Scenario.from_dict(table), 3, "no-divert")
    while not flight.computer.telemetry:
        flight.step()
    assert flight.computer.telemetry[0][1] == "guidance-fallback"
    assert flight.computer.time_to_go == pytest.approx(
        flight.computer.guidance.arrival - flight.computer.time
    )
    assert any(event["name"] == "guidance-fallback" for event in flight.flight().events)
