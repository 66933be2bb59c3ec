"""What a lander does once navigation says that it is lost, and what its record tells of that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.evaluation.flight_metrics import evaluate
from lunarsim.frames import quat_from_rotation_vector, quat_multiply
from lunarsim.messages.measurements import AttitudeReading, DopplerReading, NavigationFix
from lunarsim.onboard.navigation.navigation_kinds import FixNavigation
from lunarsim.onboard.policies import Decision
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.flight import Flight
from tests.conftest import SCENARIOS

# A flight over this ground that diverts by more than a metre when nothing fails.
SEED = 2


@pytest.fixture
def small_scenario(small_scenario) -> Scenario:
    """The small scenario with control cycles of the default length."""
    return small_scenario.changed(simulation={"cycle_s": 0.1})


@pytest.fixture(scope="module")
def instruments() -> Scenario:
    """Own instruments and a coarse map."""
    return Scenario.load(SCENARIOS / "instruments.toml").changed(
        terrain={"size_m": 240.0}, initial_uncertainty={"position_m": 10.0},
        sensors={"flash": {"rows": 64, "cols": 64}},
        mappers={"dem": {"posting_m": 0.4, "size_m": 60.0}},
    )  # fmt: skip


def faulty(simulation: Simulation, kind: type, change, begins: float, ends: float = np.inf) -> None:
    """Let measurements of a kind be wrong for a while."""
    navigation = simulation.computer.navigation
    honest = navigation.take

    def take(sensor, measurement, time):
        wrong = isinstance(measurement, kind) and begins <= time < ends
        honest(sensor, change(measurement) if wrong else measurement, time)

    navigation.take = take


def one_beam_off(reading: DopplerReading) -> DopplerReading:
    return replace(reading, speed=reading.speed + np.array([0.5, 0.0, 0.0]))


def turned(reading: AttitudeReading) -> AttitudeReading:
    turn = quat_from_rotation_vector([np.deg2rad(0.5), 0.0, 0.0])
    return replace(reading, attitude=quat_multiply(reading.attitude, turn))


def no_fix(fix: NavigationFix) -> NavigationFix:
    return replace(fix, position=np.full(3, np.nan))


def names(flight: Flight) -> list[str]:
    return [event["name"] for event in flight.events]


def test_lost_before_a_map_it_lands_where_the_mission_said(instruments, tmp_path):
    late = instruments.changed(tasking={"flash": {"altitudes_m": [160.0]}})
    well = Simulation(late, SEED, "safest")
    while not well.computer.diverts:
        well.step()
    assert (well.flight().lost, well.flight().first_lost_time) == (False, None)
    assert "diverts-inhibited" not in names(well.flight())

    simulation = Simulation(late, SEED, "safest")
    faulty(simulation, AttitudeReading, turned, 2.0)
    flight = simulation.run()
    assert flight.decisions == []
    assert flight.lost
    assert 2.0 < flight.first_lost_time < 13.0
    assert names(flight).count("diverts-inhibited") == 1
    assert "diverts-enabled" not in names(flight)
    shift = simulation.computer.navigation.site_to_local
    # What is learnt of the site during the vertical descent does not move it.
    assert flight.sites[-1, :2] == pytest.approx(shift.to_local(flight.target)[:2], abs=0.5)

    again = Flight.load(flight.save(tmp_path / "flight"))
    assert (again.lost, again.first_lost_time) == (True, flight.first_lost_time)
    assert np.array_equal(again.trajectory["lost"], flight.trajectory["lost"])


def test_lost_after_a_divert_it_keeps_the_site_decided_on_last(instruments):
    simulation = Simulation(instruments, SEED, "safest")
    while not simulation.computer.diverts:
        simulation.step()
    site = simulation.site.copy()
    faulty(simulation, DopplerReading, one_beam_off, simulation.time)
    while not simulation.computer.diverts_inhibited:
        simulation.step()
    # Nobody gets a divert any more, whoever decides.
    decided = len(simulation.computer.diverts)
    assert not simulation.apply(Decision(site + [5.0, 0.0, 0.0], "elsewhere"))
    assert simulation.apply(Decision.keep("stay"))
    _, name, details = simulation.computer.telemetry[-1]
    assert (name, details["reason"]) == ("divert-refused", "navigation is lost")
    # Nor another time-to-go, there or elsewhere.
    left = simulation.computer.time_to_go
    assert simulation.apply(Decision(None, "later", time_scale=1.2))
    assert not simulation.apply(Decision(site + [5.0, 0.0, 0.0], "elsewhere", time_scale=1.2))
    told = [(name, d["reason"]) for _, name, d in simulation.computer.telemetry[-3:]]
    assert told[:2] == [("time-scale-refused", "navigation is lost")] * 2
    assert told[2] == ("divert-refused", "navigation is lost")
    assert simulation.computer.time_to_go == left
    last = simulation.site.copy()
    flight = simulation.run()
    assert len(simulation.computer.diverts) == decided
    assert flight.sites[-1, :2] == pytest.approx(last[:2])
    assert not [e for e in simulation.computer.telemetry if e[1] == "diverts-enabled"]


def test_trust_that_comes_back_allows_diverts_unless_something_was_mapped(small_scenario):
    scans = [
        event["time"] for event in Simulation(small_scenario, 4, "safest").run().events
        if event["name"] == "scan"
    ]  # fmt: skip
    often = small_scenario.changed(
        tasking={"flash": {"kind": "periodic", "rate_hz": 2.0, "first_altitude_m": 600.0}}
    )
    found = {}
    for name, scenario in (("before", small_scenario), ("during", often)):
        simulation = Simulation(scenario, 4, "safest")
        faulty(simulation, NavigationFix, no_fix, scans[0] - 4.0, scans[0] - 1.4)
        while not simulation.done and (name == "before" or simulation.time < scans[0] + 3.0):
            simulation.step()
        found[name] = simulation.flight()
    assert found["before"].first_lost_time < scans[0] - 1.0
    assert not found["before"].lost
    assert [n for n in names(found["before"]) if n.startswith("diverts")] == [
        "diverts-inhibited", "diverts-enabled",
    ]  # fmt: skip
    assert found["before"].decisions
    assert not found["during"].lost
    assert [n for n in names(found["during"]) if n.startswith("diverts")] == ["diverts-inhibited"]
    (barred,) = (e["time"] for e in found["during"].events if e["name"] == "diverts-inhibited")
    assert [d for d in found["during"].decisions if d["time"] >= barred] == []


@pytest.mark.parametrize(("ends", "said"), [(8.0, "recovered later"), (np.inf, "not recovered")])
def test_the_summary_says_so(small_scenario, tmp_path, monkeypatch, ends, said):
    path = tmp_path / "small.toml"
    small_scenario.save(path)
    honest = FixNavigation.take

    def take(self, sensor, measurement, time):
        dead = isinstance(measurement, NavigationFix) and 3.0 <= time < ends
        honest(self, sensor, no_fix(measurement) if dead else measurement, time)

    plain = CliRunner().invoke(main, ["fly", str(path)])
    monkeypatch.setattr(FixNavigation, "take", take)
    result = CliRunner().invoke(main, ["fly", str(path)])
    assert result.exit_code == 0, result.output
    assert "lost at" not in plain.output
    assert "lost at 5.0 s" in result.output or "lost at 4.9 s" in result.output
    assert said in result.output


@pytest.mark.parametrize("lost", [False, True])
def test_the_results_table_says_so(small_scenario, lost):
    simulation = Simulation(small_scenario, 3, "no-divert")
    faulty(simulation, NavigationFix, no_fix, 3.0 if lost else np.inf)
    while simulation.time < 6.0:
        simulation.step()
    assert evaluate(simulation.flight(), simulation.truth)["navigation_lost"] is lost


def test_an_estimate_too_inaccurate_to_land_counts_as_lost():
    """The lander starts so far off that its LiDAR misses the field: only inertial navigation."""
    morpheus = Scenario.load(SCENARIOS / "morpheus.toml").changed(
        truth={"initial_error_scale": 3.0}
    )
    flight = Simulation(morpheus, 1, "no-divert").run()
    last = {name: flight.trajectory[name][-1] for name in flight.trajectory}
    error = last["estimated_velocity_y"] - last["velocity_y"]
    assert abs(error) > 3.0
    assert flight.lost and "navigation-inaccurate" in names(flight)
    assert "diverts-inhibited" not in names(flight)  # no measurement contradicts the estimate
    began = next(e for e in flight.events if e["name"] == "navigation-inaccurate")
    assert began["altitude"] < morpheus.decisions.last_altitude_m + 1.0
