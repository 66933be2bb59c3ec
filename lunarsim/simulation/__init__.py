"""The closed loop: one clock, its recorder, and the record of a flight."""

from lunarsim.simulation.build import build_world, lander_of
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.simulation import Simulation
from lunarsim.simulation.truth import Truth

__all__ = ["Flight", "Simulation", "Truth", "build_world", "lander_of"]
