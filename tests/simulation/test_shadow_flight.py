"""The closed loop by camera: pictures, filter, map, policy, touchdown."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import SMALL_SHADOW_FLIGHT

DECISIONS = {"first_altitude_m": 90.0, "last_altitude_m": 30.0, "interval_s": 2.0}


def scenario(**changes):
    return Scenario.from_dict(SMALL_SHADOW_FLIGHT | {"decisions": DECISIONS}).changed(**changes)


@pytest.fixture(scope="module")
def flown():
    simulation = Simulation(scenario(), 3, "safest")
    return simulation, simulation.run()


def test_a_policy_lands_on_the_shadow_map(flown):
    simulation, flight = flown
    assert flight.outcome.touchdown is not None
    assert flight.hazard_map is not None
    assert flight.hazard_map.observed.any()
    names = [event["name"] for event in flight.events]
    assert "image" in names
    p = flight.hazard_map.p_safe
    assert 0.0 <= p.min() <= p.max() <= 1.0
    # The map tells rocks from open ground, in the frame that the lander flies in.
    grid = flight.hazard_map.grid
    xx, yy = np.meshgrid(grid.x, grid.y)
    points = np.stack((xx, yy), -1) - flight.map_error[:2]
    on_rock = simulation.world.terrain.elevation(points) > 0.25
    seen = flight.hazard_map.observed
    # Ground that a rock keeps in the dark is not seen, and 0 there.
    assert p[on_rock].mean() < 0.5 * p[seen & ~on_rock].mean()


def test_the_estimate_is_as_good_as_it_says(flown):
    simulation, _ = flown
    f = simulation.computer.navigation
    error = simulation.state.velocity - f.inertial.velocity
    sigma = np.sqrt(np.diag(f.covariance)[3:6])
    assert (np.abs(error) < 5.0 * sigma + 0.02).all()
    # Height above the ground, which the altimeter sees; the horizontal start error stays.
    height = f.inertial.position[2] - f.rocks.terrain_height_below
    assert height == pytest.approx(simulation.state.position[2], abs=0.5)
    # Places relative to each other are known exactly at first: not under 0 but for rounding.
    assert np.linalg.eigvalsh(f.covariance).min() > -1e-12


def test_same_seed_same_bits(flown):
    simulation, flight = flown
    again = Simulation(scenario(), 3, "safest").run()
    assert np.array_equal(again.hazard_map.p_safe, flight.hazard_map.p_safe)
    for name, column in flight.trajectory.items():
        assert column.tobytes() == again.trajectory[name].tobytes(), name


def test_night_flies_without_a_map():
    """With the Sun down nothing is seen; the lander keeps its site."""
    with pytest.raises(InputError, match=r"sun\.elevation"):
        Simulation(scenario(sun={"elevation_deg": -5.0}), 3)


def test_a_camera_that_is_stopped_leaves_a_usable_loop():
    simulation = Simulation(scenario(), 4)
    for _ in range(20):
        simulation.step()
    simulation.computer.stop_sensors()
    while not simulation.done:
        simulation.step()
    assert simulation.outcome.touchdown is not None


@pytest.mark.parametrize(
    ("table", "values", "field"),
    [
        ("mappers", {"rocks": {"kind": "sonar"}}, "mappers.rocks.kind"),
        ("expected_rocks", {"shape": "pyramid"}, "expected_rocks.shape"),
        ("expected_rocks", {"cover": 0.9}, "expected_rocks.cover"),
        (
            "mappers",
            {"rocks": {"min_hazard_diameter_m": -1.0}},
            "mappers.rocks.min_hazard_diameter_m",
        ),
        ("tasking", {"camera": {"rate_hz": 0.0}}, "tasking.camera.rate_hz"),
        ("tasking", {"camera": {"first_altitude_m": -3.0}}, "tasking.camera.first_altitude_m"),
        (
            "approach",
            {"arrival_acceleration_m_s2": [0.0, 0.0]},
            "approach.arrival_acceleration_m_s2",
        ),
    ],
)
def test_bad_fields_are_named(table, values, field):
    with pytest.raises(InputError) as caught:
        scenario(**{table: values})
    assert caught.value.field.startswith(field)
