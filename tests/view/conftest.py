"""A flight with LiDAR and camera, recorded cycle by cycle and as a complete record."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from tests.worlds import TINY_FLIGHT


@pytest.fixture(scope="session")
def flown():
    """Return flight, world, lander, and the parts of the record of each control cycle."""
    scenario = Scenario.from_dict(TINY_FLIGHT).changed(
        rocks={"cover": 0.1},
        sensors={"camera": {"kind": "camera", "width": 64, "height": 48, "bits": 12}},
        tasking={"camera": {"kind": "periodic", "rate_hz": 1.0}},
        record={"images": True},
        start={"heading_deg": 40.0},
    )
    for seed in range(1, 9):
        simulation, parts = Simulation(scenario, flight_seed(seed, 0), "safest"), []
        flight = simulation.run(watch=parts.append)
        if flight.decisions:
            break
    return SimpleNamespace(
        flight=flight, world=simulation.world, lander=simulation.lander, parts=parts
    )
