"""Phases chosen by the scenario: braking before the approach, other laws after it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.phases import Phase
from lunarsim.onboard.policies.contract import Decision
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import SCENARIOS


@pytest.fixture
def blind() -> Scenario:
    """A lander without maps over level ground."""
    return Scenario.from_dict(
        {
            "name": "blind",
            "simulation": {"cycle_s": 0.2},
            "terrain": {"size_m": 80.0, "posting_m": 1.0, "rms_slope_deg": 0.0},
            "rocks": {"cover": 0.0},
            "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix"}},
            "tasking": {},
            "mappers": {},
            "vehicle": {"propellant_mass_kg": 600.0},
        }
    )


def flown(scenario: Scenario, **tables):
    simulation = Simulation(scenario.changed(**tables), 3, "no-divert")
    return simulation, simulation.run()


def landed_well(simulation, flight, most=1.0):
    touchdown = flight.outcome.touchdown
    return (
        touchdown is not None
        and touchdown.horizontal_speed < 0.5
        and np.hypot(*(simulation.estimate.position - simulation.site)[:2]) < most
    )


@pytest.mark.parametrize(
    ("law", "jerk"), [("apollo", None), ("apollo", 0.02), ("e-guidance", None)]
)
def test_braking_hands_over_where_it_aims(blind, law, jerk):
    aim = {"end_position_m": [-500.0, 0.0, 420.0], "end_velocity_m_s": [25.0, 0.0, -16.0]}
    simulation, flight = flown(
        blind, braking=aim | {"law": law, "time_to_go_s": 60.0, "jerk_m_s3": jerk},
        start={"position_m": [-4500.0, 0.0, 2400.0], "velocity_m_s": [110.0, 0.0, -50.0]},
    )  # fmt: skip
    t = flight.trajectory
    phases = [int(p) for p in t["phase"]]
    assert sorted(set(phases)) == [0, 1, 3]
    assert phases == sorted(phases, key=[3, 0, 1].index)
    first = phases.index(0)
    # Two seconds before the end, in which it flies 50 m on.
    for name, value, within in (
        ("position_x", -500.0, 70.0), ("position_z", 420.0, 45.0), ("velocity_x", 25.0, 4.0),
        ("velocity_z", -16.0, 3.0),
    ):  # fmt: skip
        assert t[name][first] == pytest.approx(value, abs=within)
    assert landed_well(simulation, flight)
    assert "approach" in [e["name"] for e in flight.events]


def events(flight, *names):
    """Return the names of the events of these names, in their order."""
    return [event["name"] for event in flight.events if event["name"] in names]


DIVERTS = [(300.0, (60.0, 0.0, 0.0)), (150.0, (-40.0, 30.0, 0.0)), (80.0, (0.0, -25.0, 0.0))]
LANDER = Lander()
# The fixed time-to-go is too short to stop with this tilt: the lander passes its site at 10 m.
TOO_FAST = {"time_to_go_s": 34.0, "max_tilt_deg": 20.0}
WIDE = {"terrain": {"size_m": 800.0, "posting_m": 4.0, "rms_slope_deg": 0.0}}


@pytest.mark.parametrize("law", ["apollo", "e-guidance"])
def test_a_lander_that_passes_its_site_hovers_and_approaches_again(blind, law):
    simulation, flight = flown(blind, approach=TOO_FAST, guidance={"kind": law}, **WIDE)
    followed = events(flight, "hover", "approach", "vertical-descent")
    assert followed == ["hover", "approach", "vertical-descent"]
    assert next(e["distance"] for e in flight.events if e["name"] == "hover") > 10.0
    assert landed_well(simulation, flight, 1.5)
    hovering = flight.trajectory["phase"] == 4
    assert hovering.any()
    # It climbs above the glideslope of the second approach.
    assert flight.trajectory["position_z"][hovering].max() > 15.0


@pytest.mark.parametrize("law", ["optimal", "neural-optimal"])
def test_a_law_that_plans_its_arrival_plans_again_after_a_hover(blind, law):
    """The hover is forced at 20 m; the plan from before it is not followed."""
    simulation = Simulation(blind.changed(guidance={"kind": law}), 3, "no-divert")
    computer = simulation.computer
    while computer.altitude > 20.0:
        simulation.step()
    before = computer.guidance.arrival
    computer.phases.begin_hover(computer.status, computer.approach.end(computer.site, LANDER))
    flight = simulation.run()
    assert events(flight, "hover", "approach", "vertical-descent") == [
        "hover", "approach", "vertical-descent",
    ]  # fmt: skip
    assert computer.guidance.arrival > before + 5.0
    assert flight.outcome.touchdown.horizontal_speed < 0.5


@pytest.mark.parametrize(
    "approach",
    [
        {"takeover_altitude_m": 60.0}, {"arrival_offset_m": [15.0, 0.0]},
        {"arrival_velocity_m_s": [4.0, 0.0]}, {"end_time_to_go_s": 8.0},
    ],
    ids=lambda changes: next(iter(changes)),
)  # fmt: skip
def test_an_approach_that_is_planned_to_end_elsewhere_does_not_hover(blind, approach):
    _, flight = flown(blind, approach=approach, **WIDE)
    assert events(flight, "hover", "approach", "vertical-descent") == ["vertical-descent"]
    assert flight.outcome.touchdown.horizontal_speed < 0.6


def test_a_weak_lander_ends_its_approach_upright_and_on_its_site(blind):
    """E-guidance would end with 30 deg of tilt, which 20 N take 7 s to remove, over 19 m."""
    simulation, flight = flown(
        blind, guidance={"kind": "e-guidance"}, control={"kind": "phase-plane"},
        approach={"max_tilt_deg": 50.0}, **WIDE,
        vehicle={
            "kind": "jet-lander", "propellant_mass_kg": 300.0, "thrusters": {"force_n": 20.0},
        },
    )  # fmt: skip
    assert events(flight, "hover", "vertical-descent") == ["vertical-descent"]
    assert flight.outcome.safe
    assert landed_well(simulation, flight)
    begin = np.argmax(flight.trajectory["phase"] == Phase.VERTICAL)
    x, y = (flight.trajectory[f"attitude_{axis}"][begin] for axis in "xy")
    assert 1.0 - 2.0 * (x * x + y * y) > np.cos(np.deg2rad(6.0))


def test_the_tilt_limit_near_the_end_leaves_time_to_rotate_upright(blind):
    simulation = Simulation(blind, 3, "no-divert")
    evaluator = simulation.computer.site_evaluator
    slow = replace(evaluator.rotation_limits, torque=20.0)
    evaluator.rotation_limits = slow
    limits, mass = evaluator.path_limits, 1400.0
    assert evaluator.max_tilt(0.0, mass) == limits.max_final_tilt < limits.max_tilt
    for time in (1.0, 3.0):
        turn = evaluator.max_tilt(time, mass) - limits.max_final_tilt
        assert float(slow.time(turn, mass)) == pytest.approx(time)
    assert evaluator.max_tilt(60.0, mass) == limits.max_tilt


def test_a_time_scale_leaves_time_for_the_first_rotation(blind):
    """At 0.5 of the time-to-go, a strong lander has a path, but a weak one rotates too slowly."""
    simulation = Simulation(blind, 3, "no-divert")
    simulation.step()
    evaluator, attitude = simulation.computer.site_evaluator, np.array([0.0, -0.17, 0.0, 0.98])
    state = replace(
        simulation.estimate, position=np.array([-300.0, 0.0, 250.0]),
        velocity=np.array([20.0, 0.0, -15.0]), attitude=attitude / np.linalg.norm(attitude),
    )  # fmt: skip
    site = np.zeros(3)
    evaluator.rotation_limits = replace(evaluator.rotation_limits, torque=10.0)
    longer, _ = evaluator.time_to(site, state)
    one = site[None], state, np.array([0.5 * longer])
    assert evaluator.time_to(site, state, 0.5) == (longer, "beyond the limits")
    assert evaluator.time_to(site, state, 0.6) == (pytest.approx(0.6 * longer), "")
    evaluator.rotation_limits = replace(evaluator.rotation_limits, torque=600.0)
    assert evaluator.cost_of(*one).time_to_go[0] == 0.5 * longer


def test_without_the_propellant_for_a_second_approach_it_lands_where_it_hovers(blind):
    """The reserve leaves no path to the site; the vertical descent goes straight down."""
    simulation, flight = flown(blind, approach=TOO_FAST | {"reserve_kg": 545.0}, **WIDE)
    assert events(flight, "hover", "approach", "vertical-descent") == ["hover", "vertical-descent"]
    assert landed_well(simulation, flight, 1.5)
    assert np.hypot(*flight.outcome.touchdown.position[:2]) > 20.0


@pytest.mark.parametrize("propellant", [70.0, 90.0])
def test_a_hover_does_not_climb_if_it_cannot_pay_for_the_next_approach(blind, propellant):
    """The steep glideslope asks for 200 m of height; the tanks would run dry on the way."""
    _, flight = flown(
        blind, approach=TOO_FAST | {"glideslope_deg": 45.0, "reserve_kg": 0.0},
        vehicle={"propellant_mass_kg": propellant}, **WIDE,
    )  # fmt: skip
    assert events(flight, "hover", "approach", "vertical-descent") == ["hover", "vertical-descent"]
    assert flight.trajectory["position_z"][flight.trajectory["phase"] == 4].max() < 30.0
    assert flight.outcome.touchdown.vertical_speed < 2.5
    assert flight.outcome.touchdown.horizontal_speed < 0.5


def test_a_postponement_near_the_terrain_is_refused(blind):
    """A gust of the estimate at 15 m exceeds the limits; a longer path would climb again."""
    simulation = Simulation(blind, 3, "no-divert")
    computer = simulation.computer
    while computer.altitude > 15.0:
        simulation.step()
    arrival = computer.phases.arrival
    moved = replace(computer.estimate, position=computer.estimate.position + [12.0, 0.0, 0.0])
    computer.phases.extend(replace(computer.status, estimate=moved))
    assert computer.phases.arrival == arrival
    computer.phases.replan(replace(computer.status, estimate=moved))
    assert computer.phases.arrival == arrival
    time, name, details = computer.telemetry[-1]
    assert name == "postponement-refused"
    assert details["seconds"] > 5.0
    computer.phases.extend(replace(computer.status, estimate=moved, altitude=25.0))
    assert computer.phases.arrival > arrival + 5.0


@pytest.mark.parametrize(
    ("engine", "thrust_min"),
    [
        ({"continuous_min_n": 5500.0, "pulse_period_s": 0.1}, 200.0),
        ({"continuous_min_n": 4000.0, "pulse_period_s": 0.5, "min_pulse_s": 0.1}, 500.0),
    ],
    ids=["on-off", "throttles above 73 %"],
)
def test_engines_that_cannot_throttle_deeply_land(blind, engine, thrust_min):
    vehicle = {
        "kind": "jet-lander", "propellant_mass_kg": 300.0, "thrust_max_n": 5500.0,
        "thrust_min_n": thrust_min, "engine": engine,
    }  # fmt: skip
    simulation, flight = flown(blind, vehicle=vehicle, control={"kind": "phase-plane"})
    assert flight.outcome.safe
    assert landed_well(simulation, flight)


@pytest.mark.parametrize("force", [8.0, 12.0])
def test_a_lander_with_weak_thrusters_keeps_its_limits_after_diverts(blind, force):
    """Diverts at 300, 150 and 80 m; default thrusters have 60 N."""
    vehicle = {
        "kind": "jet-lander", "propellant_mass_kg": 400.0, "thrusters": {"force_n": force},
    }  # fmt: skip
    scenario = blind.changed(
        vehicle=vehicle, control={"kind": "phase-plane"},
        terrain={"size_m": 300.0, "posting_m": 2.0, "rms_slope_deg": 0.0},
    )  # fmt: skip
    simulation, diverts = Simulation(scenario, 3, "no-divert"), DIVERTS.copy()
    computer, tilts, rates = simulation.computer, [], []
    while not simulation.done:
        simulation.step()
        x, y = simulation.state.attitude[:2]
        tilts.append(np.arccos(1.0 - 2.0 * (x * x + y * y)))
        rates.append(np.abs(simulation.state.rate).max())
        if diverts and computer.altitude < diverts[0][0] and computer.phase == Phase.APPROACH:
            shift = np.array(diverts.pop(0)[1])
            computer.apply(Decision(site=computer.site + shift, reason="test"))
    assert not diverts
    assert simulation.outcome.safe
    assert np.rad2deg(max(tilts)) < 40.0 + 5.0
    assert np.rad2deg(max(rates)) < 10.0 + 0.5


def test_other_laws_bring_it_down(blind):
    pilot, flight = flown(
        blind, terminal_descent={"kind": "rate-of-descent"}, approach={"vertical_altitude_m": 30.0}
    )
    assert landed_well(pilot, flight, 2.0)
    assert pilot.computer.vertical.clicks >= 3
    turn, flight = flown(
        blind, terminal_descent={"kind": "gravity-turn", "final_speed_m_s": 1.5},
        approach={"vertical_altitude_m": 100.0, "vertical_speed_m_s": 8.0},
    )  # fmt: skip
    assert landed_well(turn, flight, 10.0)
    assert flight.outcome.touchdown.vertical_speed == pytest.approx(1.5, abs=0.2)


def test_without_the_tables_phases_are_what_they_were(blind):
    text = blind.to_toml()
    assert "[braking]" not in text
    assert "[terminal_descent]" not in text
    assert "[legs]" not in text
    existing = Scenario.load(SCENARIOS / "hirise.toml")
    assert existing.braking is existing.terminal_descent is existing.legs is existing.faults is None
    again = Scenario.from_toml(blind.changed(terminal_descent={"kind": "gravity-turn"}).to_toml())
    assert again.terminal_descent.kind == "gravity-turn"
    assert again.changed(terminal_descent=None).terminal_descent is None


def test_wrong_tables_are_refused(blind):
    for tables, field in (
        ({"terminal_descent": {"kind": "gravity-tern"}}, "terminal_descent.kind"),
        ({"terminal_descent": {}}, "terminal_descent.kind"),
        ({"braking": {"law": "apolo"}}, "braking.law"),
        ({"braking": {"end_time_to_go_s": 100.0}}, "braking.end_time_to_go_s"),
    ):
        with pytest.raises(InputError) as refused:
            blind.changed(**tables)
        assert refused.value.field == field
