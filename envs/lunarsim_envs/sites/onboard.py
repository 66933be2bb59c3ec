"""Scenarios in which the mapper of a perception decides, flown by the whole simulation."""

from __future__ import annotations

from typing import Any

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim_envs.sites.view import deciding_mapper

# Kind of the mapper that draws the map of each perception; "onboard" is what the scenario has.
MAPPER_OF = {"shadows": "shadow", "quadtree": "quadtree", "fused": "fused"}
# Mappers of a LiDAR's scans, any of which a fused map is made of.
_LIDAR = ("gaussian-dem", "quadtree")
# Half side of a quadtree's landing zone over that of the lander's footprint, as in its paper.
_ZONE = 1.35
# Pictures a second of a camera that a scenario is given.
_PICTURES = 5.0


def perceiving(scenario: Scenario, perception: str) -> Scenario:
    """Return a scenario whose policy decides on the map of a perception.

    A scenario that has a mapper of its kind decides on that. Any other is given one: a quadtree in
    the place of the mapper that decided, on the same scans and ground; a map of shadows in its
    place, by the camera that there is or by one of its own, with navigation that tracks rocks; a
    fused map of the two.

    Parameters
    ----------
    scenario
        What flies.
    perception
        A name of `MAPPER_OF`, or "onboard", which changes nothing.

    Raises
    ------
    InputError
        If the scenario's other parts do not go with it.
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


def _named(scenario: Scenario, name: str) -> str:
    """Return a name that no mapper and no sensor of the scenario has."""
    while name in scenario.mappers or name in scenario.sensors:
        name += "_"
    return name


def _ground(scenario: Scenario) -> dict[str, Any]:
    """Return size and cells of the map that decides, as far as it says."""
    part = scenario.mappers[deciding_mapper(scenario)]
    return {key: getattr(part, key) for key in ("size_m", "posting_m") if hasattr(part, key)}


def _quadtree(scenario: Scenario) -> dict[str, Any]:
    before = deciding_mapper(scenario)
    name, part = _named(scenario, "quadtree"), scenario.mappers[before]
    if part.kind != "gaussian-dem":
        raise InputError(
            f"mappers.{before}.kind", part.kind,
            "quadtree, or gaussian-dem, whose scans a quadtree then takes",
        )  # fmt: skip
    lander = scenario.vehicle.make()
    sites = {
        "zone_m": _ZONE * (lander.leg_radius + 0.5 * lander.pad_diameter),
        "roughness_limit_m": lander.roughness_limit,
    }
    table = _ground(scenario) | {"kind": "quadtree", "sensor": part.sensor, "sites": sites}
    return {"mappers": {before: None, name: table}, "decisions": {"map": name}}


def _shadows(scenario: Scenario) -> dict[str, Any]:
    given = _camera(scenario)
    others = dict.fromkeys(scenario.mappers)
    name = next(iter(given["mappers"]))
    return given | {"mappers": others | given["mappers"], "decisions": {"map": name}}


def _fused(scenario: Scenario) -> dict[str, Any]:
    reliefs = [name for name, part in scenario.mappers.items() if part.kind in _LIDAR]
    if not reliefs:
        raise InputError(
            "mappers", sorted(part.kind for part in scenario.mappers.values()),
            "one of kind gaussian-dem or quadtree, which a fused map is made of",
        )  # fmt: skip
    rocks = [name for name, part in scenario.mappers.items() if part.kind == "shadow"]
    given: dict[str, Any] = {"mappers": {}} if rocks else _camera(scenario)
    of = [reliefs[0], *(rocks or given["mappers"])]
    name = _named(scenario, "fused")
    mappers = given["mappers"] | {name: {"kind": "fused", "of": of}}
    return given | {"mappers": mappers, "decisions": {"map": name}}


def _camera(scenario: Scenario) -> dict[str, Any]:
    """Return what a scenario lacks to map rocks by their shadows, with that mapper."""
    cameras = [name for name, part in scenario.sensors.items() if part.kind == "camera"]
    camera = cameras[0] if cameras else _named(scenario, "camera")
    name = _named(scenario, "rocks")
    given: dict[str, Any] = {
        "mappers": {name: _ground(scenario) | {"kind": "shadow", "sensor": camera}}
    }
    if not cameras:
        given["sensors"] = {camera: {"kind": "camera"}}
        given["tasking"] = {camera: {"kind": "periodic", "rate_hz": _PICTURES}}
    if scenario.navigation.kind == "inertial":
        given["navigation"] = {"kind": "rocks"}
    return given
