"""What the mission tells the computer, and what it keeps to itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_angle
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.navigation.error_state import MAP
from lunarsim.onboard.navigation.terrain_heights import TERRAIN
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.mission import plan
from lunarsim.simulation.worlds import build_world
from lunarsim.world.terrain import Terrain
from tests.conftest import SCENARIOS
from tests.worlds import SMALL_SHADOW_FLIGHT


def briefings(scenario, seeds):
    made = [Simulation(scenario, seed) for seed in seeds]
    return made, [simulation.computer.briefing for simulation in made]


def test_the_plan_does_not_know_the_true_start(small_scenario):
    fixed = small_scenario.changed(target={"scatter_m": [0.0, 0.0]})
    made, told = briefings(fixed, (1, 2, 3))
    assert len({tuple(s.state.position) for s in made}) == 3
    assert len({b.time_to_go for b in told}) == 1


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_errors_of_the_start_are_those_stated_times_their_scale(scale):
    scenario = Scenario.from_dict(SMALL_SHADOW_FLIGHT).changed(
        initial_uncertainty={"position_m": 4.0, "velocity_m_s": 0.3, "attitude_deg": 1.0},
        truth={"initial_error_scale": scale},
    )
    made, told = briefings(scenario, range(40))
    assert {b.start.position_sigma for b in told} == {4.0}
    errors = np.array(
        [
            [
                *(b.start.position - s.state.position) / 4.0,
                *(b.start.velocity - s.state.velocity) / 0.3,
            ]
            for s, b in zip(made, told, strict=True)
        ]
    )
    assert np.std(errors) == pytest.approx(scale, rel=0.15)
    turns = [
        quat_angle(b.start.attitude, s.state.attitude) for s, b in zip(made, told, strict=True)
    ]
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(
        scale * np.deg2rad(np.sqrt(3)), rel=0.2
    )


def test_a_world_of_another_gravity_is_refused(small_scenario):
    """The computer is told the scenario's."""
    world = build_world(small_scenario, RandomStreams(1))
    assert Simulation(small_scenario, 1, world=world).world is world
    heavy = replace(world, gravity=1.7)
    with pytest.raises(
        InputError,
        match=r"world\.gravity: must equal gravity_m_s2 of the scenario \(1\.62.*got 1\.7",
    ):
        Simulation(small_scenario, 1, world=heavy)
    other = small_scenario.changed(gravity_m_s2=1.7)
    assert Simulation(other, 1, world=heavy).briefing.surface_gravity == 1.7


def test_rocks_are_reported_as_expected_not_as_drawn():
    scenario = Scenario.from_dict(SMALL_SHADOW_FLIGHT).changed(
        rocks={"cover": 0.09}, expected_rocks={"cover": 0.03}
    )
    simulation = Simulation(scenario, 1)
    assert simulation.computer.briefing.rocks.cover == 0.03
    assert simulation.computer.mappers["rocks"].probability.prior.cover == 0.03


def test_the_scenarios_own_policy_settings_count(small_scenario):
    scenario = small_scenario.changed(policy={"kind": "safest", "hysteresis": 5.0})
    assert Simulation(scenario, 1, "safest").policy.hysteresis == 5.0
    assert Simulation(scenario, 1, "nearest-safe").policy.p_safe_min == 0.95


def test_fixes_err_by_what_they_state(small_scenario):
    scaled, world = [], build_world(small_scenario, RandomStreams(1))
    for seed in range(40):
        simulation = Simulation(small_scenario, seed, world=world)
        sigma = np.sqrt(np.diag(simulation.estimate.covariance)[:3])
        scaled.append(simulation.navigation_error / sigma)
    assert np.std(scaled) == pytest.approx(1.0, abs=0.15)


def test_each_mapper_gets_the_scans_of_its_own_sensor(small_scenario):
    flash = small_scenario.to_dict()["sensors"]["flash"]
    scenario = small_scenario.changed(
        sensors={"other": flash | {"half_fov_tangent": 0.02}},
        tasking={
            "flash": {"altitudes_m": [350.0]},
            "other": {"kind": "at-altitudes", "altitudes_m": [300.0], "boresight": "nadir"},
        },
        mappers={"narrow": {"kind": "gaussian-dem", "sensor": "other", "posting_m": 0.4}},
    )
    simulation = Simulation(scenario, 2)
    while simulation.altitude > 320.0:
        simulation.move()
    assert not simulation.computer.mappers["dem"].is_empty
    assert simulation.computer.mappers["narrow"].is_empty
    scans = []
    while simulation.altitude > 280.0:
        simulation.move()
        items = simulation.plant.measure().items
        scans += [m for _, m in items if isinstance(m, LidarScan)]
    assert not scans  # none without a task


def test_sensors_have_streams_of_their_own(small_scenario):
    """Another sensor on the lander changes no other's noise."""
    flash = small_scenario.to_dict()["sensors"]["flash"]
    more = small_scenario.changed(
        sensors={"other": flash},
        tasking={"other": {"kind": "at-altitudes", "altitudes_m": [10.0]}},
        mappers={"second": {"kind": "gaussian-dem", "sensor": "other", "posting_m": 0.4}},
    )
    a, b = (Simulation(s, 3).run() for s in (small_scenario, more))
    n = 100
    for column in ("position_x", "estimated_x", "thrust"):
        assert np.array_equal(a.trajectory[column][:n], b.trajectory[column][:n]), column
    first = a.scans[:, 3] == a.scans[0, 3]
    assert np.array_equal(a.scans[first], b.scans[: first.sum()])


def test_stopped_sensors_measure_no_more(small_scenario):
    simulation = Simulation(small_scenario, 3)
    simulation.computer.stop_sensors()
    flight = simulation.run()
    assert not [e for e in flight.events if e["name"] == "scan"]
    assert flight.maps == {}


def test_the_oracle_flies_to_what_is_truly_safe(small_scenario):
    """With a navigation error of tens of metres its sites must be moved by it, the right way."""
    scenario = small_scenario.changed(
        terrain={"size_m": 160.0},
        rocks={"cover": 0.08},
        sensors={"fix": {"position_bias_m": 12.0}},
        mappers={"dem": {"size_m": 80.0}},
    )
    for seed in (1, 2):
        simulation = Simulation(scenario, seed, "truth-oracle")
        flight = simulation.run()
        assert np.linalg.norm(simulation.navigation_error[:2]) > 3.0
        assert simulation.truth.is_safe_at(flight.outcome.touchdown.position[:2]), seed


@pytest.mark.parametrize(
    ("relief", "worlds", "good_to"),
    [(0.0, 1, 0.3), pytest.param(5.0, 20, 0.65, marks=pytest.mark.slow)],
)
def test_the_height_above_terrain_has_the_stated_error(relief, worlds, good_to):
    """200 starts, each with a target of its own; above twenty pieces of ground where they roll."""
    scaled = []
    for world in range(worlds):
        scenario = Scenario.load(SCENARIOS / "instruments.toml").changed(
            # Relief is drawn anew for another number of posts.
            terrain={"size_m": 1600.0 + 32.0 * world, "posting_m": 4.0, "rms_slope_deg": relief},
            rocks={"cover": 1e-4, "min_diameter_m": 2.0}, target={"scatter_m": [150.0, 150.0]},
            initial_uncertainty={"position_m": 4.0, "target_elevation_m": 5.0},
            # Told is the slope over a metre, made that over a post.
            navigation={"terrain_slope_deg": relief * 4.0**0.15}, approach={"time_to_go_s": 45.0},
        )  # fmt: skip
        made = build_world(scenario, RandomStreams(flight_seed(3, world)))
        for flight in range(200 // worlds):
            state, briefing = plan(scenario, made, RandomStreams(flight_seed(4 + world, flight)))
            navigation = scenario.navigation.make().build(briefing)
            height = navigation.inertial.position[2] - briefing.target[2]
            ground = float(made.terrain.elevation(state.position[:2]))
            # Height in the site frame is that in the local one, less where the site lies in it.
            blocks = [navigation.state.block(name).start for name in (MAP, TERRAIN)]
            at, over = np.array([2, *blocks]) + [0, 2, 0], np.array([1.0, -1.0, -1.0])
            sigma = np.sqrt(over @ navigation.covariance[np.ix_(at, at)] @ over)
            scaled.append((height - (state.position[2] - ground)) / sigma)
    # As good as 200 draws make it, or twenty where relief counts most.
    assert np.mean(np.square(scaled)) == pytest.approx(1.0, abs=good_to)


def test_the_target_is_reported_as_well_as_it_is_known(small_scenario):
    own = small_scenario.changed(
        sensors={"fix": None},
        navigation={"kind": "inertial"},
        initial_uncertainty={"target_elevation_m": 3.0},
    )
    exact = own.changed(initial_uncertainty={"target_elevation_m": 0.0})
    off, made = [], build_world(own, RandomStreams(0))
    for seed in range(30):
        (_, told), (_, true) = (plan(s, made, RandomStreams(seed)) for s in (own, exact))
        assert np.array_equal(told.target[:2], true.target[:2])
        assert np.array_equal(told.start.position, true.start.position)
        assert true.target[2] == float(Terrain(made.terrain.relief).elevation(true.target[:2]))
        off.append(told.target[2] - true.target[2])
    assert np.std(off) == pytest.approx(3.0, rel=0.4)
