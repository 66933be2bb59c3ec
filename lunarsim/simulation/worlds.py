"""Build the true world of a flight from the scenario, or again from its record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.world import World
from lunarsim.world.terrain import Terrain
from lunarsim.world.terrain_models.interface import check_terrain_size


def build_world(
    scenario: Scenario, streams: RandomStreams, terrain: Terrain | None = None
) -> World:
    """Build the true world of one flight: terrain, rocks, gravity and sunlight.

    Parameters
    ----------
    scenario, streams
        Scenario, and random streams of the flight.
    terrain
        Terrain with rocks, if it was already generated from the same tables and seed; None:
        generate it.

    Raises
    ------
    InputError
        If the terrain cannot be loaded or is smaller than the lander's footprint.
    """
    if terrain is None:
        terrain = scenario.terrain.make().build(scenario.rocks.make(), streams)
    lander = scenario.vehicle.make()
    check_terrain_size(terrain, 2.0 * lander.leg_radius + lander.pad_diameter)
    light = scenario.sun.make()
    if light.albedo_variation > 0.0 or light.boulder_albedo_variation > 0.0:
        light = replace(light, albedo_seed=int(streams.get("albedo").integers(2**31)))
    moon = None if scenario.moon is None else scenario.moon.make().gravity(scenario.gravity_m_s2)
    about = None
    if scenario.far_terrain is not None:
        frame = getattr(scenario.terrain.make(), "frame", None)
        map_frame = None if frame is None else frame()
        about = scenario.far_terrain.make().build(terrain, moon, streams, map_frame)
    dust = None if scenario.dust is None else scenario.dust.make()
    return World(terrain, scenario.gravity_m_s2, light, moon, about, dust)


def rebuild_world(flight: Flight) -> World:
    """Generate the true world of a recorded flight again, from scenario and seed."""
    seed = np.random.SeedSequence(flight.seed["entropy"], spawn_key=tuple(flight.seed["spawn_key"]))
    return build_world(Scenario.world_from_toml(flight.scenario), RandomStreams(seed))
