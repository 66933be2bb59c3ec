"""What the mission fixes before a flight: the target, and where the descent begins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust
from lunarsim.models.lander import Lander
from lunarsim.rng import Streams
from lunarsim.scenario import Scenario
from lunarsim.vehicle import State
from lunarsim.world import World

Array = NDArray[np.float64]


def draw_target(scenario: Scenario, world: World, lander: Lander, streams: Streams) -> Array:
    """Return the target on the true ground (3,), m.

    Raises
    ------
    InputError
        If it may lie off the map.
    """
    section = scenario.target
    offset = streams.get("target").uniform(-1.0, 1.0, 2) * np.asarray(section.scatter_m)
    xy = np.asarray(section.position_m) + offset
    west, east, south, north = world.terrain.bounds
    reach = np.abs(section.scatter_m)
    low, high = section.position_m - reach, section.position_m + reach
    room = lander.leg_radius + lander.pad_diameter
    if (
        low[0] < west + room
        or high[0] > east - room
        or low[1] < south + room
        or high[1] > north - room
    ):
        raise InputError(
            "target.position_m",
            section.position_m,
            f"within the map with its scatter of {section.scatter_m} m: east {west + room:.0f} "
            f"to {east - room:.0f}, north {south + room:.0f} to {north - room:.0f} m",
        )
    # The mission knows the relief under its site, not the rocks on it.
    elevation = float(type(world.terrain)(world.terrain.relief).elevation(xy))
    if not np.isfinite(elevation):
        raise InputError("target.position_m", tuple(xy), "a point with a measured elevation")
    return np.array([xy[0], xy[1], elevation])


def draw_start(
    scenario: Scenario, world: World, lander: Lander, streams: Streams, site: Array
) -> State:
    """Return the true state at the start, upright.

    Raises
    ------
    InputError
        If it may lie under the ground.
    """
    section = scenario.start
    rng = streams.get("start")
    position = (
        site + np.asarray(section.position_m) + section.position_sigma_m * rng.standard_normal(3)
    )
    velocity = np.asarray(section.velocity_m_s) + section.velocity_sigma_m_s * (
        rng.standard_normal(3)
    )
    ground = float(world.terrain.elevation(position[:2]))
    if not np.isfinite(ground):
        ground = world.terrain.z_range[1]
    if position[2] - lander.com_height <= ground:
        raise InputError(
            "start.position_m",
            section.position_m,
            f"above the ground, which lies {ground - site[2]:.0f} m from the target's level",
        )
    mass = lander.wet_mass
    up = attitude_from_thrust([0.0, 0.0, 1.0], np.deg2rad(section.heading_deg))
    return State(position, velocity, up, np.zeros(3), mass, mass * scenario.gravity_m_s2)
