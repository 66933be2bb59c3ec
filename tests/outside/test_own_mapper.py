"""A mapper from outside, beside one that comes with the package."""

from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.simulation import Flight, Simulation

OWN = "own_mapper:LevelGround"


def test_a_policy_flies_on_it_and_the_record_holds_both(small, tmp_path):
    scenario = small.changed(
        mappers={"level": {"kind": OWN, "band_m": 0.4}}, decisions={"map": "level"}
    )
    simulation = Simulation(scenario, 3, "safest")
    flight = simulation.run()
    assert set(flight.maps) == {"dem", "level"}
    assert flight.decision_mapper == "level"
    assert flight.hazard_map is flight.maps["level"].hazard_map
    assert flight.hazard_map.observed.any()
    assert flight.outcome.touchdown is not None
    assert set(Flight.load(flight.save(tmp_path / "f")).maps) == {"dem", "level"}


def test_it_must_be_given_a_lidar(small):
    with pytest.raises(
        InputError, match=r"mappers\.level\.sensor: must name a sensor .*'imu' is of kind 'imu'"
    ):
        small.changed(mappers={"level": {"kind": OWN, "sensor": "imu"}})
