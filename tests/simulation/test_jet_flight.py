"""Flights with thrusters, gimbal and throttle; those without them stay what they were."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.models.lander import STANDARD_GRAVITY
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.recorder import MessageRecorder
from tests.worlds import SMALL_FLIGHT

JETS = {"kind": "jet-lander"}
PHASE_PLANE = {"kind": "phase-plane"}
# The last row of the small flight as the version without thrusters flew it, except for two changes:
# the map aligns scans (8 mm of height at the touchdown), and the horizontal command decreases to
# zero before the touchdown (6 mm to the side, 0.2 deg less tilt). Processors with and without
# AVX-512 differ in the last bits of NumPy's functions, which the closed loop amplifies to 2e-9
# rad/s.
UNCHANGED = {
    "time": 37.73000000000027, "position_x": -1.401241903605592,
    "position_y": 10.413810273847444, "position_z": 1.6528772982407336,
    "velocity_x": -0.03356434419995572, "velocity_z": -2.013877382018815,
    "attitude_x": -0.0011909172105581329, "attitude_w": 0.9999987244859561,
    "rate_y": -0.006688558978332392, "mass": 1458.732576517074,
    "thrust": 2358.975342209773, "estimated_x": 10.801697743949275,
}  # fmt: skip


@pytest.fixture(scope="module")
def small():
    return Scenario.from_dict(SMALL_FLIGHT).changed(simulation={"cycle_s": 0.1})


def flown(scenario, seed=3, tap=None, **tables):
    simulation = Simulation(scenario.changed(**tables), seed, "no-divert", tap=tap)
    return simulation, simulation.run()


@pytest.fixture(scope="module")
def landed(small):
    tap = MessageRecorder()
    return *flown(small, vehicle=JETS, control={"kind": "phase-plane"}, tap=tap), tap


def test_a_flight_without_thrusters_is_what_it_was(small):
    """The compiled kernel must give the recorded values, whatever thrusters other landers have."""
    flight = Simulation(small, 3, "no-divert").run()
    last = {name: float(column[-1]) for name, column in flight.trajectory.items()}
    for name, value in UNCHANGED.items():
        assert last[name] == pytest.approx(value, rel=1e-9, abs=2e-8), name
    assert "faults" not in flight.scenario
    assert "engine" not in flight.scenario
    assert set(flight.events[-1]) == {"time", "name", "failure_causes"}


def test_thrusters_land_it(landed):
    simulation, flight, _ = landed
    touchdown = flight.outcome.touchdown
    assert touchdown.vertical_speed == pytest.approx(2.0, abs=0.3)
    assert touchdown.horizontal_speed < 0.6
    assert np.hypot(*(simulation.estimate.position - simulation.site)[:2]) < 2.0


def test_a_thruster_fault_that_does_not_occur_changes_no_bit(small):
    tables = {"vehicle": JETS, "control": PHASE_PLANE, "simulation": {"max_time_s": 1.0}}
    stuck = {"jets_stuck_open": [0]}
    plain, with_fault, absent = (
        flown(small, **tables, **more)[1].trajectory
        for more in ({}, {"faults": stuck}, {"faults": stuck | {"occurs": False}})
    )
    assert not np.array_equal(with_fault["rate_x"], plain["rate_x"])
    for name, column in plain.items():
        assert np.array_equal(absent[name], column), name


def test_every_kilogramme_is_counted(landed):
    simulation, flight, _ = landed
    actuators, thrusters = simulation.plant.actuators, simulation.lander.thrusters
    last = flight.events[-1]
    assert last["thruster_propellant_kg"] == actuators.spent
    by_time = sum(last["thruster_on_time_s"]) * 60.0 / (290.0 * STANDARD_GRAVITY)
    assert last["thruster_propellant_kg"] == pytest.approx(by_time, rel=1e-9)
    assert 0.2 < actuators.spent < 5.0
    assert sum(last["thruster_firings"]) > 100
    # What the engine burnt, by its thrust row by row, and what the thrusters did, is all.
    rows = flight.trajectory
    thrust = 0.5 * (rows["thrust"][1:] + rows["thrust"][:-1])
    engine = float(thrust @ np.diff(rows["time"])) / simulation.lander.exhaust_velocity
    assert flight.propellant_used == pytest.approx(engine + actuators.spent, rel=3e-3)
    # The computer counts by its orders: right but for what touchdown cut short.
    assert simulation.computer.mass == pytest.approx(simulation.state.mass, abs=0.3)
    assert simulation.computer.attitude_loop.propellant_used == pytest.approx(
        actuators.spent, abs=0.02
    )
    assert thrusters.count == len(last["thruster_on_time_s"])


def test_the_record_is_saved_and_read_again(landed, tmp_path):
    _, flight, _ = landed
    again = type(flight).load(flight.save(tmp_path))
    assert again.events[-1] == flight.events[-1]
    for name, column in flight.actuators.items():
        assert again.actuators[name].tobytes() == column.tobytes()


def test_recorded_on_times_add_up_to_those_of_the_valves(landed):
    simulation, flight, _ = landed
    table, count = flight.actuators, simulation.lander.thrusters.count
    period = simulation.computer.attitude_loop.period
    assert np.diff(table["time"]) == pytest.approx(period)
    assert table["time"][-1] <= flight.duration
    on_times = np.column_stack([table[f"on_time_{k}"] for k in range(count)])
    assert f"on_time_{count}" not in table
    # The last command is cut off by the touchdown, and simulated to the end of its cycle.
    fired = np.minimum(on_times, period).sum(axis=0)
    assert fired == pytest.approx(simulation.plant.actuators.on_time, abs=2 * period)
    assert fired.sum() > 1.0
    # The gimbal follows its command at a limited rate.
    command, angle = (
        np.column_stack([table[f"{name}_{a}"] for a in "xy"])
        for name in ("gimbal_command", "gimbal")
    )
    step = np.abs(np.diff(angle, axis=0)).max()
    assert 0.0 < step <= simulation.lander.engine.gimbal_rate * period * (1.0 + 1e-9)
    assert np.abs(command).max() <= simulation.lander.engine.gimbal_limit
    assert np.abs(angle - command)[-50:].max() < np.abs(command).max()


def test_the_same_seed_fires_the_same_bits(small, landed):
    _, flight, _ = landed
    _, again = flown(small, vehicle=JETS, control={"kind": "phase-plane"})
    for name, column in flight.trajectory.items():
        assert column.tobytes() == again.trajectory[name].tobytes()


def test_torques_of_the_loop_are_those_of_its_firings(landed):
    simulation, _, tap = landed
    _, _, torques = tap.exchanges[50]
    assert torques.shape == (10, 3)
    assert np.all(torques == torques[0])
    most = np.array(simulation.lander.torque_max)
    assert all(np.all(np.abs(t) <= most + 1e-9) for _, _, t in tap.exchanges)


def test_an_engine_that_sticks_open_does_not_land(small):
    _, flight = flown(
        small, vehicle=JETS, control={"kind": "quaternion-feedback"},
        simulation={"max_time_s": 60.0},
        faults={"engine_stuck_from_s": 10.0, "engine_stuck_at_n": 6000.0},
    )  # fmt: skip
    late = flight.trajectory["time"] > 12.0
    assert flight.trajectory["thrust"][late] == pytest.approx(6000.0)
    assert not flight.outcome.safe


def test_on_legs_the_motion_gives_the_outcome(small, tmp_path):
    simulation, flight = flown(small, legs={"friction": 0.6})
    rest, last = simulation.plant.rest, flight.events[-1]
    assert rest.settled
    assert flight.outcome.safe == (not flight.outcome.failure_causes)
    assert flight.outcome.touchdown.vertical_speed == pytest.approx(2.0, abs=0.3)
    assert last["leg_energy_j"] == rest.energy > 2000.0
    assert last["rest_tilt_deg"] == pytest.approx(np.rad2deg(rest.tilt))
    assert type(flight).load(flight.save(tmp_path)).events[-1] == last
    with pytest.raises(InputError, match="crush_force_n"):
        small.changed(legs={"crush_force_n": -1.0})


@pytest.mark.parametrize(
    ("tables", "field"),
    [
        ({"vehicle": JETS, "control": {"kind": "ideal"}}, "control.kind"),
        ({"control": {"kind": "phase-plane"}}, "control.kind"),
        ({"faults": {"jets_stuck_shut": [1]}}, "faults.jets_stuck_shut"),
        (
            {"vehicle": JETS, "control": PHASE_PLANE, "faults": {"jets_stuck_shut": [16]}},
            "faults.jets_stuck_shut",
        ),
        ({"vehicle": JETS, "control": PHASE_PLANE | {"period_s": 0.105}}, "control.period_s"),
        ({"vehicle": JETS}, "control.frequency_rad_s"),
        (
            {
                "vehicle": JETS | {"thrusters": {"min_on_time_s": 0.2}},
                "control": {"kind": "phase-plane"},
            },
            "vehicle.thrusters.min_on_time_s",
        ),
    ],
)  # fmt: skip
def test_parts_that_do_not_go_together_are_refused(small, tables, field):
    with pytest.raises(InputError) as refused:
        small.changed(**tables)
    assert refused.value.field == field


def test_a_dead_thruster_is_noticed_and_left_alone(small, landed):
    assert not [e for e in landed[1].events if e["name"] == "thruster-failed"]
    simulation, flight = flown(
        small,
        vehicle=JETS,
        control=PHASE_PLANE,
        faults={"jets_stuck_shut": [1], "jets_stuck_from_s": 5.0},
    )
    told = [e for e in flight.events if e["name"] == "thruster-failed"]
    assert [e["thruster"] for e in told] == [1]
    assert 5.0 < told[0]["time"] < 30.0
    loop = simulation.computer.attitude_loop
    assert loop.on_times[1] == 0.0
    times = loop.allocation.on_times(np.array([20.0, -30.0, 10.0]), 0.1)
    assert times[1] == 0.0
    assert flight.outcome.safe
