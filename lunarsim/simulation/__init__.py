"""The closed loop: one clock, its recorder, and the record of a flight."""

from lunarsim.simulation.build import build_world, lander_of
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.loop import Simulation

__all__ = ["Flight", "Simulation", "build_world", "lander_of"]
