"""What of the ground a flash LiDAR that looks at a site has in view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.sensors.lidar import FlashLidar

Array = NDArray[np.float64]


def view_of(scenario: Scenario) -> Array:
    """Return tangent of half the field of view and the room that a footprint takes, m (2,).

    Of the LiDAR of the mapper that decides.

    Raises
    ------
    InputError
        If it maps something else than a flash LiDAR's scans.
    """
    name = deciding_mapper(scenario)
    sensor = scenario.mappers[name].make().sensor
    lidar = scenario.sensors[sensor].make()
    if not isinstance(lidar, FlashLidar):
        raise InputError(f"sensors.{sensor}.kind", type(lidar).__name__, "a flash LiDAR")
    lander = scenario.vehicle.make()
    return np.array([lidar.half_width, lander.leg_radius + 0.5 * lander.pad_diameter])


def deciding_mapper(scenario: Scenario) -> str:
    """Return the name of the mapper whose map decides.

    Raises
    ------
    InputError
        If the scenario has none.
    """
    if not scenario.mappers:
        raise InputError("mappers", {}, "at least one table [mappers.NAME] to decide on")
    return scenario.decisions.make().map or next(iter(scenario.mappers))


def scan_altitudes(scenario: Scenario) -> Array:
    """Return the altitudes at which the mapper's sensor measures, falling, m.

    Raises
    ------
    InputError
        If it is tasked otherwise.
    """
    sensor = scenario.mappers[deciding_mapper(scenario)].make().sensor
    tasking = scenario.tasking.get(sensor)
    if tasking is None or tasking.kind != "at-altitudes":
        kind = None if tasking is None else tasking.kind
        raise InputError(f"tasking.{sensor}.kind", kind, "at-altitudes")
    made = tasking.make()
    if made.boresight != "site":
        raise InputError(f"tasking.{sensor}.boresight", made.boresight, "site")
    return np.array(sorted(made.altitudes, reverse=True))


def in_view(
    xy: Array, height: Array, here: Array, boresight: Array, view: Array
) -> NDArray[np.bool_]:
    """Tell which sites have their whole footprint in view (...,).

    Parameters
    ----------
    xy, height
        The sites (..., 2) and (...,), m.
    here, boresight
        Where the LiDAR is (3,), m, and where it looks (3,), of any length; image x is level.
    view
        See `view_of`.
    """
    out = boresight / np.linalg.norm(boresight)
    across = np.array([out[1], -out[0], 0.0])
    level = np.linalg.norm(across)
    across = across / level if level > 1e-9 else np.array([1.0, 0.0, 0.0])
    down = np.cross(out, across)
    way = np.concatenate((xy, height[..., None]), axis=-1) - here
    depth = way @ out
    reach = view[0] * depth - view[1]
    return np.asarray(
        (depth > 0.0) & (np.abs(way @ across) <= reach) & (np.abs(way @ down) <= reach)
    )
