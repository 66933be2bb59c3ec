"""What no law can fly: each flight ends with a verdict, its record says why, no command is NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.policies.contract import Decision
from lunarsim.parts import kinds, quantity
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.world.terrain import Heightfield
from lunarsim.world.terrain_models.interface import add_rocks

LAWS = [
    kind
    for kind in kinds("guidance", with_files=False)
    if kind not in {"neural-optimal", "information-seeking"}
]


@dataclass(frozen=True)
class Ridge:
    """Level ground with a ridge from south to north."""

    size: float = quantity(200.0, "m", gt=0)
    height: float = quantity(90.0, "m", ge=0)
    east: float = quantity(-60.0, "m")

    def build(self, rocks, streams):
        """Return the terrain of one flight."""
        grid = Grid.centred((0.0, 0.0), self.size, 1.0)
        wave = self.height * np.maximum(0.0, 1.0 - np.abs(grid.x - self.east) / 15.0)
        relief = Heightfield(grid, np.tile(wave, (grid.rows, 1)).astype(np.float32))
        return add_rocks(relief, rocks, streams)


def blind(law="apollo", **tables) -> Scenario:
    given = {
        "name": "odd",
        "simulation": {"cycle_s": 0.2},
        "terrain": {"size_m": 60.0, "posting_m": 1.0, "rms_slope_deg": 0.0},
        "rocks": {"cover": 0.0},
        "start": {"position_m": [-120.0, 0.0, 110.0], "velocity_m_s": [9.0, 0.0, -8.0]},
        "sensors": {"imu": {"kind": "imu"}, "fix": {"kind": "navigation-fix"}},
        "tasking": {},
        "mappers": {},
        "guidance": {"kind": law},
    }
    return Scenario.from_dict(given | tables)


def whole(flight) -> bool:
    """Tell whether everything in the trajectory is a number."""
    return all(np.isfinite(column).all() for column in flight.trajectory.values())


def names(flight) -> list[str]:
    return [event["name"] for event in flight.events]


@pytest.mark.parametrize("law", LAWS)
def test_diverts_that_cannot_be_are_refused_and_reported(law):
    simulation = Simulation(blind(law), 1, "no-divert")
    for _ in range(20):
        simulation.step()
    computer = simulation.computer
    above = computer.estimate.position + [30.0, 0.0, 40.0]
    behind = computer.estimate.position - [400.0, 0.0, 90.0]
    for site in (above, behind):
        assert not computer.apply(Decision(site, "try"))
        time, name, told = computer.telemetry[-1]
        assert (time, name, told["reason"]) == (computer.time, "divert-refused", "out of reach")
    with pytest.raises(InputError, match="decide must return"):
        computer.apply(Decision(np.array([np.nan, 0.0, 0.0]), "try"))
    flight = simulation.run()
    assert flight.outcome.touchdown is not None
    assert not flight.decisions
    assert names(flight).count("divert-refused") == 2


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("told", [True, False])
def test_tanks_that_run_empty_in_flight_end_in_a_crash_that_is_recorded(law, told):
    """Whether or not the computer's account of them is right."""
    simulation = Simulation(blind(law), 1, "no-divert")
    for _ in range(30):
        simulation.step()
    dry = simulation.plant.lander.dry_mass
    y = simulation.plant.state.as_vector()
    y[13] = dry + 0.5
    simulation.plant.state = type(simulation.plant.state).from_vector(y)
    if told:
        simulation.computer.mass_estimator.mass = dry + 0.5
    flight = simulation.run()
    assert whole(flight)
    assert "vertical-speed" in flight.outcome.failure_causes
    assert flight.trajectory["mass"][-1] == pytest.approx(dry)
    assert names(flight).count("tanks-empty") == told


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("left", [1.0, 3.0])
def test_a_time_too_short_to_be_kept_ends_in_an_outcome(law, left):
    flight = Simulation(blind(law, approach={"time_to_go_s": left}), 1, "no-divert").run()
    assert whole(flight)
    # The optimal law takes the time that it needs; others may hover and approach again.
    if flight.outcome.safe:
        assert law == "optimal" or "hover" in names(flight)
    else:
        assert flight.outcome.failure_causes


def test_a_time_under_a_step_of_control_is_refused():
    with pytest.raises(InputError) as refused:
        blind(approach={"time_to_go_s": 0.05})
    assert refused.value.field == "approach.time_to_go_s"


@pytest.mark.parametrize("law", LAWS)
def test_a_ridge_in_the_way_is_met(law, monkeypatch):
    monkeypatch.setenv("LUNARSIM_ALLOW_MODULES", __name__)
    ground = {"kind": f"{__name__}:Ridge"}
    flight = Simulation(blind(law, terrain=ground), 1, "no-divert").run()
    assert whole(flight)
    assert {"slope", "vertical-speed"} & set(flight.outcome.failure_causes)
    assert abs(flight.positions[-1, 0] + 60.0) < 20.0


def test_a_start_below_its_target_is_refused():
    with pytest.raises(InputError) as refused:
        Simulation(blind(start={"position_m": [-120.0, 0.0, 4.0]}), 1, "no-divert")
    assert refused.value.field == "start.position_m[2]"


@pytest.mark.parametrize(
    ("changes", "field", "value"),
    [
        ({"approach": {"glideslope_deg": 75.0}}, "approach.glideslope_deg", 75.0),
        ({"approach": {"max_tilt_deg": 2.0}}, "approach.max_tilt_deg", 2.0),
        ({"approach": {"reserve_kg": 370.0}}, "approach.reserve_kg", 370.0),
        ({"approach": {"throttle_margin": 0.49}}, "approach.throttle_margin", 0.49),
        (
            {"approach": {"arrival_acceleration_m_s2": [40.0, 0.0, 0.0]}},
            "approach.arrival_acceleration_m_s2", (40.0, 0.0, 0.0),
        ),
        ({"approach": {"vertical_altitude_m": 900.0}}, "approach.vertical_altitude_m", 900.0),
        # An end so near below the start that no path leads there.
        (
            {
                "start": {"position_m": [-300.0, 0.0, 105.0], "velocity_m_s": [20.0, 0.0, -10.0]},
                "approach": {"vertical_altitude_m": 100.0, "glideslope_deg": 0.0},
            },
            "approach.vertical_altitude_m", 100.0,
        ),
        # A jerk needs a velocity over ground: both are relaxed together, and are not the cause.
        (
            {
                "approach": {"jerk_m_s3": 0.001, "arrival_velocity_m_s": [1.0, 0.0]},
                "start": {"velocity_m_s": [400.0, 0.0, -18.0]},
            },
            "start.velocity_m_s", (400.0, 0.0, -18.0),
        ),
        (
            {"approach": {"jerk_m_s3": 0.001, "arrival_velocity_m_s": [300.0, 0.0]}},
            "approach.arrival_velocity_m_s", (300.0, 0.0),
        ),
        # Two at once, neither alone at fault: the start is named.
        ({"approach": {"glideslope_deg": 75.0, "reserve_kg": 370.0}}, "start.position_m", None),
        ({"start": {"velocity_m_s": [400.0, 0.0, -18.0]}}, "start.velocity_m_s", None),
        ({"start": {"position_m": [-60000.0, 0.0, 500.0]}}, "start.position_m", None),
        # Lower than any approach ends by default: no end of it is at fault.
        ({"start": {"position_m": [-60.0, 0.0, 11.0], "velocity_m_s": [4.0, 0.0, -1.0]}},
         "start.position_m", None),
        # Fields at their defaults are named as well.
        (
            {"start": {"position_m": [-600.0, 0.0, 90.0], "velocity_m_s": [20.0, 0.0, -4.0]}},
            "approach.glideslope_deg", 8.0,
        ),
        ({"vehicle": {"thrust_min_n": 1780.0, "thrust_max_n": 9000.0}},
         "approach.throttle_margin", 0.08),
        ({"vehicle": {"thrust_max_n": 2600.0}}, "vehicle.thrust_max_n", 2600.0),
        ({"vehicle": {"propellant_mass_kg": 30.0}}, "vehicle.propellant_mass_kg", 30.0),
        ({"vehicle": {"propellant_mass_kg": 1.0}}, "vehicle.propellant_mass_kg", 1.0),
    ],
)  # fmt: skip
def test_what_leaves_no_path_is_named(changes, field, value):
    with pytest.raises(InputError) as refused:
        Simulation(Scenario.from_dict(changes), 1, "no-divert")
    assert refused.value.field == field
    if value is not None:
        assert refused.value.value == pytest.approx(value)


def test_what_thrusters_burn_is_taken_from_the_dry_mass():
    """Their tanks are full at the dry mass: below it by what they spent, the engine's are empty."""
    jets = {"vehicle": {"kind": "jet-lander"}, "control": {"kind": "phase-plane"}}
    simulation = Simulation(blind(**jets), 1, "no-divert")
    for _ in range(30):
        simulation.step()
    computer = simulation.computer
    loop, dry = computer.attitude_loop, computer.lander.dry_mass
    computer.mass_estimator.mass = dry + 0.3
    loop.propellant_used += 4.0
    simulation.step()
    assert dry - loop.propellant_used < computer.mass < dry - 3.0
    assert "tanks-empty" not in [name for _, name, _ in computer.telemetry]
    computer.mass_estimator.mass = dry - loop.propellant_used + 0.05
    for _ in range(4):
        simulation.step()
    assert computer.mass == pytest.approx(dry - loop.propellant_used, abs=1e-2)
    assert [name for _, name, _ in computer.telemetry].count("tanks-empty") == 1


def test_thrusters_without_propellant_are_recorded_from_the_start():
    jets = {
        "vehicle": {"kind": "jet-lander", "thrusters": {"propellant_kg": 0.0}},
        "control": {"kind": "phase-plane"},
    }
    flight = Simulation(blind(**jets), 1, "no-divert").run()
    assert whole(flight)
    empty = [e for e in flight.events if e["name"] == "thruster-tanks-empty"]
    assert [e["time"] for e in empty] == [pytest.approx(0.0, abs=0.2)]
    assert flight.events[-1]["thruster_propellant_kg"] == 0.0
    assert not flight.outcome.safe


@pytest.mark.parametrize("stuck", [None, 0.0, 3000.0])
@pytest.mark.parametrize("law", ["pd", "ideal"])
def test_an_engine_that_sticks_on_a_lander_without_thrusters(law, stuck):
    faults = {"engine_stuck_from_s": 5.0}
    if stuck is not None:
        faults["engine_stuck_at_n"] = stuck
    plain, odd = (
        Simulation(blind(control={"kind": law}, **more), 1, "no-divert").run()
        for more in ({}, {"faults": faults})
    )
    assert plain.outcome.safe
    assert not odd.outcome.safe
    started = [event for event in odd.events if event["name"] == "fault-started"]
    assert started == [{"time": 5.0, "name": "fault-started", "fault": "throttle"}]
    time, thrust = odd.trajectory["time"], odd.trajectory["thrust"]
    late, held = time > 7.0, thrust[time > 7.0][0]
    assert thrust[late] == pytest.approx(held, rel=1e-3, abs=1e-3)
    before = plain.trajectory["thrust"][np.searchsorted(time, 4.95)]
    assert held == pytest.approx(before if stuck is None else stuck, rel=0.05, abs=1.0)
    same = time < 4.9
    assert np.array_equal(thrust[same], plain.trajectory["thrust"][: same.sum()])


@pytest.mark.parametrize("kind", ["lander", "jet-lander"])
def test_an_engine_stuck_from_the_start_runs_as_it_was_first_asked(kind):
    given = {"vehicle": {"kind": kind}, "faults": {"engine_stuck_from_s": 0.0}}
    if kind == "jet-lander":
        given["control"] = {"kind": "phase-plane"}
    sim = Simulation(blind(**given), 1, "no-divert")
    for _ in range(5):
        sim.step()
    asked = sim.plant.state.thrust
    assert asked > sim.lander.thrust_min
    for _ in range(30):
        sim.step()
    assert sim.plant.state.thrust == pytest.approx(asked, rel=0.02)


@pytest.mark.parametrize("thrust", [90.0, 9e4])
def test_no_engine_sticks_where_it_cannot_run(thrust):
    with pytest.raises(InputError) as refused:
        blind(
            vehicle={"kind": "jet-lander"}, control={"kind": "phase-plane"},
            faults={"engine_stuck_from_s": 1.0, "engine_stuck_at_n": thrust},
        )  # fmt: skip
    assert refused.value.field == "faults.engine_stuck_at_n"


@pytest.mark.parametrize(
    ("faults", "field"),
    [
        ({"jets_stuck_shut": [0]}, "faults.jets_stuck_shut"),
        ({"jets_stuck_open": [2]}, "faults.jets_stuck_open"),
        ({"engine_stuck_from_s": 1.0, "engine_stuck_at_n": 90.0}, "faults.engine_stuck_at_n"),
        ({"engine_stuck_from_s": 1.0, "engine_stuck_at_n": 9e4}, "faults.engine_stuck_at_n"),
    ],
)
def test_faults_that_a_lander_without_thrusters_cannot_have_are_refused(faults, field):
    with pytest.raises(InputError) as refused:
        blind(faults=faults)
    assert refused.value.field == field


def test_thrusters_that_run_out_are_recorded_once():
    jets = {
        "vehicle": {"kind": "jet-lander", "thrusters": {"propellant_kg": 0.05}},
        "control": {"kind": "phase-plane"},
    }
    simulation = Simulation(blind(**jets), 1, "no-divert")
    flight = simulation.run()
    assert whole(flight)
    assert names(flight).count("thruster-tanks-empty") == 1
    assert simulation.computer.attitude_loop.propellant_used > 0.05
    # What is ordered from then on is not burnt.
    assert simulation.computer.mass == pytest.approx(flight.trajectory["mass"][-1], abs=0.5)
