"""A vehicle from outside."""

from __future__ import annotations

import pytest

from lunarsim.errors import InputError
from lunarsim.simulation import Simulation

OWN = "own_vehicle:Scout"


def test_it_lands(small):
    scenario = small.changed(vehicle={"kind": OWN})
    simulation = Simulation(scenario, 3, "no-divert")
    flight = simulation.run()
    assert simulation.lander.wet_mass == 200.0
    assert flight.outcome.touchdown is not None
    assert 3.0 < flight.propellant_used < 15.0
    assert flight.outcome.touchdown.vertical_speed == pytest.approx(2.0, abs=0.3)


def test_its_figures_can_be_set_and_are_checked(small):
    assert (
        small.changed(vehicle={"kind": OWN, "com_height_m": 0.9}).vehicle.make().com_height == 0.9
    )
    with pytest.raises(InputError, match=r"vehicle\.thrust_max_n"):
        Simulation(small.changed(vehicle={"kind": OWN, "thrust_max_n": 200.0}), 1)
    with pytest.raises(InputError, match=r"vehicle\.wheels: is an unknown key\."):
        small.changed(vehicle={"kind": OWN, "wheels": 4})
