"""Closed-loop simulation: plant, onboard computer, and the record of a flight."""

from lunarsim.simulation.flight import Flight
from lunarsim.simulation.loop import Simulation
from lunarsim.simulation.worlds import build_world

__all__ = ["Flight", "Simulation", "build_world"]
