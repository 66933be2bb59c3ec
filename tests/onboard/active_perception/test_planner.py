"""The search for a path: whom it asks, what it takes for granted, and what it brings back."""

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.onboard.active_perception.guidance import InformationSeekingLaw
from lunarsim.onboard.active_perception.planner import InformationPlanner, PathPlan
from lunarsim.onboard.active_perception.sensor_coverage import (
    build_coverage_models,
    footprint_radius,
)
from lunarsim.onboard.guidance.divert_cost import divert_cost
from lunarsim.onboard.tasking.contract import MeasurementAltitudes
from tests.onboard.active_perception.conftest import at_start
from tests.reference import seeking as plain

PRICE, MOST = 0.02, 20.0


@pytest.fixture(scope="module")
def asked(paper):
    """A law as the flight begins, its problem, and its only eye."""
    law, (here, end) = at_start(paper)
    (eye,) = build_coverage_models(paper.briefing, 0.5)
    return law, law.problem(here, end, paper.site), eye


def planner(eye, looks=None, candidates=600, max_final_tilt=0.9):
    return InformationPlanner(
        [eye], [looks or MeasurementAltitudes()], candidates, PRICE, max_final_tilt
    )


def worth(one, problem, plans):
    """Return share known less the price of the propellant (n,); -inf where there is no path."""
    known, increment = one.score(problem, plans).T
    lander = problem.lander
    burnt = -np.expm1(-increment / lander.exhaust_velocity) * problem.estimate.mass
    return np.where(np.isfinite(increment), known - PRICE * burnt, -np.inf)


def plain_eye(eye, looks, stations=()):
    side = len(eye.sharpness)
    return {
        "axes": (np.linspace(-1.0, 1.0, side), np.linspace(0.0, 1.0, side)),
        "sharp": eye.sharpness,
        "open": eye.visible_fraction,
        "astray": eye.displacement,
        "told": eye.reduction,
        "sharpest": eye.max_sharpness,
        "pixel": eye.pixel,
        "longest": eye.max_range,
        "half_field_deg": np.degrees(np.arctan(eye.half_field)),
        "gimbal_deg": np.degrees(eye.gimbal_limit),
        "highest": looks.highest,
        "lowest": looks.lowest,
        "sun_azimuth": np.arctan2(*eye.sun),
        "stations": stations,
    }


@pytest.mark.parametrize("change", [
    {}, {"half_field": 0.05}, {"gimbal_limit": np.radians(20.0)}, {"max_range": 150.0},
])  # fmt: skip
def test_the_kernel_is_given_what_the_lander_and_its_sensors_are(asked, change):
    """Scores of the paper's lander and camera are those of looks taken one by one."""
    _, problem, eye = asked
    looks, max_final_tilt = MeasurementAltitudes(highest=300.0, lowest=60.0), 0.4
    eye = replace(eye, **change)
    one = planner(eye, looks, max_final_tilt=max_final_tilt)
    plans = one.sample_plans(problem, 47.0, 60)
    lander, limits = problem.lander, problem.limits
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    assert margin > 0.0
    vehicle = (
        problem.gravity, problem.estimate.mass, lander.exhaust_velocity,
        lander.thrust_min + margin, lander.thrust_max - margin, np.tan(limits.max_tilt),
        np.tan(limits.glideslope), np.tan(limits.max_tilt),
    )  # fmt: skip
    found = limits.params(problem.estimate.mass, lander, problem.gravity)
    np.testing.assert_allclose(found, vehicle)
    names = ("weight", "known", "needs")
    nodes = [
        {"at": row[:3]} | dict(zip(names, row[3:], strict=True)) for row in problem.nodes
    ]  # fmt: skip
    wanted = plain.score(
        problem.estimate.position, problem.estimate.velocity, problem.end.position,
        problem.end.velocity, plans, (24, 24), vehicle, max_final_tilt,
        (problem.site, problem.com_height, problem.min_altitude), nodes, [plain_eye(eye, looks)],
    )  # fmt: skip
    found = one.score(problem, plans)
    good = np.isfinite(wanted[:, 1])
    assert 3 < good.sum() < len(plans)
    np.testing.assert_array_equal(np.isfinite(found[:, 1]), good)
    np.testing.assert_allclose(found[good], wanted[good], rtol=1e-6)


def test_paths_turn_with_the_way_there(asked):
    _, problem, eye = asked
    one, angle = planner(eye), 0.7
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    here = problem.estimate
    turned = replace(
        problem, estimate=replace(here, position=turn @ here.position),
        end=replace(problem.end, position=turn @ problem.end.position),
    )  # fmt: skip
    before, after = one.sample_plans(problem, 47.0, 50), one.sample_plans(turned, 47.0, 50)
    np.testing.assert_allclose(after[:, 0], before[:, 0])
    np.testing.assert_allclose(after[:, 1:], before[:, 1:] @ turn.T, atol=1e-9)


def test_the_second_search_finds_what_is_better_than_the_best_of_the_first(asked):
    _, problem, eye = asked
    one = planner(eye)
    first = worth(one, problem, one.sample_plans(problem, 47.0, 400)).max()
    plan = one.best(problem, 47.0, MOST, None)
    assert plan.known_fraction - PRICE * plan.propellant > first + 1e-3


def test_what_is_flown_stays_unless_another_is_better(asked):
    _, problem, eye = asked
    flown = planner(eye, candidates=9000).best(problem, 47.0, MOST, None)
    few = planner(eye, candidates=30)
    alone = few.best(problem, 47.0, MOST, None)
    kept = few.best(problem, 47.0, MOST, flown)
    value = [p.known_fraction - PRICE * p.propellant for p in (alone, flown, kept)]
    assert value[0] < value[1] - 1e-3
    assert value[2] >= value[1] - 1e-12
    assert isinstance(kept, PathPlan)


def test_observations_that_are_past_count_no_more(asked):
    _, problem, eye = asked
    one = planner(eye, MeasurementAltitudes(at=(300.0, 120.0)))
    plans = one.sample_plans(problem, 47.0, 400)
    known = {}
    for passed in (np.inf, 200.0, 100.0):
        scored = one.score(replace(problem, lowest_altitude=passed), plans)
        known[passed] = scored[np.isfinite(scored[:, 1]), 0].max()
    nothing = planner(eye, MeasurementAltitudes(at=(1e5,))).score(problem, plans)
    assert known[np.inf] >= known[200.0] > known[100.0] + 0.05
    assert known[100.0] == pytest.approx(nothing[np.isfinite(nothing[:, 1]), 0].max(), abs=1e-9)


@pytest.mark.parametrize("mass, by_tilt", [(None, False), (150.0, True)])
def test_terrain_far_off_needs_time_to_be_flown_to(asked, paper, mass, by_tilt):
    law, first, _ = asked
    here = replace(first.estimate, mass=mass or first.estimate.mass)
    problem = law.problem(here, first.end, first.site)
    decisions, limits, lander = paper.decisions, problem.limits, problem.lander
    away = np.hypot(*(problem.nodes[:, :2] - problem.site[:2]).T)
    margin = limits.throttle_margin * (lander.thrust_max - lander.thrust_min)
    spare = np.sqrt(((lander.thrust_max - margin) / here.mass) ** 2 - problem.gravity**2)
    leaning = problem.gravity * np.tan(limits.max_tilt)
    assert (leaning < spare) == by_tilt
    needs = np.sqrt(6.0 * away / min(spare, leaning)) + 1.0 + decisions.interval
    np.testing.assert_allclose(problem.nodes[:, 5], needs)


def test_what_has_been_burnt_is_not_allowed_again(paper, asked):
    """The first plan fixes the budget: what was spent since comes off it."""
    law, _ = at_start(paper, propellant_weight=0.0, propellant_allowance=0.4)
    _, problem, _ = asked
    law.command(problem.estimate, problem.end, 0.0, 47.0)
    first = law.plan.propellant
    lighter = replace(problem.estimate, mass=problem.estimate.mass - 0.35)
    law.command(lighter, problem.end, 2.0, 45.0)
    assert law.plan.propellant < first - 0.15


def test_what_was_passed_stays_passed_and_the_way_down_is_chosen_once(paper, asked):
    law, _ = at_start(paper)
    _, problem, _ = asked
    here, end = problem.estimate, problem.end
    law.command(here, end, 0.0, 47.0)
    low = replace(here, position=here.position - [0.0, 0.0, 50.0])
    law.command(low, end, 0.1, 47.0)
    law.command(here, end, 0.2, 47.0)  # up again
    passed = law.problem(here, end, problem.site).lowest_altitude
    assert passed == pytest.approx(low.position[2] - problem.site[2] - problem.com_height)
    near = replace(
        here, position=end.position + [6.0, 3.0, 36.0], velocity=np.array([-1.0, 0.5, -7.0]),
        mass=195.0,
    )  # fmt: skip
    for k in range(40):
        law.command(near, end, 30.0 + 0.1 * k, 9.0)
    over = [e for e in law.events if e[1] == "observation-phase-ended"]
    assert len(over) == 1
    limits = replace(law.limits, max_tilt=over[0][2]["tilt"])
    one = replace(end, position=end.position[None, :])
    hasty = divert_cost(near, one, problem.lander, problem.gravity, limits=limits).time_to_go[0]
    assert over[0][2]["time_to_go"] > 1.2 * hasty


def test_in_the_last_seconds_no_plan_is_made(paper, asked):
    law, _ = at_start(paper)
    _, problem, _ = asked
    law.command(problem.estimate, problem.end, 0.0, 47.0)
    told, late = len(law.events), law.arrival - 5.0
    law.command(problem.estimate, problem.end, late, 5.0)
    assert len(law.events) == told
    law.command(problem.estimate, problem.end, law.arrival - 7.0, 7.0)
    assert len(law.events) == told + 1


def test_the_footprint_is_that_of_the_pads(paper):
    lander = paper.lander
    assert footprint_radius(paper.briefing) == lander.leg_radius + 0.5 * lander.pad_diameter
    assert InformationSeekingLaw().min_rock_diameter == 0.5
