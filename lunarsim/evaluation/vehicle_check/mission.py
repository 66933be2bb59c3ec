"""Mission of a scenario for the design check: descent, diverts, decision map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.evaluation.vehicle_check.descent import (
    DescentPath,
    PlannedApproach,
    as_estimate,
    path_shape,
    plan_approach,
    terminal_descent,
    unlimited_lander,
)
from lunarsim.messages.briefing import Briefing, FlightSoftware, InitialStateEstimate
from lunarsim.models.gravity import UniformGravity
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.vertical import descent_law
from lunarsim.onboard.hazards.fusion import FusedMapperSettings
from lunarsim.onboard.hazards.mapper import sensor_names
from lunarsim.scenario import Scenario
from lunarsim.typing import Array

# Directions of the diverts that are examined, and fractions of the distance to the map's edge.
_DIRECTIONS = 8
_SCALES = (0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0)


@dataclass(frozen=True)
class Divert:
    """Divert from the nominal approach, at one altitude.

    Attributes
    ----------
    altitude
        Altitude of the footpads above the site at the decision, m.
    distance
        Distance of the new site from the target, m.
    time_to_go
        Time-to-go of the cheapest path to the new site, s.
    rotation
        Angle between the thrust directions before and after the decision, rad.
    extra_propellant
        Propellant to the new site minus propellant to the target, kg.
    """

    altitude: float
    distance: float
    time_to_go: float
    rotation: float
    extra_propellant: float


@dataclass(frozen=True)
class Mission:
    """Scenario, its parts, and its nominal descent.

    Attributes
    ----------
    scenario, lander, software, sensors
        Scenario, and its lander, onboard software and sensors by name.
    gravity
        Downward acceleration at the site, m/s^2.
    approach
        Planned approach.
    terminal, lands
        Nominal terminal descent, and whether it reaches the site.
    terminal_law
        Guidance law of the terminal descent.
    braking_propellant
        Minimum propellant of the braking phase before the approach, kg.
    diverts
        Reachable diverts at the examined decisions, to several distances.
    reach
        Distance of the farthest sites that can be reached in all directions at the first decision,
        m.
    edge
        Distance from the target to the outermost site of the decision map, m; 0: no diverts.
    edge_propellant
        Extra propellant of a divert to `edge` at the first decision, kg; to `reach` if the edge is
        out of reach.
    notes
        Sentences about simplifications and about what cannot be checked.
    """

    scenario: Scenario
    lander: Lander
    software: FlightSoftware
    sensors: Mapping[str, Any]
    gravity: float
    approach: PlannedApproach
    terminal: DescentPath
    lands: bool
    terminal_law: Any
    braking_propellant: float
    diverts: tuple[Divert, ...]
    reach: float
    edge: float
    edge_propellant: float
    notes: tuple[str, ...]

    @property
    def touchdown_mass(self) -> float:
        """Mass at touchdown of the nominal descent, kg; at least the dry mass."""
        return max(float(self.terminal.mass[-1]), self.lander.dry_mass)

    @property
    def start_mass(self) -> float:
        """Mass at the start of the approach, kg."""
        return float(self.approach.path.mass[0])

    @property
    def law(self) -> Any:
        """Settings of the guidance law of the approach."""
        return self.software.guidance

    @property
    def allows_diverts(self) -> bool:
        """Whether the policy may choose another site."""
        return self.edge > 0.0

    def measurement_altitudes(self, sensor: str) -> tuple[float, ...]:
        """Return the altitudes (m) at which a sensor measures on the nominal approach.

        For repeated measurements these are the first and the last altitude before the last
        decision. The result is empty if the schedule does not state its altitudes.
        """
        part = self.software.tasking.get(sensor)
        altitudes = getattr(part, "measurement_altitudes", None)
        if altitudes is None:
            return ()
        path, last = self.approach.path, self.software.decisions.last_altitude
        top, end = float(path.altitude[0]), float(path.altitude[-1])
        if altitudes.at:
            # A measurement that is due above the start is made at the start.
            return tuple(sorted({min(h, top) for h in altitudes.at if h >= end}, reverse=True))
        highest = min(top, float(altitudes.highest))
        lowest = max(end, float(altitudes.lowest), min(last, highest))
        return (highest, lowest) if highest >= lowest else ()


def plan_mission(scenario: Scenario) -> Mission:
    """Plan the nominal mission of a scenario for the design check.

    Raises
    ------
    InputError
        If the vehicle is not a `Lander`, or the start is below the end of the approach.
    """
    lander = scenario.vehicle.make()
    if not isinstance(lander, Lander):
        raise InputError(
            "vehicle.kind", scenario.vehicle.kind, "must be a lander of lunarsim or a subclass",
            "Custom vehicles of another class cannot be checked.",
        )  # fmt: skip
    software = scenario.software()
    sensors = {name: part.make() for name, part in scenario.sensors.items()}
    gravity, notes = scenario.gravity_m_s2, list(_notes(scenario, software))
    start, braking = _approach_start(scenario, software, lander)
    end_height = software.approach.vertical_altitude + lander.com_height
    if start.position[2] <= end_height:
        raise InputError(
            "start.position_m[2]", float(start.position[2]),
            f"must be above {end_height:g} m, the height at the end of the approach",
        )  # fmt: skip
    planned = plan_approach(software.guidance, software.approach, start, lander, gravity)
    briefing = _briefing(scenario, software, lander, sensors, planned.time_to_go)
    law = descent_law(
        software.terminal_descent, briefing, software.control.response_time + lander.thrust_lag
    )
    terminal, lands = terminal_descent(
        law, software.approach, planned.path.estimate(-1), lander,
        scenario.simulation.make().cycle, gravity,
    )  # fmt: skip
    edge, first = _edge_of_map(scenario, software, lander, sensors)
    diverts, reach, cost = _examine_diverts(software, lander, gravity, planned.path, edge, first)
    return Mission(
        scenario, lander, software, sensors, gravity, planned, terminal, lands, law, braking,
        diverts, reach, edge, cost, tuple(notes),
    )  # fmt: skip


def _notes(scenario: Scenario, software: FlightSoftware) -> tuple[str, ...]:
    """Return sentences about simplifications for a scenario."""
    notes = []
    kind = scenario.guidance.kind
    if kind in ("optimal", "neural-optimal", "information-seeking") or not hasattr(
        software.guidance, "shape"
    ):
        notes.append(
            f"guidance '{kind}': its paths have no closed form; an Apollo path with its "
            "time-to-go is checked."
        )
    if software.braking is not None:
        notes.append(
            "braking: only its minimum propellant is included; thrust and rotations of the "
            "braking phase are not checked."
        )
    if scenario.moon is not None:
        notes.append("moon: the approach is checked over flat terrain in uniform gravity.")
    name = decision_mapper(software)
    if name is not None and not _map_sizes(software, name):
        notes.append(f"mappers.{name}: states no size_m; diverts are not checked.")
    if scenario.faults is not None:
        notes.append("faults: the lander is checked without faults.")
    return tuple(notes)


def _approach_start(
    scenario: Scenario, software: FlightSoftware, lander: Lander
) -> tuple[Any, float]:
    """Return the start state of the approach, and the propellant used before, kg.

    With a braking phase, the approach starts `end_time_to_go` before the aim point of braking, and
    braking uses at least the propellant of an impulse that changes the velocity:
    ``m0 (1 - exp(-|v_1 - v_0| / v_e))``.
    """
    plan = scenario.start.make()
    position, velocity = np.array(plan.position), np.array(plan.velocity)
    if software.braking is None:
        return as_estimate(position, velocity, lander.wet_mass), 0.0
    end, left = software.braking.end(np.zeros(3)), software.braking.end_time_to_go
    at = end.position - left * end.velocity + 0.5 * left**2 * end.acceleration
    now = end.velocity - left * end.acceleration
    change = float(np.linalg.norm(now - velocity))
    mass = lander.wet_mass * float(np.exp(-change / lander.exhaust_velocity))
    return as_estimate(at, now, mass), lander.wet_mass - mass


def _briefing(
    scenario: Scenario, software: FlightSoftware, lander: Lander, sensors: Mapping[str, Any],
    time_to_go: float,
) -> Briefing:  # fmt: skip
    """Return the data with which the law of the terminal descent is built.

    It has the planned start without errors, uniform gravity and no prior map.
    """
    start, clock = scenario.start.make(), scenario.simulation.make()
    known = InitialStateEstimate(
        np.array(start.position), np.array(start.velocity), np.array([0.0, 0.0, 0.0, 1.0]),
        0.0, 0.0, 0.0,
    )  # fmt: skip
    return Briefing(
        software=software, lander=lander,
        instruments={name: sensor.calibration() for name, sensor in sensors.items()},
        gravity=UniformGravity(scenario.gravity_m_s2), target=np.zeros(3), heading=start.heading,
        start=known, time_to_go=time_to_go, sun=scenario.sun.make().direction,
        rocks=scenario.expected_rocks.make(), prior_map=None, step=clock.step, cycle=clock.cycle,
    )  # fmt: skip


def decision_mapper(software: FlightSoftware) -> str | None:
    """Return the name of the mapper whose map is used for decisions, or None."""
    mappers = software.mappers
    if software.decisions.map:
        return str(software.decisions.map)
    fused = [name for name, part in mappers.items() if isinstance(part, FusedMapperSettings)]
    names = fused or list(mappers)
    return names[0] if names else None


def source_mappers(software: FlightSoftware, name: str) -> tuple[str, ...]:
    """Return the mappers that measure for a mapper: itself, or the inputs of a fusion."""
    part = software.mappers[name]
    if not isinstance(part, FusedMapperSettings):
        return (name,)
    others = [n for n, p in software.mappers.items() if not isinstance(p, FusedMapperSettings)]
    return tuple(part.inputs) or tuple(others)


def _map_sizes(software: FlightSoftware, name: str) -> list[float]:
    """Return the sides (m) of the maps behind a mapper, if their settings state them."""
    sources = [software.mappers[n] for n in source_mappers(software, name)]
    return [float(s.size) for s in sources if isinstance(getattr(s, "size", None), float | int)]


def _edge_of_map(
    scenario: Scenario, software: FlightSoftware, lander: Lander, sensors: Mapping[str, Any]
) -> tuple[float, float]:
    """Return distance to the outermost site, and altitude of the first decision, m.

    The outermost site has its complete footprint on the map: half the side of the map minus leg
    radius and half a pad. The first decision is due at `decisions.first_altitude_m`, at the
    earliest when a sensor of the map has measured. The distance is 0 without diverts.
    """
    name = decision_mapper(software)
    if name is None or scenario.policy.kind == "no-divert":
        return 0.0, 0.0
    sources = [software.mappers[n] for n in source_mappers(software, name)]
    sizes = _map_sizes(software, name)
    if not sizes:
        return 0.0, 0.0
    highest = [_highest(software.tasking.get(n)) for s in sources for n in sensor_names(s)]
    first = min(software.decisions.first_altitude, max(highest, default=np.inf))
    footprint = lander.leg_radius + 0.5 * lander.pad_diameter
    return max(0.5 * min(sizes) - footprint, 0.0), float(first)


def _highest(tasking: Any) -> float:
    """Return the highest altitude of a schedule's measurements, m; inf: no limit."""
    altitudes = getattr(tasking, "measurement_altitudes", None)
    if altitudes is None:
        return float("inf")
    return max(altitudes.at) if altitudes.at else float(altitudes.highest)


def _examine_diverts(
    software: FlightSoftware, lander: Lander, gravity: float, path: DescentPath, edge: float,
    first: float,
) -> tuple[tuple[Divert, ...], float, float]:  # fmt: skip
    """Return the reachable diverts, the reach (m) and the cost of the edge (kg).

    They are examined at the first decision, the last, and their geometric mean, in eight
    directions, up to the map's edge. Propellant does not limit them here.
    """
    if edge <= 0.0:
        return (), 0.0, 0.0
    last = software.decisions.last_altitude
    last = min(max(last, float(path.altitude[-1])), first)
    found, reach, cost = [], 0.0, 0.0
    for k, altitude in enumerate((first, float(np.sqrt(first * last)), last)):
        index = path.index_at(altitude)
        if index >= len(path.time) - 1:
            continue
        grid, feasible, extra = _divert_grid(software, lander, gravity, path, index, edge)
        found += [d for ring, able in zip(grid, feasible, strict=True)
                  for d, a in zip(ring, able, strict=True) if a]  # fmt: skip
        if k == 0:
            complete = [s for s in range(len(_SCALES)) if feasible[: s + 1].all()]
            reach = edge * _SCALES[complete[-1]] if complete else 0.0
            k_edge = -1 if feasible[-1].any() else (complete[-1] if complete else 0)
            cost = float(extra[k_edge][feasible[k_edge]].max(initial=0.0))
    return tuple(found), reach, cost


def _divert_grid(
    software: FlightSoftware, lander: Lander, gravity: float, path: DescentPath, index: int,
    edge: float,
) -> tuple[list[list[Divert]], Array, Array]:  # fmt: skip
    """Return diverts, feasibility and extra propellant (kg) by distance, direction.

    The last two are arrays (scales, directions).
    """
    approach, law, shape = software.approach, software.guidance, path_shape(software.guidance)
    here = path.estimate(index)
    angle = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ring = np.column_stack((np.sin(angle), np.cos(angle), np.zeros(_DIRECTIONS)))
    sites = np.concatenate([np.zeros((1, 3)), *(edge * s * ring for s in _SCALES)])
    ends = approach.end(sites, lander)
    limits = replace(approach.limits, reserve=0.0)
    cost = law.cost(here, ends, unlimited_lander(lander), gravity, limits)
    home = cost.propellant[0]
    base = home if np.isfinite(home) else float(path.mass[index] - path.mass[-1])
    before, rows = path.direction[index], []
    for k in range(1, len(sites)):
        time = float(cost.time_to_go[k])
        turn = 0.0
        if np.isfinite(time):
            end = PhaseEnd(ends.position[k], ends.velocity, ends.acceleration)
            command = shape.path(here.position, here.velocity, end, time).command
            turn = angle_between(before, command + np.array([0.0, 0.0, gravity]))
        extra = float(cost.propellant[k] - base)
        away = float(np.hypot(*sites[k, :2]))
        rows.append(Divert(float(path.altitude[index]), away, time, turn, extra))
    grid = [rows[i : i + _DIRECTIONS] for i in range(0, len(rows), _DIRECTIONS)]
    shape2 = (len(_SCALES), _DIRECTIONS)
    feasible = np.isfinite(cost.time_to_go[1:]).reshape(shape2)
    return grid, feasible, np.asarray((cost.propellant[1:] - base).reshape(shape2))


def angle_between(a: Array, b: Array) -> float:
    """Return the angle between two vectors (3,), rad."""
    cross = float(np.linalg.norm(np.cross(a, b)))
    return float(np.arctan2(cross, float(np.dot(a, b))))
