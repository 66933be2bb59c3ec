"""One lander that carries every sensor: two maps of the same ground from the same stream."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.evaluation.consistency import Consistency, normalised_squared_error
from lunarsim.evaluation.map_quality import map_quality
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from tests.chance import ratio_bounds
from tests.conftest import SCENARIOS
from tests.navigation_errors import error_of


def scenario(decides: str) -> Scenario:
    """The shipped scenario, made small."""
    return Scenario.load(SCENARIOS / "camera_and_lidar.toml").changed(
        terrain={"size_m": 120.0, "rms_slope_deg": 0.0},
        rocks={"min_diameter_m": 0.4},
        target={"scatter_m": [8.0, 8.0]},
        sensors={
            "camera": {"width": 320, "height": 240},
            "flash": {"rows": 128, "cols": 128},
        },
        start={"position_m": [-140.0, 0.0, 180.0], "velocity_m_s": [11.0, 0.0, -9.0]},
        tasking={
            "camera": {"rate_hz": 2.5, "first_altitude_m": 160.0},
            "flash": {"altitudes_m": [150.0, 110.0]},
        },
        mappers={
            "dem": {"posting_m": 0.4, "size_m": 50.0},
            "rocks": {"posting_m": 0.5, "size_m": 50.0},
        },
        decisions={"map": decides, "first_altitude_m": 120.0, "last_altitude_m": 40.0},
    )


@pytest.fixture(scope="module")
def heights():
    """Heights of the site, and of the map there, at each step of the flight (n, 2), m."""
    return []


@pytest.fixture(scope="module")
def flown(heights):
    simulation = Simulation(scenario("dem"), 4, "safest")
    computer = simulation.computer
    while not simulation.done:
        simulation.step()
        if not (computer.mapper.is_empty or simulation.done):
            mapped = computer.mapper.hazard_map().elevation_at(computer.site[:2])
            heights.append((computer.site[2], mapped))
    return simulation, simulation.flight()


def test_each_mapper_gives_its_own_map(flown):
    simulation, flight = flown
    assert set(flight.maps) == {"dem", "rocks", "fused"}
    for name, record in flight.maps.items():
        assert record.hazard_map.observed.mean() > 0.3, name
        quality = map_quality(record.hazard_map, simulation.truth, record.error)
        share = (quality.true_safe + quality.false_unsafe) / (
            quality.true_safe + quality.false_unsafe + quality.false_safe + quality.rejected
        )
        # Each tells safe from unsafe ground better than calling all of it safe would.
        assert quality.precision > share + 0.2 * (1.0 - share), name
    dem, rocks = (flight.maps[name].hazard_map for name in ("dem", "rocks"))
    # A LiDAR tells heights; shadows tell of rocks on a plane.
    assert np.nanstd(dem.elevation) > 0.02
    assert np.nanstd(rocks.elevation) == 0.0
    assert len(flight.maps["rocks"].tables["rocks"]["radius"]) > 10


def test_the_fused_map_is_made_of_both(flown):
    """Where only one eye saw it is that one's; more is seen, and no less is told from the rest."""
    simulation, flight = flown
    dem, rocks, fused = (flight.maps[name].hazard_map for name in ("dem", "rocks", "fused"))
    assert fused.grid == dem.grid
    assert fused.observed[dem.observed].all()
    assert fused.observed.sum() > dem.observed.sum()
    changed = dem.observed & (fused.p_safe != dem.p_safe)
    assert changed.sum() > 0.05 * dem.observed.sum()
    errors = [flight.maps[name].error for name in ("dem", "rocks", "fused")]
    truth = simulation.truth
    precision = [
        map_quality(m, truth, error).precision
        for m, error in zip((dem, rocks, fused), errors, strict=True)
    ]
    assert precision[2] > min(precision[:2])
    # Asked for again, nothing is drawn anew.
    mapper = simulation.computer.mappers["fused"]
    assert mapper.hazard_map() is mapper.hazard_map()


def test_the_fused_map_decides_unless_another_is_named():
    shipped = Scenario.load(SCENARIOS / "camera_and_lidar.toml")
    assert Simulation(scenario("fused"), 4).computer.decision_map_name == "fused"
    assert shipped.decisions.map == "fused"
    left_out = Simulation(scenario(""), 4).computer
    assert left_out.decision_map_name == "fused"
    assert list(left_out.mappers) == ["dem", "rocks", "fused"]
    first = scenario("").changed(mappers={"fused": None})
    assert Simulation(first, 4).computer.decision_map_name == "dem"


def test_both_sensors_served_and_the_policy_flew_on_the_one_named(flown):
    _, flight = flown
    seen = [e for e in flight.events if "sensor" in e and not e["name"].startswith("beams-")]
    assert {e["sensor"] for e in seen} == {"camera", "flash"}
    assert flight.decision_mapper == "dem"
    assert flight.hazard_map is flight.maps["dem"].hazard_map
    assert flight.decisions
    assert flight.outcome.touchdown is not None


def test_scans_lie_one_on_the_other_though_the_altimeter_moves_the_height(flown):
    simulation, flight = flown
    moved = simulation.computer.navigation.site_to_local.offset[2]
    assert abs(moved) > 0.5
    heights = [
        np.median(flight.scans[flight.scans[:, 3] == time, 2])
        for time in np.unique(flight.scans[:, 3])
    ]
    assert len(heights) == 2
    assert abs(heights[1] - heights[0]) < 0.25 * abs(moved)
    # Measured ground, plane of the rocks and site are at one height now.
    ground = simulation.computer.mappers["rocks"].terrain_height(np.zeros(2))
    assert heights[1] == pytest.approx(ground, abs=0.4)
    drawn = flight.maps["rocks"].hazard_map
    middle = np.array([drawn.grid.x.mean(), drawn.grid.y.mean()])
    ground = simulation.computer.mappers["rocks"].terrain_height(middle)
    assert drawn.elevation[0, 0] == pytest.approx(ground, abs=1e-3)


def test_the_site_keeps_the_height_that_is_mapped_there(flown, heights):
    site, mapped = np.array(heights).T
    known = np.isfinite(mapped)
    assert known.sum() > 100
    assert site[known] == pytest.approx(mapped[known], abs=1e-6)


@pytest.mark.parametrize("seed", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_rocks_and_scans_are_taken_into_one_filter(seed):
    """Velocities are better known with both than with either, and err as is said."""
    sigma, nees = {}, Consistency()
    scans = {"kind": "periodic", "rate_hz": 5.0}
    for eyes in (("camera", "flash"), ("camera",), ("flash",)):
        never = {
            name: {"kind": "at-altitudes", "altitudes_m": [1.0]} for name in ("camera", "flash")
        }
        tasks = {"flash": scans, "camera": {}}
        tasks = {name: tasks[name] if name in eyes else never[name] for name in tasks}
        simulation = Simulation(
            scenario("dem").changed(sensors={"flash": {"rows": 64, "cols": 64}}, tasking=tasks),
            seed, "no-divert",
        )  # fmt: skip
        while simulation.time < 12.0:
            simulation.step()
        p = simulation.estimate.covariance
        sigma[eyes] = float(np.sqrt(np.trace(p[3:6, 3:6])))
        nees = nees.plus(normalised_squared_error(error_of(simulation), p), 9)
        navigation = simulation.computer.navigation
        assert not navigation.lost
        kinds = {key.split()[-1] for key, w in navigation.monitors.items() if w.nis_sum > 0.0}
        assert ("scans" in kinds) == ("flash" in eyes)
        assert ("places" in kinds) == ("camera" in eyes)
    assert sigma["camera", "flash"] < 0.9 * min(sigma[("camera",)], sigma[("flash",)])
    # The three flights share world and noise.
    assert nees.ratio < ratio_bounds(9, 1.25)[1]


@pytest.fixture(scope="module", params=[(1, 2, 3)])
def on_a_map(request):
    """Flights on a prior map: by camera and flash together, and by either, some seeds of each."""
    flown = {}
    for eyes in (("camera", "flash"), ("flash",), ("camera",)):
        never = {"kind": "at-altitudes", "altitudes_m": [1.0]}
        tasks = {"camera": {}, "flash": {"kind": "periodic", "rate_hz": 5.0}}
        tasks = {name: task if name in eyes else never for name, task in tasks.items()}
        flown[eyes] = []
        for seed in request.param:
            simulation = Simulation(
                scenario("dem").changed(
                    terrain={"rms_slope_deg": 1.5}, rocks={"cover": 0.08},
                    sensors={"flash": {"rows": 64, "cols": 64}}, tasking=tasks,
                    prior_map={"posting_m": 0.5, "size_m": 100.0},
                    initial_uncertainty={"velocity_m_s": 0.1, "attitude_deg": 0.2},
                ), seed, "no-divert",
            )  # fmt: skip
            while simulation.time < 12.0:
                simulation.step()
            flown[eyes].append(simulation)
    return flown


def test_rocks_scans_and_a_prior_map_are_in_one_state(on_a_map):
    for simulation in on_a_map["camera", "flash"]:
        navigation = simulation.computer.navigation
        kinds = {key.split()[-1] for key, w in navigation.monitors.items() if w.nis_sum > 0.0}
        assert {"places", "map", "range"} <= kinds
        assert "lock" in {event.name for event in navigation.events}
        assert not navigation.lost
        # About a hundred: shadows a pixel wide decide, and not all machines draw them alike.
        assert navigation.rocks.count > 60
        # Rocks stand where they are, not where the start was thought to be.
        assert np.abs(error_of(simulation)[:3]).max() < 0.5


def test_with_both_sensors_on_a_map_errors_are_no_larger_than_with_either(on_a_map):
    spread, nees = {}, Consistency()
    for eyes, flights in on_a_map.items():
        sigma = [np.sqrt(np.diag(s.estimate.covariance)) for s in flights]
        spread[eyes] = np.sqrt(np.mean(np.square(sigma), axis=0))
        for s in flights:
            nees = nees.plus(normalised_squared_error(error_of(s), s.estimate.covariance), 9)
    both = spread.pop(("camera", "flash"))
    for eyes, alone in spread.items():
        # Position and velocity: neither sensor adds error, except by the path that is flown.
        assert (both[:6] <= 1.15 * alone[:6]).all(), eyes
    assert np.linalg.norm(both[3:6]) < 0.8 * np.linalg.norm(spread[("flash",)][3:6])
    assert np.linalg.norm(both[:3]) < 0.2 * np.linalg.norm(spread[("camera",)][:3])
    # The three flights of a seed share world and noise.
    assert nees.ratio < ratio_bounds(len(flights) * 9, 1.25)[1]


def test_from_a_start_that_is_far_off_nothing_is_reported_about_place_and_yaw():
    """Rocks and scans, 3 m/s and 0.5 deg off: Jacobians about wrong places tell no more either."""
    simulation = Simulation(
        scenario("dem").changed(
            sensors={"flash": {"rows": 64, "cols": 64}},
            tasking={"flash": {"kind": "periodic", "rate_hz": 5.0}},
            initial_uncertainty={"position_m": 5.0, "velocity_m_s": 3.0, "attitude_deg": 0.5},
        ), 2, "no-divert",
    )  # fmt: skip
    told = np.diag(simulation.estimate.covariance)
    taken = set()
    while simulation.time < 15.0:
        simulation.step()
        now = np.diag(simulation.estimate.covariance)
        # East, north and yaw; the way that the start's velocity points tells of yaw, 11 m/s by 3.
        assert (now[[0, 1, 8]] > 0.998 * told[[0, 1, 8]]).all(), simulation.time
        watches = simulation.computer.navigation.monitors
        taken |= {key.split()[-1] for key, w in watches.items() if w.dof > 5}
    assert {"places", "scans"} <= taken
    assert now[3:6].max() < 0.1**2, "speed is told"


def test_the_other_map_can_decide(flown):
    _, by_dem = flown
    simulation = Simulation(scenario("rocks"), 4, "safest")
    flight = simulation.run()
    assert flight.decision_mapper == "rocks"
    assert flight.outcome.touchdown is not None
    # Until something was mapped both flew the same: what decides changes no measurement. After
    # it the height of the site is that of the map that decides.
    first = min(e["time"] for e in flight.events if e["name"] in {"scan", "image"})
    rows = by_dem.trajectory["time"] < first
    for column in ("position_x", "estimated_x", "thrust"):
        a, b = (f.trajectory[column][: rows.sum()] for f in (by_dem, flight))
        assert np.array_equal(a, b), column
    assert flight.decisions[0]["to"] != by_dem.decisions[0]["to"]


def test_the_record_gives_both_back(flown, tmp_path):
    _, flight = flown
    again = Flight.load(flight.save(tmp_path / "flight"))
    assert set(again.maps) == {"dem", "rocks", "fused"}
    for name, record in flight.maps.items():
        assert np.array_equal(again.maps[name].hazard_map.p_safe, record.hazard_map.p_safe)
        for table, columns in record.tables.items():
            for column, values in columns.items():
                assert np.array_equal(again.maps[name].tables[table][column], values)
