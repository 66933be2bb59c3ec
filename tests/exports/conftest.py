"""A saved flight with scans, images, a hazard map and a divert, for all tests of exports."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lunarsim.rng import flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight, Simulation
from tests.worlds import TINY_FLIGHT

SCENARIO = Scenario.from_dict(TINY_FLIGHT).changed(
    sensors={"camera": {"kind": "camera", "width": 48, "height": 32}},
    tasking={"camera": {"kind": "periodic", "rate_hz": 0.5}},
    record={"images": True},
    rocks={"shape": "mixed"},
)


@pytest.fixture(scope="session")
def saved_flight(tmp_path_factory):
    """Return the folder of a flight."""
    simulation = Simulation(SCENARIO, flight_seed(3, 0), "safest")
    return simulation.run().save(tmp_path_factory.mktemp("flights") / "one")


@pytest.fixture(scope="session")
def flight(saved_flight):
    """Return the flight, read from its folder."""
    return Flight.load(saved_flight)


@pytest.fixture(scope="session")
def sited_flight(flight):
    """Return the flight at a place near the meridian of 180 degrees, without [moon]."""
    site = "\n[site]\nlatitude_deg = -43.25\nlongitude_deg = 179.9999\n"
    return replace(flight, scenario=flight.scenario + site)


@pytest.fixture(scope="session")
def saved_sited_flight(sited_flight, tmp_path_factory):
    """Return the folder of the flight with a place."""
    return sited_flight.save(tmp_path_factory.mktemp("sited") / "one")
