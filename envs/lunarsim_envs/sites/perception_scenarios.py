"""Change scenarios so that decisions use the mapper of a given perception."""

from __future__ import annotations

from typing import Any

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim_envs.sites.field_of_view import deciding_mapper

# Kind of mapper of each perception.
MAPPER_OF = {"shadows": "shadow", "quadtree": "quadtree", "fused": "fused"}
# LiDAR mappers that a fused map can use.
_LIDAR = ("gaussian-dem", "quadtree")
# Half side of the quadtree's landing zone over that of the footprint, from the quadtree paper.
_ZONE = 1.35
# Image rate of an added camera, Hz.
_PICTURES = 5.0


def with_perception(scenario: Scenario, perception: str) -> Scenario:
    """Change a scenario so that site decisions use the mapper of a perception.

    If the scenario has a mapper of this kind, decisions use that mapper. Otherwise one is added:

    - "quadtree" replaces the current mapper, with the same scans and map area.
    - "shadows" replaces all mappers; a camera is added if there is none, and inertial navigation is
      replaced by one that tracks rocks.
    - "fused" combines the current LiDAR mapper with a shadow mapper.

    Parameters
    ----------
    scenario
        Scenario to change.
    perception
        A key of `MAPPER_OF`, or "onboard", which changes nothing.

    Raises
    ------
    InputError
        If other tables of the scenario do not fit the mapper.
    """
    if perception == "onboard":
        return scenario
    kind = MAPPER_OF[perception]
    known = [name for name, part in scenario.mappers.items() if part.kind == kind]
    if known:
        chosen = scenario.decisions.make().map
        return scenario.changed(decisions={"map": chosen if chosen in known else known[0]})
    add = {"shadow": _shadows, "quadtree": _quadtree, "fused": _fused}[kind]
    return scenario.changed(**add(scenario))


def _unused_name(scenario: Scenario, name: str) -> str:
    """Return `name`, with underscores appended until no mapper or sensor has it."""
    while name in scenario.mappers or name in scenario.sensors:
        name += "_"
    return name


def _map_size(scenario: Scenario) -> dict[str, Any]:
    """Return `size_m` and `posting_m` of the mapper that decisions use, by key."""
    part = scenario.mappers[deciding_mapper(scenario)]
    return {key: getattr(part, key) for key in ("size_m", "posting_m") if hasattr(part, key)}


def _quadtree(scenario: Scenario) -> dict[str, Any]:
    """Return the changes that replace the mapper of decisions by a quadtree mapper."""
    before = deciding_mapper(scenario)
    name, part = _unused_name(scenario, "quadtree"), scenario.mappers[before]
    if part.kind != "gaussian-dem":
        raise InputError(
            f"mappers.{before}.kind", part.kind,
            "must be 'quadtree' or 'gaussian-dem' for perception='quadtree'",
        )  # fmt: skip
    lander = scenario.vehicle.make()
    sites = {
        "zone_half_side_m": _ZONE * (lander.leg_radius + 0.5 * lander.pad_diameter),
        "roughness_limit_m": lander.roughness_limit,
    }
    table = _map_size(scenario) | {"kind": "quadtree", "sensor": part.sensor, "sites": sites}
    return {"mappers": {before: None, name: table}, "decisions": {"map": name}}


def _shadows(scenario: Scenario) -> dict[str, Any]:
    """Return the changes that replace all mappers by a shadow mapper."""
    given = _camera(scenario)
    others = dict.fromkeys(scenario.mappers)
    name = next(iter(given["mappers"]))
    return given | {"mappers": others | given["mappers"], "decisions": {"map": name}}


def _fused(scenario: Scenario) -> dict[str, Any]:
    """Return the changes that add a fused mapper of a LiDAR and a shadow mapper."""
    reliefs = [name for name, part in scenario.mappers.items() if part.kind in _LIDAR]
    if not reliefs:
        raise InputError(
            "mappers", sorted(part.kind for part in scenario.mappers.values()),
            "must include the kind 'gaussian-dem' or 'quadtree' for perception='fused'",
        )  # fmt: skip
    rocks = [name for name, part in scenario.mappers.items() if part.kind == "shadow"]
    given: dict[str, Any] = {"mappers": {}} if rocks else _camera(scenario)
    of = [reliefs[0], *(rocks or given["mappers"])]
    name = _unused_name(scenario, "fused")
    mappers = given["mappers"] | {name: {"kind": "fused", "inputs": of}}
    return given | {"mappers": mappers, "decisions": {"map": name}}


def _camera(scenario: Scenario) -> dict[str, Any]:
    """Return the changes that add a shadow mapper, with camera and rock navigation.

    The camera is added only if the scenario has none; only inertial navigation is replaced.
    """
    cameras = [name for name, part in scenario.sensors.items() if part.kind == "camera"]
    camera = cameras[0] if cameras else _unused_name(scenario, "camera")
    name = _unused_name(scenario, "rocks")
    given: dict[str, Any] = {
        "mappers": {name: _map_size(scenario) | {"kind": "shadow", "sensor": camera}}
    }
    if not cameras:
        given["sensors"] = {camera: {"kind": "camera"}}
        given["tasking"] = {camera: {"kind": "periodic", "rate_hz": _PICTURES}}
    if scenario.navigation.kind == "inertial":
        given["navigation"] = {"kind": "rocks"}
    return given
