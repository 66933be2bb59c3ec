"""Rebuild the world of a recorded flight from its scenario and seed."""

from __future__ import annotations

import numpy as np

from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.worlds import build_world
from lunarsim.world import World


def rebuild_world(flight: Flight) -> World:
    """Generate the true world of a recorded flight again, from scenario and seed."""
    seed = np.random.SeedSequence(flight.seed["entropy"], spawn_key=tuple(flight.seed["spawn_key"]))
    return build_world(Scenario.world_from_toml(flight.scenario), RandomStreams(seed))
