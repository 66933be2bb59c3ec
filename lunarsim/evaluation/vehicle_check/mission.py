"""Mission of a scenario for the design check: descent, measurements and diverts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.evaluation.vehicle_check.descent import (
    UP,
    ApproachPath,
    as_estimate,
    plan_approach,
    unlimited_lander,
)
from lunarsim.frames import angle_between
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.rotation import path_shape
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.onboard.hazards.fusion import FusedMapperSettings
from lunarsim.onboard.hazards.mapper import sensor_names
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.tasking.schedules import AtAltitudes
from lunarsim.scenario import Scenario

# Directions of the diverts that are examined, and fractions of the distance to the map's edge.
_DIRECTIONS, _SCALES = 8, np.arange(1, 9) / 8


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
        Time-to-go of the cheapest path to the new site, s; NaN: out of reach.
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
class SiteView:
    """Geometry of a measurement of the site on the nominal approach.

    Attributes
    ----------
    altitude
        Altitude of the footpads above the site, m.
    range
        Distance along the boresight to flat terrain at the height of the site, m.
    incidence, pointing
        Angle of the boresight from the vertical and from body -z, rad.
    """

    altitude: float
    range: float
    incidence: float
    pointing: float


class Mission:
    """Nominal mission of a scenario, planned over flat terrain and not flown.

    Parameters
    ----------
    scenario
        A valid scenario.

    Attributes
    ----------
    lander, software, sensors
        Lander, onboard software and sensors by name.
    gravity
        Downward acceleration at the site, m/s^2.
    path
        Planned approach.
    braking_propellant
        Minimum propellant of the braking phase before the approach, kg.

    Raises
    ------
    InputError
        If the vehicle is not a `Lander`, or the start is below the end of the approach.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.software = scenario, scenario.software()
        self.lander: Lander = scenario.vehicle.make()
        if not isinstance(self.lander, Lander):
            raise InputError(
                "vehicle.kind", scenario.vehicle.kind, "must be a lander of lunarsim or a subclass",
                "Custom vehicles of another class cannot be checked.",
            )  # fmt: skip
        self.sensors: dict[str, Any] = {n: part.make() for n, part in scenario.sensors.items()}
        self.gravity, approach = scenario.gravity_m_s2, self.software.approach
        start = self._approach_start()
        self.braking_propellant = self.lander.wet_mass - start.mass
        end = max(approach.vertical_altitude, approach.takeover_altitude) + self.lander.com_height
        if start.position[2] <= end:
            raise InputError(
                "start.position_m[2]", float(start.position[2]),
                f"must be above {end:g} m, the height at the end of the approach",
            )  # fmt: skip
        self.path: ApproachPath = plan_approach(
            self.software.guidance, approach, start, self.lander, self.gravity
        )

    def _approach_start(self) -> Estimate:
        """Return the start of the approach.

        With a braking phase, the approach starts `end_time_to_go` before the aim point of braking,
        and braking uses at least the propellant of an impulse that changes the velocity: ``m0 (1 -
        exp(-|v_1 - v_0| / v_e))``.
        """
        plan, braking, lander = self.scenario.start.make(), self.software.braking, self.lander
        position, velocity = np.array(plan.position), np.array(plan.velocity)
        if braking is None:
            return as_estimate(position, velocity, lander.wet_mass)
        end, left = braking.end(np.zeros(3)), braking.end_time_to_go
        at = end.position - left * end.velocity + 0.5 * left**2 * end.acceleration
        now = end.velocity - left * end.acceleration
        change = float(np.linalg.norm(now - velocity))
        mass = lander.wet_mass * float(np.exp(-change / lander.exhaust_velocity))
        return as_estimate(at, now, mass)

    @property
    def torque_keys(self) -> str:
        """Scenario keys that determine the control torque, for texts."""
        jets = "vehicle.thrusters.force_n or cluster_radius_m"
        return jets if isinstance(self.lander, JetLander) else "vehicle.torque_max_n_m"

    @property
    def start_mass(self) -> float:
        """Mass at the start of the approach, kg."""
        return float(self.path.mass[0])

    @property
    def vertical_descent(self) -> VerticalDescent | None:
        """Settings of the vertical descent; None if another law replaces it."""
        settings = self.software.terminal_descent or VerticalDescent()
        return settings if isinstance(settings, VerticalDescent) else None

    # --- terminal descent: constant deceleration to the descent speed at the site ----------------

    @property
    def _terminal_speeds(self) -> tuple[float, float]:
        """Downward speed at the end of the approach and at the site, m/s."""
        site = self.software.approach.vertical_descent_speed
        return max(-float(self.path.velocity[-1, 2]), site), site

    @property
    def terminal_deceleration(self) -> float:
        """Vertical deceleration that the terminal descent needs, m/s^2.

        It is ``(v_0^2 - v_1^2) / (2 h)`` from the speed at the end of the approach, at the height
        h, to the speed at the site.
        """
        first, last = self._terminal_speeds
        return (first**2 - last**2) / (2.0 * float(self.path.altitude[-1]))

    @property
    def terminal_time(self) -> float:
        """Duration of the terminal descent, s."""
        return 2.0 * float(self.path.altitude[-1]) / sum(self._terminal_speeds)

    @property
    def terminal_thrust(self) -> float:
        """Thrust of the terminal descent at its start, N."""
        return float(self.path.mass[-1]) * (self.gravity + self.terminal_deceleration)

    @property
    def touchdown_mass(self) -> float:
        """Mass at touchdown of the nominal descent, kg, by the rocket equation."""
        dv = (self.gravity + self.terminal_deceleration) * self.terminal_time
        return float(self.path.mass[-1] * np.exp(-dv / self.lander.exhaust_velocity))

    # --- measurements ----------------------------------------------------------------------------

    @cached_property
    def decision_map(self) -> tuple[str, list[Any]]:
        """Name of the decision map, and the settings of the mappers that measure for it.

        The name is that of `SiteEvaluator.decision_map_name`; empty without a mapper.
        """
        mappers = self.software.mappers
        fused = [name for name, part in mappers.items() if isinstance(part, FusedMapperSettings)]
        name = str(self.software.decisions.map) or next(iter([*fused, *mappers]), "")
        part = mappers.get(name)
        names = [name] if name else []
        if isinstance(part, FusedMapperSettings):
            names = list(part.inputs) or [n for n in mappers if n not in fused]
        return name, [mappers[n] for n in names]

    @property
    def map_sensors(self) -> list[str]:
        """Names of the sensors that measure for the decision map."""
        return list(dict.fromkeys(n for part in self.decision_map[1] for n in sensor_names(part)))

    def altitudes(self, sensor: str) -> tuple[float, ...] | None:
        """Return the altitudes (m) at which a sensor measures on the nominal approach.

        For repeated measurements these are the first and the last altitude before the last
        decision. None: the schedule does not state its altitudes.
        """
        due = getattr(self.software.tasking.get(sensor), "measurement_altitudes", None)
        if due is None:
            return None
        top, end = float(self.path.altitude[0]), float(self.path.altitude[-1])
        if due.at:
            # A measurement that is due above the start is made at the start.
            return tuple(sorted({min(h, top) for h in due.at if h >= end}, reverse=True))
        highest = min(top, float(due.highest))
        lowest = max(end, float(due.lowest), min(self.software.decisions.last_altitude, highest))
        return (highest, lowest) if highest >= lowest else ()

    def views(self, sensor: str) -> list[SiteView]:
        """Return the geometry of a sensor's measurements, from the highest to the lowest.

        The sensor points to the site, or straight down if its schedule requires it.
        """
        part, found = self.software.tasking.get(sensor), []
        for altitude in self.altitudes(sensor) or ():
            k = self.path.index_at(altitude)
            ray = -self.path.position[k]
            if isinstance(part, AtAltitudes) and part.boresight == "nadir":
                ray = ray[2] * UP
            found.append(
                SiteView(
                    float(self.path.altitude[k]), float(np.linalg.norm(ray)),
                    angle_between(ray, -UP), angle_between(ray, -self.path.direction[k]),
                )
            )  # fmt: skip
        return found

    @property
    def first_map_altitude(self) -> float:
        """Altitude of the first measurement for the decision map, m.

        It is infinite if no schedule states its altitudes, and 0 without a measurement.
        """
        known = [h for name in self.map_sensors if (h := self.altitudes(name)) is not None]
        return max([0.0, *(max(h) for h in known if h)]) if known else np.inf

    # --- diverts ---------------------------------------------------------------------------------

    @cached_property
    def edge(self) -> float:
        """Distance from the target to the outermost site of the map, m; 0: no diverts.

        The complete footprint of the lander is on the map there.
        """
        sizes = [float(s) for p in self.decision_map[1] if (s := getattr(p, "size", None))]
        if not sizes or self.scenario.policy.kind == "no-divert":
            return 0.0
        return max(0.5 * min(sizes) - self.footprint_radius, 0.0)

    @property
    def footprint_radius(self) -> float:
        """Radius of the circle around all pads, m."""
        return self.lander.leg_radius + 0.5 * self.lander.pad_diameter

    @cached_property
    def first_diverts(self) -> list[Divert]:
        """Diverts at the first decision, in eight directions, up to the edge of the map.

        The propellant does not limit them. The first decision is due at
        `decisions.first_altitude_m`, at the earliest when a sensor of the map has measured.
        """
        first = min(self.software.decisions.first_altitude, self.first_map_altitude)
        return self._diverts_at(first)

    @cached_property
    def reachable(self) -> list[Divert]:
        """Diverts in reach: at the first and last decision, and at their geometric mean."""
        if not self.first_diverts:
            return []
        first, last = self.first_diverts[0].altitude, self.software.decisions.last_altitude
        last = min(max(last, float(self.path.altitude[-1])), first)
        later = [d for h in (np.sqrt(first * last), last) for d in self._diverts_at(float(h))]
        return [d for d in (*self.first_diverts, *later) if np.isfinite(d.time_to_go)]

    def _diverts_at(self, altitude: float) -> list[Divert]:
        """Return the diverts at an altitude (m), from the shortest to the longest."""
        approach, law, path = self.software.approach, self.software.guidance, self.path
        index = path.index_at(altitude)
        if self.edge == 0.0 or index == len(path.time) - 1:
            return []
        here, angle = path.estimate(index), 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        ring = np.column_stack((np.sin(angle), np.cos(angle), np.zeros(_DIRECTIONS)))
        sites = np.concatenate([np.zeros((1, 3)), *(self.edge * s * ring for s in _SCALES)])
        ends, limits = approach.end(sites, self.lander), replace(approach.limits, reserve=0.0)
        cost = law.cost(here, ends, unlimited_lander(self.lander), self.gravity, limits)
        home = float(cost.propellant[0])
        base = home if np.isfinite(home) else float(path.mass[index] - path.mass[-1])
        found = []
        for site, position, time, propellant in zip(
            sites, ends.position, cost.time_to_go, cost.propellant, strict=True
        ):
            turn = 0.0
            if np.isfinite(time):
                end = PhaseEnd(position, ends.velocity, ends.acceleration)
                planned = path_shape(law).path(here.position, here.velocity, end, float(time))
                turn = angle_between(path.direction[index], planned.command + self.gravity * UP)
            away = float(np.hypot(*site[:2]))
            height = float(path.altitude[index])
            found.append(Divert(height, away, float(time), turn, float(propellant - base)))
        return found[1:]

    @cached_property
    def largest_rotation(self) -> float:
        """Largest rotation of the thrust on the approach or at a divert, rad."""
        u = self.path.direction[::10]
        along = float(np.arccos(np.clip(u @ u.T, -1.0, 1.0)).max())
        return max([along, *(d.rotation for d in self.reachable)])

    # --- notes -----------------------------------------------------------------------------------

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about simplifications for this scenario."""
        law, (name, parts) = self.software.guidance, self.decision_map
        kind = self.scenario.guidance.kind
        is_open = kind in ("optimal", "neural-optimal", "information-seeking")
        cases = {
            f"guidance '{kind}': its paths have no closed form; an Apollo path with its "
            "time-to-go is checked.": is_open or not hasattr(law, "shape"),
            "braking: only its minimum propellant is checked.": self.software.braking is not None,
            f"mappers.{name}: states no size_m; diverts are not checked.":
                bool(name) and not any(hasattr(p, "size") for p in parts),
            "approach: no path keeps its limits of angles; only gear and maps are checked.":
                not self.path.is_within_limits,
        }  # fmt: skip
        return tuple(text for text, applies in cases.items() if applies)
