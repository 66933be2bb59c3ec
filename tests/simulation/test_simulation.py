from __future__ import annotations

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
import rasterio
import xarray as xr
from rasterio.transform import from_origin

from lunarsim.errors import InputError
from lunarsim.evaluation.map_quality import MapQuality, map_quality
from lunarsim.frames import sensor_axes
from lunarsim.messages.commands import SensorTask
from lunarsim.onboard.policies import Decision
from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from lunarsim.vehicle import evaluate_touchdown
from lunarsim.world.truth import TerrainTruth
from tests.conftest import SCENARIOS
from tests.worlds import SMALL_FLIGHT


@cache
def flown(policy: str) -> tuple[Simulation, Flight]:
    """Return a completed flight of the small scenario, which tests must not change."""
    simulation = Simulation(Scenario.from_dict(SMALL_FLIGHT), flight_seed(3, 0), policy)
    return simulation, simulation.run()


@pytest.mark.parametrize("policy", ["no-divert", "safest", "truth-oracle"])
def test_a_flight_reaches_the_terrain_where_it_aimed(policy):
    simulation, flight = flown(policy)
    touchdown = flight.outcome.touchdown
    assert touchdown is not None
    assert touchdown.vertical_speed == pytest.approx(2.0, abs=0.2)
    assert touchdown.horizontal_speed < 0.3
    # The miss on the onboard map: the true site is the estimated one less the error.
    aimed = simulation.site - simulation.navigation_error
    assert np.hypot(*(touchdown.position - aimed)[:2]) < 0.6
    used = flight.propellant_used
    assert 20.0 < used < 100.0
    # Rocket equation on the record: the thrust integral is the propellant burnt.
    t, thrust = flight.trajectory["time"], flight.trajectory["thrust"]
    burnt = np.trapezoid(thrust, t) / simulation.lander.exhaust_velocity
    assert burnt == pytest.approx(used, rel=0.01)


def test_same_seed_same_bits(small_scenario):
    _, first = flown("safest")
    again = Simulation(small_scenario, flight_seed(3, 0), "safest").run()
    for name, column in first.trajectory.items():
        assert np.array_equal(column, again.trajectory[name]), name
    other = Simulation(small_scenario, flight_seed(5, 2), "safest")
    assert not np.array_equal(first.positions[0], other.state.position)


def test_policies_meet_the_same_world_and_noise(small_scenario):
    a = Simulation(small_scenario, flight_seed(5, 1), "no-divert")
    b = Simulation(small_scenario, flight_seed(5, 1), "safest")
    assert np.array_equal(a.world.terrain.rocks.x, b.world.terrain.rocks.x)
    assert np.array_equal(a.state.position, b.state.position)
    assert np.array_equal(a.site, b.site)


def test_a_divert_from_outside_is_flown(small_scenario):
    simulation = Simulation(small_scenario, flight_seed(2, 0), None)
    first = simulation.site.copy()
    diverted = False
    while not simulation.done:
        if simulation.decision_due:
            move = None if diverted else first + [12.0, -9.0, 0.0]
            assert simulation.apply(Decision(move, "test"))
            diverted = True
        simulation.move()
    end = simulation.state.position - (simulation.site - simulation.navigation_error)
    assert simulation.flight().divert_distance == pytest.approx(15.0)
    assert np.hypot(*end[:2]) < 0.6


def test_sites_out_of_reach_are_refused(small_scenario):
    simulation = Simulation(small_scenario, flight_seed(2, 0), None)
    before = simulation.site.copy()
    assert not simulation.apply(Decision(before + [5000.0, 0.0, 0.0], "test"))
    assert np.array_equal(simulation.site, before)
    assert simulation.computer.telemetry[-1][1] == "divert-refused"


def test_outcome_is_that_of_the_true_terrain(small_scenario):
    simulation = Simulation(small_scenario, flight_seed(1, 0), "no-divert")
    verdict = simulation.run().outcome
    again = evaluate_touchdown(
        simulation.lander, simulation.state, simulation.world.terrain, simulation.world.gravity
    )
    assert again.failure_causes == verdict.failure_causes


def test_an_ideal_attitude_flies_too(small_scenario):
    scenario = small_scenario.changed(control={"kind": "ideal"})
    flight = Simulation(scenario, flight_seed(3, 0), "safest").run()
    assert flight.outcome.touchdown is not None
    assert flight.outcome.touchdown.horizontal_speed < 0.5


def test_support_planes_see_more_safe_terrain_on_relief(small_scenario):
    """The same flights, judged through the support planes: more is found, little of it wrong."""
    rough = small_scenario.changed(
        terrain={"rms_slope_deg": 5.0}, mappers={"dem": {"posting_m": 0.3, "size_m": 50.0}}
    )
    quality = {}
    for safety in ("level", "planes"):
        scenario = rough.changed(mappers={"dem": {"safety": safety}})
        quality[safety] = MapQuality.none()
        for flight in (2, 3):
            simulation = Simulation(scenario, flight_seed(flight, 0), "no-divert")
            record = simulation.run()
            truth = TerrainTruth.of(simulation.world, simulation.lander, 0.3)
            quality[safety] += map_quality(record.hazard_map, truth, record.map_error)
    assert quality["planes"].recall > quality["level"].recall + 0.2
    assert quality["planes"].precision > 0.9


def test_record_opens_without_the_package(small_scenario, tmp_path):
    _, flight = flown("safest")
    folder = flight.save(tmp_path / "flight")
    trajectory = pd.read_parquet(folder / "trajectory.parquet")
    assert np.array_equal(trajectory["position_z"], flight.trajectory["position_z"])
    with xr.open_dataset(folder / "maps" / "dem.nc", engine="h5netcdf") as data:
        assert data.p_safe.dims == ("y", "x")
        assert np.allclose(data.p_safe, flight.hazard_map.p_safe, atol=1e-4)
        assert np.allclose(data.x, flight.hazard_map.grid.x)
        assert data.elevation.attrs["units"] == "m"
    record = json.loads((folder / "flight.json").read_text())
    assert record["outcome"]["safe"] == flight.outcome.safe
    assert Scenario.from_toml(record["scenario"]) == small_scenario
    assert len(pd.read_parquet(folder / "scans.parquet")) == len(flight.scans)


def test_gimbal_points_at_the_site():
    simulation, flight = flown("no-divert")
    scans = flight.scans
    for time in np.unique(scans[:, 3]):
        own = scans[scans[:, 3] == time]
        # The site lies well inside what was scanned.
        assert np.abs(np.median(own[:, 0]) - simulation.site[0]) < 12.0
    assert [e["name"] for e in flight.events].count("scan") == 2


def test_true_share_of_safe_terrain_predicts_blind_landings(small_scenario):
    """Blind touchdowns on exactly safe cells are judged safe by the finer verdict."""
    agreements = []
    for i in range(3):
        simulation = Simulation(small_scenario, flight_seed(9, i), "no-divert")
        flight = simulation.run()
        touchdown = flight.outcome.touchdown
        if simulation.truth.is_safe_at(touchdown.position[:2]):
            agreements.append(flight.outcome.safe)
    assert agreements
    assert all(agreements)


@pytest.mark.parametrize(
    ("tables", "field"),
    [
        ({"vehicle": {"thrust_max_n": 2000.0}}, "vehicle.thrust_max_n"),
        ({"start": {"position_m": (0.0, 0.0, -5.0)}}, "start.position_m[2]"),
        ({"start": {"position_m": (-3000.0, 0.0, 100.0)}}, "start.position_m"),
        ({"target": {"position_m": (500.0, 0.0)}}, "target.position_m[0]"),
        ({"terrain": {"size_m": 6.0}}, "terrain"),
        ({"mappers": {"dem": {"size_m": 5.0}}}, "mappers.dem.size_m"),
        ({"mappers": {"dem": {"posting_m": 2.0}}}, "mappers.dem.posting_m"),
        ({"vehicle": {"leg_radius_m": 0.2}}, "vehicle.pad_diameter_m"),
    ],
)
def test_impossible_scenarios_name_the_field(small_scenario, tables, field):
    with pytest.raises(InputError) as caught:
        Simulation(small_scenario.changed(**tables), 1, "safest")
    assert caught.value.field == field


def test_holes_in_a_dtm_are_unsafe_and_unobserved(small_scenario, tmp_path):
    z = np.zeros((80, 80), np.float32)
    z[30:34, 50:53] = np.nan
    path = tmp_path / "holes.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=80, width=80, count=1, dtype="float32",
        crs="+proj=eqc +R=1737400 +units=m +no_defs", transform=from_origin(0, 0, 1.0, 1.0),
    ) as file:  # fmt: skip
        file.write(z, 1)
    scenario = small_scenario.changed(
        terrain={"kind": "dtm", "path": path, "detail": False}, target={"scatter_m": (2.0, 2.0)}
    )
    simulation = Simulation(scenario, flight_seed(1, 0), "safest")
    hole = np.array([51.0 - 39.5, 39.5 - 31.5])
    assert not simulation.truth.is_known_at(hole)
    assert not simulation.truth.is_safe_at(hole)
    flight = simulation.run()
    assert flight.outcome.safe
    hazard_map = flight.hazard_map
    row, col = hazard_map.grid.cell(hole + flight.map_error[:2])
    assert not hazard_map.observed[row, col]
    assert hazard_map.p_safe[row, col] == 0.0


def test_stepping_past_the_end_is_an_error():
    simulation, _ = flown("no-divert")
    with pytest.raises(RuntimeError, match="ended"):
        simulation.step()


# The example of `lunarsim.fly` flies hirise.
@pytest.mark.parametrize("name", ["golombek", pytest.param("hirise", marks=pytest.mark.slow)])
def test_shipped_scenarios_fly_end_to_end(name):
    scenario = Scenario.load(SCENARIOS / f"{name}.toml")
    flight = Simulation(scenario, flight_seed(1, 0), "safest").run()
    assert flight.outcome.safe
    assert flight.hazard_map.observed.mean() > 0.2


def test_the_first_arrival_is_the_cheapest_from_where_the_lander_believes_it_is(small_scenario):
    simulation = Simulation(small_scenario, flight_seed(4, 0), None)
    computer = simulation.computer
    cheapest = computer.cost_of(computer.site[None, :]).time_to_go[0]
    assert computer.time_to_go == pytest.approx(cheapest)
    fixed = small_scenario.changed(approach={"time_to_go_s": 44.0})
    assert Simulation(fixed, flight_seed(4, 0), None).computer.time_to_go == 44.0


def test_the_first_decision_to_stay_chooses_the_time_afresh(small_scenario):
    simulation = Simulation(small_scenario, flight_seed(4, 0), None)
    computer = simulation.computer
    while not simulation.decision_due:
        simulation.move()
    planned = computer.time_to_go
    assert simulation.apply(Decision.keep("stay"))
    cheapest = computer.cost_of(computer.site[None, :]).time_to_go[0]
    assert computer.time_to_go == pytest.approx(cheapest)
    assert abs(computer.time_to_go - planned) > 0.05
    simulation.move()
    while not simulation.decision_due:
        simulation.move()
    # Later ones let the path be.
    before = computer.time_to_go
    simulation.apply(Decision.keep("stay"))
    assert computer.time_to_go == before


def moved_late(scenario) -> Simulation:
    """Return a flight whose site is elsewhere all of a sudden, and its time-to-go as it was."""
    simulation = Simulation(scenario, flight_seed(4, 0), None)
    computer = simulation.computer
    while computer.time_to_go > 7.0:
        simulation.step()
    computer.site = computer.site + np.array([-20.0, 0.0, 0.0])
    while not simulation.done:
        simulation.step()
    return simulation


def test_a_path_that_asks_for_too_much_arrives_later(small_scenario, monkeypatch):
    def miss(simulation: Simulation) -> float:
        aimed = simulation.site - simulation.navigation_error
        touchdown = simulation.outcome.touchdown
        # One that leaves the ground that there is touches down nowhere.
        return np.inf if touchdown is None else float(np.hypot(*(touchdown.position - aimed)[:2]))

    found = moved_late(small_scenario)
    (later,) = [d for _, name, d in found.computer.telemetry if name == "time-to-go-extended"]
    assert later["seconds"] > 1.0
    assert miss(found) < 1.0
    assert found.outcome.touchdown.horizontal_speed < 0.5
    monkeypatch.setattr(
        "lunarsim.onboard.guidance.command_limits.LimitViolationMonitor.exceeds_duration",
        lambda *a: False,
    )
    # Without the longer path, the lander passes its site and must approach it again.
    passed = moved_late(small_scenario)
    assert [1 for _, name, _ in passed.computer.telemetry if name == "hover"]
    assert passed.time > found.time + 10.0


def test_a_time_that_the_mission_fixes_stands(small_scenario):
    found = moved_late(small_scenario.changed(approach={"time_to_go_s": 30.0}))
    assert not [1 for _, name, _ in found.computer.telemetry if name == "time-to-go-extended"]


def test_a_gimbal_stops_at_its_limit_whatever_it_is_given(small_scenario):
    stiff = small_scenario.changed(sensors={"flash": {"gimbal_limit_deg": 20.0}})
    simulation = Simulation(stiff, flight_seed(4, 0), None)
    while simulation.altitude > 200.0:
        simulation.move()
    aside = sensor_axes([1.0, 0.0, -0.2])
    items = simulation.plant.measure([SensorTask("flash", aside)]).items
    (scan,) = [m for name, m in items if name == "flash"]
    angle = np.arccos(-scan.mount[2, 2])
    assert angle == pytest.approx(np.deg2rad(20.0), abs=1e-6)
