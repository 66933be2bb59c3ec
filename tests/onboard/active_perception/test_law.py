"""The law that looks where it lands: what it asks of a lander, and what it does in flight."""

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.active_perception.guidance import InformationSeekingLaw
from lunarsim.onboard.guidance.contract import PlansArrival, UsesHazardMap
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.tasking.contract import MeasurementAltitudes
from lunarsim.onboard.tasking.schedules import AtAltitudes, Periodic, Sweep
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.onboard.active_perception.conftest import QUICK, at_start
from tests.worlds import SMALL_FLIGHT


def seeing(**tables) -> Scenario:
    small = Scenario.from_dict(SMALL_FLIGHT)
    return small.changed(guidance=QUICK, **tables)


def test_it_plans_over_the_site_and_pays_for_it(paper):
    free, asked = at_start(paper)
    cheap, _ = at_start(paper, propellant_allowance=0.0)
    for law in (free, cheap):
        assert isinstance(law, PlansArrival)
        assert isinstance(law, UsesHazardMap)
        assert np.isfinite(law.command(*asked, 0.0, 47.0)).all()
    assert free.plan.known_fraction > cheap.plan.known_fraction + 0.03
    assert cheap.plan.propellant < free.plan.propellant < cheap.plan.propellant + 1.5
    assert free.arrival == pytest.approx(free.plan.time_to_go + 0.3)
    assert free.events[-1][1] == "guidance-planned"


def test_knowledge_that_costs_too_much_is_not_bought(paper):
    dear, asked = at_start(paper, propellant_weight=0.5)
    free, _ = at_start(paper, propellant_weight=0.0)
    for law in (dear, free):
        law.command(*asked, 0.0, 47.0)
    assert dear.plan.propellant < free.plan.propellant - 0.2
    assert dear.plan.known_fraction < free.plan.known_fraction


def test_terrain_that_is_known_is_not_looked_at_again(paper):
    law, asked = at_start(paper)
    unknown, _ = at_start(paper)
    grid = Grid.centred(np.zeros(2), 60.0, 1.0)
    sure = np.full(grid.shape, 1.0 - 1e-9, np.float32)
    law.hazard_map_source = lambda: HazardMap(grid, sure, np.ones(grid.shape, bool))
    for one in (law, unknown):
        one.command(*asked, 0.0, 47.0)
    assert law.plan.known_fraction > 0.99
    # There is nothing left to see: the cheapest path is taken.
    assert law.plan.propellant < unknown.plan.propellant


def test_without_a_map_or_a_path_it_flies_as_the_computer_wants(paper):
    for change, why in (
        ({"hazard_map_source": lambda: None}, "no map"),
        ({}, "no admissible path"),
    ):
        law, asked = at_start(paper)
        for name, value in change.items():
            setattr(law, name, value)
        here, end = asked
        if not change:
            here = replace(here, mass=paper.lander.dry_mass + 15.5)
        for k in range(30):
            law.command(here, end, 0.1 * k, 47.0 - 0.1 * k)
        fallen = [e for e in law.events if e[1] == "guidance-fallback"]
        assert [e[2]["reason"] for e in fallen] == [why]
        assert law.plan is None
        assert law.arrival == pytest.approx(47.0)


def test_a_divert_is_planned_at_once(paper):
    law, (here, end) = at_start(paper)
    law.command(here, end, 0.0, 47.0)
    plans = len(law.events)
    law.command(here, end, 0.1, 47.0)
    assert len(law.events) == plans
    law.command(here, replace(end, position=end.position + [15.0, 5.0, 0.0]), 0.2, 46.0)
    assert len(law.events) == plans + 1


def test_below_the_last_decision_it_goes_down_upright(paper):
    law, (here, end) = at_start(paper)
    low = replace(
        here, position=end.position + [6.0, 3.0, 36.0], velocity=np.array([-1.0, 0.5, -7.0]),
        mass=195.0,
    )  # fmt: skip
    law.command(low, end, 0.0, 9.0)
    assert law.plan is None
    assert [e[1] for e in law.events] == ["observation-phase-ended"]
    wanted = law.command(low, end, 0.1, 9.0)
    assert np.hypot(*wanted[:2]) < np.tan(np.radians(26.0)) * wanted[2]


def test_what_hovering_down_upright_would_cost_is_not_paid(paper):
    """After a late divert the path of the least lean hovers for half a minute."""
    law, (here, end) = at_start(paper)
    end = replace(end, position=end.position + [-2.4, -0.6, 0.0])
    low = replace(
        here, position=end.position + [-14.2, -20.7, 33.4], velocity=np.array([5.2, 5.6, -8.1]),
        mass=193.6,
    )  # fmt: skip
    law.command(low, end, 42.8, 9.6)
    assert [e[1] for e in law.events] == ["observation-phase-ended"]
    assert law.events[0][2]["time_to_go"] < 25.0


def test_it_does_not_hover_over_the_height_of_its_end(paper):
    """The only paths that lean by less than 25 deg come down beside their end, and hover there."""
    law, (here, end) = at_start(paper)
    law.command(here, end, 0.0, 47.0)
    planned, arrival = list(law.events), law.arrival
    low = replace(
        here, position=end.position + [-11.2, 1.2, 20.6], velocity=np.array([5.6, -0.2, -7.6]),
        mass=195.0,
    )  # fmt: skip
    law.command(low, end, 0.1, 6.4)
    assert (law.events, law.arrival) == (planned, arrival)
    assert law.plan is not None


def test_a_divert_without_an_admissible_path_is_flown_as_the_computer_wants(paper):
    """The plan was made for another end: what it asks for there is not asked for here."""
    law, (here, end) = at_start(paper)
    law.command(here, end, 0.0, 47.0)
    assert law.plan is not None
    assert np.linalg.norm(law.plan.acceleration) > 0.1
    law.hazard_map_source = lambda: None
    law.command(here, replace(end, position=end.position + [15.0, 5.0, 0.0]), 0.1, 44.0)
    assert law.plan is None
    assert law.arrival == pytest.approx(44.1)


@pytest.mark.parametrize("which", ["position", "velocity", "mass", "end", "time"])
def test_what_is_not_finite_is_refused(paper, which):
    law, (here, end) = at_start(paper)
    left = 47.0
    if which == "time":
        left = np.nan
    elif which == "end":
        end = replace(end, position=np.array([np.nan, 0.0, 0.0]))
    else:
        here = replace(here, **{which: np.nan if which == "mass" else np.full(3, np.inf)})
    with pytest.raises(InputError):
        law.command(here, end, 0.0, left)


@pytest.mark.parametrize(
    "key, value",
    [("interval_s", 0.0), ("candidates", 3), ("nodes_per_side", 1), ("propellant_allowance_kg",
    -1.0),
     ("propellant_weight", -0.1), ("min_rock_diameter_m", 0.0), ("max_final_tilt_deg", 90.0),
     ("interval_s",
     np.nan)],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(key, value):
    with pytest.raises(InputError, match=f"guidance.{key}"):
        seeing().changed(guidance={key: value})


def test_a_lander_that_sees_nothing_is_refused():
    blind = Scenario.from_dict({
        "name": "blind", "guidance": {"kind": "information-seeking"}, "sensors": {
            "imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix"}},
        "mappers": {}, "tasking": {},
    })  # fmt: skip
    with pytest.raises(InputError, match=r"guidance\.kind.*camera or LiDAR"):
        Simulation(blind, 1)


def test_schedules_report_where_they_measure():
    assert Periodic(first_altitude=250.0).measurement_altitudes == MeasurementAltitudes(
        highest=250.0
    )
    assert AtAltitudes((300.0, 90.0)).measurement_altitudes == MeasurementAltitudes(
        at=(300.0, 90.0)
    )
    assert Sweep(last_altitude=20.0).measurement_altitudes == MeasurementAltitudes(lowest=20.0)


def test_a_flight_lands_and_repeats_bit_for_bit():
    ends = []
    for _ in range(2):
        simulation = Simulation(seeing(), 5, policy="safest")
        while not simulation.done:
            simulation.step()
        assert simulation.outcome.touchdown is not None
        assert simulation.outcome.safe
        planned = [e for e in simulation.computer.telemetry if e[1] == "guidance-planned"]
        assert len(planned) > 5
        ends.append(simulation.state.position)
    np.testing.assert_array_equal(*ends)


def test_it_is_chosen_by_one_line_and_builds_from_its_name():
    assert isinstance(seeing().guidance.make(), InformationSeekingLaw)
