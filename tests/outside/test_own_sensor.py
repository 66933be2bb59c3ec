"""A sensor from outside, and a navigation that takes what it gives."""

from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.simulation import Simulation

OWN = "own_sensor:LaserAltimeter"


def lander(small, **more):
    data = small.to_dict()
    sensors = {name: part for name, part in data["sensors"].items() if name != "fix"}
    # The ground is level and its height known: what the altimeter says is the lander's height.
    level = {"kind": "rocks", "terrain_slope_deg": 0.1}
    return small.from_dict(data | {"navigation": level, "sensors": sensors | more})


def height_error(simulation):
    """Fly until the lander is over the terrain; return by how much its height is wrong, m."""
    while simulation.altitude > 60.0:
        simulation.step()
    return abs(simulation.site_error[2])


def test_the_filter_takes_its_readings(small):
    without = height_error(Simulation(lander(small), 5, "no-divert"))
    with_laser = height_error(Simulation(lander(small, laser={"kind": OWN}), 5, "no-divert"))
    assert without > 1.0
    assert with_laser < 0.3 * without


def test_a_sensor_that_nobody_takes_is_named(small):
    sensors = small.to_dict()["sensors"] | {"laser": {"kind": OWN}}
    with pytest.raises(
        InputError, match=r"sensors\.laser.*sensors of kind .own_sensor:LaserAltimeter"
    ):
        small.changed(sensors=sensors)
