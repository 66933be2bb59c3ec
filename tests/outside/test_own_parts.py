"""The other contracts from outside: navigation, control, tasking, ground, environment."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from lunarsim.simulation import Simulation


def test_a_navigation(small):
    sensors = {k: v for k, v in small.to_dict()["sensors"].items() if k != "fix"}
    data = small.to_dict() | {"navigation": {"kind": "own_navigation:DeadReckoning"}}
    scenario = small.from_dict(data | {"sensors": sensors})
    simulation = Simulation(scenario, 3, "safest")
    flight = simulation.run()
    assert flight.outcome.touchdown is not None
    sigma = np.sqrt(np.diag(simulation.estimate.covariance)[:3])
    assert (np.abs(simulation.navigation_error) < 4.0 * sigma).all()


def test_a_control(small):
    flight = Simulation(
        small.changed(control={"kind": "own_control:SlidingMode"}), 3, "safest"
    ).run()
    assert flight.outcome.safe, flight.outcome
    assert flight.outcome.touchdown.tilt < np.deg2rad(4.0)


def test_a_tasking(small):
    scenario = small.changed(tasking={"flash": {"kind": "own_tasking:HalvingAltitudes"}})
    flight = Simulation(scenario, 3, "no-divert").run()
    altitudes = [e["altitude"] for e in flight.events if e["name"] == "scan"]
    assert len(altitudes) >= 3
    assert np.allclose(np.divide(altitudes[1:4], altitudes[:3]), 0.5, atol=0.03)


def test_a_terrain(small):
    scenario = small.changed(terrain={"kind": "own_ground:Dunes", "height_m": 0.6})
    simulation = Simulation(scenario, 3, "safest")
    low, high = simulation.world.terrain.relief.z_range
    assert high - low == pytest.approx(0.6, abs=0.02)
    assert simulation.run().outcome.touchdown is not None


def test_an_environment(small):
    env = gymnasium.make("own_environment:own/StayHome-v0", scenario=small, perception="onboard")
    env.reset(seed=1)
    _, reward, _, _, info = env.step(0)
    assert reward == pytest.approx(sum(info["reward_terms"].values()))
