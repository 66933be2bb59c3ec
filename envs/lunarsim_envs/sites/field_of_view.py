"""Compute the terrain in the field of view of a flash LiDAR pointed at a site."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.typing import Array, BoolArray


def fov_and_footprint(scenario: Scenario) -> Array:
    """Return tangent of half the LiDAR's field of view, and footprint radius (2,).

    The LiDAR is the sensor of the mapper that decisions use; the radius, m, is the lander's. If the
    sensor is not a flash LiDAR, an `InputError` is raised.
    """
    name = deciding_mapper(scenario)
    sensor = scenario.mappers[name].make().sensor
    lidar = scenario.sensors[sensor].make()
    if not isinstance(lidar, FlashLidar):
        kind = scenario.sensors[sensor].kind
        raise InputError(
            f"sensors.{sensor}.kind", kind, "must be 'flash-lidar' for this perception"
        )
    lander = scenario.vehicle.make()
    return np.array([lidar.half_fov_tangent, lander.leg_radius + 0.5 * lander.pad_diameter])


def deciding_mapper(scenario: Scenario) -> str:
    """Return the name of the mapper whose hazard map is used for site decisions.

    Raises
    ------
    InputError
        If the scenario has no mapper.
    """
    if not scenario.mappers:
        raise InputError(
            "mappers", {}, "must contain at least one table [mappers.NAME]", show_value=False
        )
    return scenario.decisions.make().map or next(iter(scenario.mappers))


def scan_altitudes(scenario: Scenario) -> Array:
    """Return the altitudes at which the sensor of the decisions' mapper measures, m.

    They are in descending order. If the tasking of the sensor is not "at-altitudes" with boresight
    "site", an `InputError` is raised.
    """
    sensor = scenario.mappers[deciding_mapper(scenario)].make().sensor
    tasking = scenario.tasking.get(sensor)
    if tasking is None or tasking.kind != "at-altitudes":
        raise InputError(
            f"tasking.{sensor}.kind", None if tasking is None else tasking.kind,
            "must be 'at-altitudes' for this perception", show_value=tasking is not None,
        )  # fmt: skip
    made = tasking.make()
    if made.boresight != "site":
        raise InputError(
            f"tasking.{sensor}.boresight", made.boresight, "must be 'site' for this perception"
        )
    return np.array(sorted(made.altitudes, reverse=True))


def in_view(
    xy: Array, height: Array, lidar_position: Array, boresight: Array, view: Array
) -> BoolArray:
    """Return at which sites the complete footprint of the lander is in view (...,).

    Parameters
    ----------
    xy, height
        Horizontal position (..., 2) and height (...,) of the sites, m.
    lidar_position, boresight
        Position (3,), m, and boresight (3,) of the LiDAR, which has no roll: its image x axis is
        horizontal.
    view
        Field of view and footprint radius, from `fov_and_footprint`.
    """
    out = boresight / np.linalg.norm(boresight)
    across = np.array([out[1], -out[0], 0.0])
    level = np.linalg.norm(across)
    across = across / level if level > 1e-9 else np.array([1.0, 0.0, 0.0])
    down = np.cross(out, across)
    way = np.concatenate((xy, height[..., None]), axis=-1) - lidar_position
    depth = way @ out
    reach = view[0] * depth - view[1]
    return np.asarray(
        (depth > 0.0) & (np.abs(way @ across) <= reach) & (np.abs(way @ down) <= reach)
    )
