"""The onboard computer: measurements in, commands out.

It knows its briefing and what its sensors told it, and nothing of the world. `step` does a whole
control cycle; the loop calls its parts one by one where somebody outside decides where to land.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.commands import Command, SensorTask
from lunarsim.messages.measurements import InertialSamples, Measurements
from lunarsim.models.lander import Lander
from lunarsim.onboard.control.thrust import thrust_to_command
from lunarsim.onboard.guidance.apollo import ApolloGuidance
from lunarsim.onboard.guidance.divert import DivertCost, DivertLimits, divert_cost
from lunarsim.onboard.guidance.law import Target
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.onboard.policies.candidates import candidate_sites
from lunarsim.onboard.policies.contract import Candidates, Decision, Observation
from lunarsim.onboard.tasking.contract import Situation, Tasking

Array = NDArray[np.float64]

APPROACH, VERTICAL = 0, 1


@dataclass(frozen=True)
class Decisions:
    """When a policy is asked, and what it chooses from.

    Attributes
    ----------
    first_altitude, last_altitude
        Between which decisions are due, m.
    interval
        s.
    candidates, separation
        Number of sites and least distance between them, m.
    touchdown_sigma
        Expected miss on the map, an axis, m.
    """

    first_altitude: float
    last_altitude: float
    interval: float
    candidates: int
    separation: float
    touchdown_sigma: float


@dataclass(frozen=True)
class Approach:
    """How the site is approached.

    Attributes
    ----------
    vertical_altitude, vertical_speed
        Where the vertical descent begins, m above the site, and its speed, m/s.
    arrival_acceleration
        At the end of the polynomial (3,), m/s^2.
    time_to_go
        Fixed, s; None: the cheapest admissible.
    heading
        Azimuth of body x, rad.
    """

    vertical_altitude: float
    vertical_speed: float
    arrival_acceleration: tuple[float, float, float]
    time_to_go: float | None
    heading: float


class OnboardComputer:
    """Navigation, mappers, tasking, guidance and control of one lander.

    Parameters
    ----------
    lander, gravity
        Figures that the mission knows.
    site
        Where to land (3,), m.
    navigation, mappers, tasking
        Parts.
    approach, limits, decisions
        Settings.
    response_time
        Lag with which the vehicle follows, s.
    """

    def __init__(
        self,
        *,
        lander: Lander,
        gravity: float,
        site: Array,
        navigation: Navigation,
        mappers: dict[str, HazardMapper],
        takes: dict[str, str],
        tasking: Sequence[Tasking],
        approach: Approach,
        limits: DivertLimits,
        decisions: Decisions,
        response_time: float,
    ) -> None:
        self.lander = lander
        self.gravity = gravity
        self.limits = limits
        self.approach = approach
        self.decisions = decisions
        self.navigation = navigation
        self.mappers = mappers
        self.takes = takes
        self.tasking = tasking
        self.site = site
        self.phase = APPROACH
        self.time = 0.0
        self.telemetry: list[tuple[float, str, dict[str, Any]]] = []
        self.diverts: list[tuple[float, Array, Decision]] = []
        self.candidates: Candidates | None = None
        self.mapped = False
        self.vertical = VerticalDescent(gravity, approach.vertical_speed)
        self.guidance = ApolloGuidance(gravity, np.nan, lead=response_time)
        self._estimate: Estimate | None = None
        self._height = approach.vertical_altitude + lander.com_height
        self._next_decision = 0.0
        self._retimed = False
        self._aim: tuple[HazardMap, FloatMap] | None = None
        self._events = 0

    # --- what is known --------------------------------------------------------------------

    @property
    def estimate(self) -> Estimate:
        """Where the lander believes it is."""
        if self._estimate is None:
            raise RuntimeError("no measurement has come in yet")
        return self._estimate

    @property
    def altitude(self) -> float:
        """Estimated height of the pads above the site, m."""
        return float(self.estimate.position[2] - self.site[2] - self.lander.com_height)

    @property
    def mapper(self) -> HazardMapper:
        """The mapper whose map the policy decides on."""
        return next(iter(self.mappers.values()))

    @property
    def decision_due(self) -> bool:
        """True when the policy is to be asked in this cycle."""
        window = self.decisions
        return (
            self.phase == APPROACH
            and window.last_altitude <= self.altitude <= window.first_altitude
            and self.time >= self._next_decision - 1e-9
        )

    def cost_of(self, sites: Array, estimate: Estimate | None = None) -> DivertCost:
        """Return what it costs to fly from here to each of the sites (n, 3)."""
        return divert_cost(
            estimate or self.estimate,
            sites + np.array([0.0, 0.0, self._height]),
            self.lander,
            self.gravity,
            arrival_velocity=(0.0, 0.0, -self.approach.vertical_speed),
            limits=self.limits,
        )

    def observe(self) -> Observation:
        """Return what a policy is shown now."""
        section = self.decisions
        hazard_map = self.mapper.hazard_map()
        if self._aim is None or self._aim[0] is not hazard_map:
            self._aim = (hazard_map, hazard_map.dispersed(section.touchdown_sigma))
        aim = self._aim[1]
        self.candidates = candidate_sites(
            hazard_map,
            aim,
            self.estimate,
            self.site,
            self.lander,
            self.gravity,
            count=section.candidates,
            separation=section.separation,
            approach_height=self._height,
            limits=self.limits,
        )
        row, col = (int(v) for v in hazard_map.grid.cell(self.site[:2]))
        inside = bool(hazard_map.grid.contains(self.site[:2]))
        seen = inside and bool(hazard_map.observed[row, col])
        return Observation(
            time=self.time,
            estimate=self.estimate,
            hazard_map=hazard_map,
            candidates=self.candidates,
            site=self.site,
            site_p_safe=float(aim[row, col]) if seen else float("nan"),
            site_propellant=float(self.cost_of(self.site[None, :]).propellant[0]),
            time_to_go=self.guidance.time_to_go(self.time),
            propellant=self.estimate.mass - self.lander.dry_mass,
        )

    # --- a cycle --------------------------------------------------------------------------

    def take(self, measurements: Measurements) -> None:
        """Navigate and map by what has been measured."""
        self.time = measurements.time
        self.mapped = False
        if not measurements.items:
            self._estimate = self.navigation.estimate(measurements.time, measurements.mass)
        for name, measurement in measurements.items:
            before = self._estimate
            self.navigation.take(measurement, measurements.time)
            after = self.navigation.estimate(measurements.time, measurements.mass)
            self._estimate = after
            if isinstance(measurement, InertialSamples):
                continue
            for key, mapper in self.mappers.items():
                if before is not None:
                    mapper.correct(before, after)
                if self.takes[key] == name:
                    mapper.update(measurement, after)
                    self.mapped = True
            # What a mapper told of the lander counts at once.
            self._estimate = self.navigation.estimate(measurements.time, measurements.mass)
            self._follow_navigation()

    def _follow_navigation(self) -> None:
        """Note what navigation reports; a path planned from far off is planned afresh."""
        for event in self.navigation.events[self._events :]:
            self.telemetry.append((event.time, event.name, dict(event.details)))
            if event.name == "lock" and self.approach.time_to_go is None:
                self.retime()
        self._events = len(self.navigation.events)

    def tasks(self) -> list[SensorTask]:
        """Return what pointed sensors are to measure."""
        situation = Situation(self.time, self.altitude, self.site, self.estimate)
        tasks = (part.task(situation) for part in self.tasking)
        return [task for task in tasks if task is not None]

    def refresh(self) -> None:
        """Let mappers do what is due."""
        for mapper in self.mappers.values():
            mapper.refresh(self.time)

    def apply(self, decision: Decision) -> bool:
        """Carry out a decision; return False if its site is out of reach (the old one stays)."""
        self._next_decision = self.time + self.decisions.interval
        first, self._retimed = not self._retimed, True
        if decision.site is None:
            if first and self.approach.time_to_go is None:
                self.retime()
            return True
        site = np.asarray(decision.site, dtype=np.float64)
        time_to_go = float(self.cost_of(site[None, :]).time_to_go[0])
        if not np.isfinite(time_to_go):
            self.telemetry.append(
                (self.time, "divert-refused", {"site": site, "reason": "out of reach"})
            )
            return False
        self.diverts.append((self.time, self.site, decision))
        self.site = site
        self.guidance.arrival = self.time + time_to_go
        return True

    def retime(self) -> None:
        """Choose the time-to-go to the present site afresh.

        A divert does so anyway. Without this a lander that keeps its site would fly on the
        time-to-go of the start, and diverts would seem to save propellant.
        """
        time_to_go = float(self.cost_of(self.site[None, :]).time_to_go[0])
        if np.isfinite(time_to_go):
            self.guidance.arrival = self.time + time_to_go

    def command(self) -> Command:
        """Return what the vehicle is to do until the next cycle."""
        if self.phase == APPROACH and (
            self.altitude <= self.approach.vertical_altitude
            or self.guidance.time_to_go(self.time) <= 0.0
        ):
            self.phase = VERTICAL
            self.telemetry.append((self.time, "vertical-descent", {"altitude": self.altitude}))
        if self.phase == APPROACH:
            target = Target(
                self.site + np.array([0.0, 0.0, self._height]),
                np.array([0.0, 0.0, -self.approach.vertical_speed]),
                np.asarray(self.approach.arrival_acceleration),
            )
            thrust = self.guidance.command(self.estimate, target, self.time)
            tilt = self.limits.max_tilt
        else:
            landed = self.site + np.array([0.0, 0.0, self.lander.com_height])
            thrust = self.vertical.command(self.estimate, Target(landed), self.time)
            tilt = self.vertical.lean
        return thrust_to_command(
            thrust, self.estimate.mass, self.lander, self.approach.heading, tilt
        )

    def stop_sensors(self) -> None:
        """Ask for no more measurements of pointed sensors."""
        for part in self.tasking:
            part.stop()
