"""The onboard computer: measurements in, commands out.

It is built from a briefing and meets nothing else: no world, no true state, no loop. `step` does a
whole control cycle; the loop calls its parts one by one where somebody outside decides.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim._blas import one_blas_thread
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import Command, SensorTask
from lunarsim.messages.measurements import InertialSamples, Measurements
from lunarsim.models.jet_lander import JetLander
from lunarsim.onboard.control.jets import JetLoop, attitude_loop
from lunarsim.onboard.control.throttle import ThrottleRegions
from lunarsim.onboard.control.thrust import thrust_to_command
from lunarsim.onboard.divert_bar import DivertBar
from lunarsim.onboard.guidance.apollo import followed_time
from lunarsim.onboard.guidance.arrival import set_by_others, time_at_gate
from lunarsim.onboard.guidance.climb import climb
from lunarsim.onboard.guidance.contract import PhaseEnd, PlansArrival, SeesByMap
from lunarsim.onboard.guidance.divert import DivertCost
from lunarsim.onboard.guidance.steady import SteadyPlace
from lunarsim.onboard.guidance.strain import Strain
from lunarsim.onboard.guidance.vertical import descent_law
from lunarsim.onboard.hazards.building import built_mappers
from lunarsim.onboard.hazards.hazard_map import HazardMap, elevation_under
from lunarsim.onboard.hazards.levelling import Levelling
from lunarsim.onboard.hazards.mapper import HazardMapper, sensors_of
from lunarsim.onboard.named_errors import named_in
from lunarsim.onboard.navigation.arrivals import Arrivals
from lunarsim.onboard.navigation.estimate import Estimate, ThrustAware
from lunarsim.onboard.outlook import Course, Outlook
from lunarsim.onboard.part_results import checked_command
from lunarsim.onboard.policies.contract import (
    Candidates,
    Decision,
    Observation,
    RetargetingPolicy,
    checked_decision,
)
from lunarsim.onboard.tank_account import TankAccount
from lunarsim.onboard.tasking.contract import Situation

Array = NDArray[np.float64]

APPROACH, VERTICAL, ABORT, BRAKING = 0, 1, 2, 3


class OnboardComputer:
    """Navigation, mappers, tasking, policy, guidance and control of one lander.

    Parameters
    ----------
    briefing
        All that it knows beforehand, its own software included.
    policy
        Decides where to land; None: somebody outside does, by `apply`.

    Attributes
    ----------
    site
        Where it is flying to, local frame (3,), m.
    telemetry
        What happened: time (s), name, details.
    outlook
        Where the lander could go, and what a policy is shown of it.
    tanks
        What is left in them, by the computer's own account.
    diverts
        Decisions that changed the site: time (s), old site, decision.
    mapped
        Names of the mappers that took something in during this cycle.
    expected_miss
        Of the site when a policy was last shown it, 1 sigma an axis, m; NaN until then.
    """

    def __init__(self, briefing: Briefing, policy: RetargetingPolicy | None = None) -> None:
        software = briefing.software
        self.briefing = briefing
        self.policy = policy
        self.lander = briefing.lander
        self.approach = software.approach
        self.decisions = software.decisions
        with named_in("navigation"):
            self.navigation = software.navigation.build(briefing)
        self.mappers = built_mappers(briefing, self.navigation)
        self.outlook = Outlook(briefing, self.navigation, self.mappers)
        self.tasking = [part.build(name, briefing) for name, part in software.tasking.items()]
        control = software.control
        lag = control.response_time + self.lander.thrust_lag
        with named_in("guidance"):
            self.guidance = software.guidance.build(briefing, lag)
        if isinstance(self.guidance, SeesByMap):
            self.guidance.belief = self._belief
        self.vertical = descent_law(software.descent, briefing, lag)
        self.braking = software.braking
        self._brake: Any = None
        if self.braking is not None:
            self._brake = self.braking.part().build(briefing, lag)
        self.attitude_loop = attitude_loop(control, self.lander, briefing.step)
        self.throttle = (
            ThrottleRegions(self.lander.engine) if isinstance(self.lander, JetLander) else None
        )
        self.site: Array = briefing.target.copy()
        self.phase = APPROACH if software.braking is None else BRAKING
        self.time = 0.0
        self.tanks = TankAccount(self.lander, self.attitude_loop)
        self.estimate: Estimate = self.navigation.estimate(0.0, self.mass)
        self._place = SteadyPlace()
        self._strain = Strain()
        self.telemetry: list[tuple[float, str, dict[str, Any]]] = []
        self.diverts: list[tuple[float, Array, Decision]] = []
        self.candidates: Candidates | None = None
        self.mapped: set[str] = set()
        self.expected_miss = float("nan")
        self._arrival = briefing.time_to_go
        self._thrust = 0.0
        self._jets_out = 0
        self._target: Array = briefing.target.copy()
        self._next_decision = 0.0
        self._decided = False
        self._events = self._told = 0
        self._arrivals = Arrivals.of(briefing, self._note)
        self._bar = DivertBar()
        self._levelling = Levelling(self.mappers, self.navigation)

    # --- what is known --------------------------------------------------------------------

    @property
    def mass(self) -> float:
        """Of the lander, by what has been asked of its engine and thrusters, kg."""
        return self.tanks.mass

    @property
    def altitude(self) -> float:
        """Estimated height of the pads above the site, m."""
        return self._height(self.estimate)

    def _note(self, time: float, name: str, details: dict[str, Any]) -> None:
        self.telemetry.append((time, name, details))

    def _height(self, estimate: Estimate) -> float:
        level = float(self.briefing.gravity.height(estimate.position))
        return level - float(self.site[2]) - self.lander.com_height

    @property
    def time_to_go(self) -> float:
        """Until the end of the approach is to be reached, s."""
        return self._arrival - self.time

    @property
    def decisions_map(self) -> str:
        """Name of the mapper whose map decides; empty for a lander without one."""
        return self.outlook.decisions_map

    @property
    def mapper(self) -> HazardMapper | None:
        """The mapper whose map decides; None for a lander without one."""
        return self.outlook.mapper

    def _belief(self) -> HazardMap | None:
        """Return the map that decides as it stands; None for a lander without one."""
        return None if self.mapper is None else self.mapper.hazard_map()

    @property
    def diverts_barred(self) -> bool:
        """Whether the lander keeps its site, whatever a policy wants; see `DivertBar`."""
        return self._bar.barred

    @property
    def decision_due(self) -> bool:
        """True when the policy is to be asked in this cycle."""
        window = self.decisions
        return (
            self.phase == APPROACH
            and not self.diverts_barred
            and self.mapper is not None
            and window.last_altitude <= self.altitude <= window.first_altitude
            and self.time >= self._next_decision - 1e-9
        )

    def cost_of(self, sites: Array, estimate: Estimate | None = None) -> DivertCost:
        """Return what it costs to fly from here to each of the sites (n, 3), local frame."""
        return self.outlook.cost_of(sites, estimate or self.estimate)

    def observe(self) -> Observation:
        """Return what a policy is shown now."""
        course = Course(self.time, self.mass, self.estimate, self.site, self.time_to_go)
        shown = self.outlook.observe(course)
        self.candidates, self.expected_miss = shown.candidates, shown.expected_miss
        return shown

    # --- a cycle --------------------------------------------------------------------------

    @one_blas_thread()
    def step(self, measurements: Measurements) -> Command:
        """Do a whole control cycle."""
        self.update(measurements)
        self.decide()
        return self.command()

    def decide(self) -> None:
        """Ask the policy, if there is one and a decision is due."""
        if self.policy is not None and self.decision_due:
            self.apply(self.policy.decide(self.observe()))

    def update(self, measurements: Measurements) -> None:
        """Navigate and map by what has been measured since the last cycle.

        Raises
        ------
        InputError
            If time runs backwards. A measurement that was made before the last one of its sensor,
            or in the future, is left out and reported as "out-of-order".
        """
        self._arrivals.advance(measurements.time)
        elapsed = measurements.time - self.time
        # The tanks are not gauged: what the engine was asked for has been burnt.
        if isinstance(self.navigation, ThrustAware):
            self.navigation.commanded(self._thrust, elapsed)
        for name in self.tanks.burn(self._thrust, elapsed):
            self._note(measurements.time, name, {"altitude": self.altitude})
        if isinstance(self.attitude_loop, JetLoop):
            failed = self.attitude_loop.watch.failed
            for number in failed[self._jets_out :]:
                self._note(measurements.time, "thruster-failed", {"thruster": number})
            self._jets_out = len(failed)
        self.time = measurements.time
        self.mapped = set()
        # The state is carried to now before anything corrects it, in whatever order things came.
        for sensor, measurement in sorted(
            measurements.items, key=lambda item: not isinstance(item[1], InertialSamples)
        ):
            self._take(sensor, measurement)
        self.outlook.mapped(self.mapped, self.time)
        self._carry_on()
        self.estimate = self.navigation.estimate(self.time, self.mass)
        for mapper in self.mappers.values():
            mapper.refresh(self.time)
        if self._bar.changes(self.estimate.lost, bool(self.mapped)):
            name = "diverts-barred" if self.diverts_barred else "diverts-allowed"
            self._note(self.time, name, {"site": self.site.copy()})
        self._level_site()
        begins = not self._decided and elapsed == 0.0 and self.phase == APPROACH
        if begins and self.approach.free:
            # The plan was made for the planned start: begin from where the lander is.
            self._retime()

    def _carry_on(self) -> None:
        """Let navigation know of inertial samples that did not come in this cycle."""
        overdue = self._arrivals.overdue(self.time)
        if overdue is not None:
            self.navigation.take(*overdue, self.time)
            self._follow_navigation()

    def _take(self, sensor: str, given: Any) -> None:
        measurement = self._arrivals.admit(sensor, given, self.time)
        if measurement is None:
            return
        if isinstance(measurement, InertialSamples):
            self.navigation.take(sensor, measurement, self.time)
            self._follow_navigation()
            return
        self._carry_on()
        self.navigation.take(sensor, measurement, self.time)
        self._follow_navigation()
        software = self.briefing.software.mappers
        taking = [name for name in self.mappers if sensor in sensors_of(software[name])]
        if not taking:
            return
        after = self.navigation.estimate(self.time, self.mass)
        for name in taking:
            self.mappers[name].take(sensor, *self.navigation.corrected(sensor, measurement, after))
            self.mapped.add(name)
        self.mapped |= {n for n, m in self.mappers.items() if m.sources & self.mapped}

    def _follow_navigation(self) -> None:
        """Note what navigation reports, and move the briefed target where it is known to lie."""
        shift = self.navigation.site_to_local
        target = shift.to_local(self.briefing.target)
        if not np.array_equal(target, self._target):
            self._target = target
            # What is learnt of it during the last metres would be chased.
            if not self.diverts and self.phase != VERTICAL:
                self.site = target
                for mapper in self.mappers.values():
                    mapper.recentre(target)
        self._levelling.follow(self.time, self.mass)
        for event in self.navigation.events[self._events :]:
            self._note(event.time, event.name, dict(event.details))
            free = self.phase == APPROACH and self.approach.free
            if event.name in {"lock", "relock"} and free:
                # A path planned from tens of metres off is planned afresh.
                self.estimate = self.navigation.estimate(self.time, self.mass)
                self._retime()
        self._events = len(self.navigation.events)

    def _level_site(self) -> None:
        """Take the height of the site from the ground as it has been mapped there.

        What the mission says of it, and what navigation errs by in height, counts until then.
        """
        mapper = self.mapper
        if mapper is None or mapper.blank:
            return
        height = mapper.ground_height(self.site[:2])
        if height is None:
            height = elevation_under(mapper.surface(), self.site[:2])
        if np.isfinite(height):
            self.site = np.array([self.site[0], self.site[1], height])

    def apply(self, decision: Decision) -> bool:
        """Carry out a decision; return False if the old site stays though it wants another.

        That is so where its site is out of reach, and while diverts are barred. For a stretch that
        cannot be flown see `Decision`.

        Raises
        ------
        InputError
            If a policy gave something else.
        """
        decision = checked_decision(self.policy, decision, self.time)
        self._next_decision = self.time + self.decisions.interval
        if decision.abort:
            self.phase = ABORT
            told = {"altitude": self.altitude, "reason": decision.reason}
            self._note(self.time, "abort", told)
            return True
        first, self._decided = not self._decided, True
        stretch = self._stretch_of(decision)
        if decision.site is None:
            if stretch is not None or (first and self.approach.free):
                self._retime(stretch)
            return True
        site = np.asarray(decision.site, dtype=np.float64)
        if self.diverts_barred:
            self._refuse(site, "navigation is lost")
            return False
        time_to_go, why = self.outlook.time_to(site, self.estimate, stretch)
        if not np.isfinite(time_to_go):
            self._refuse(site, "out of reach")
            return False
        if not self.outlook.in_sight(site, self.estimate):
            self._refuse(site, "out of sight")
            return False
        self.diverts.append((self.time, self.site, decision))
        self.site = site
        self._arrival = self.time + time_to_go
        if why:
            self._refuse(site, why, stretch)
        return True

    def _refuse(self, site: Array, reason: str, stretch: float | None = None) -> None:
        """Note that a divert is refused, or, if one is given, its stretch alone."""
        told = {"site": site.copy(), "reason": reason}
        if stretch is None:
            self._note(self.time, "divert-refused", told)
        else:
            self._note(self.time, "stretch-refused", told | {"stretch": float(stretch)})

    def _stretch_of(self, decision: Decision) -> float | None:
        """Return the stretch that a decision asks for; None where it is not for a policy to ask."""
        if decision.stretch is None:
            return None
        why = set_by_others(self.approach, self.guidance)
        if self.diverts_barred:
            why = "navigation is lost"
        elif self.phase != APPROACH:
            why = "not on the approach"
        if not why:
            return decision.stretch
        site = self.site if decision.site is None else np.asarray(decision.site, dtype=np.float64)
        self._refuse(site, why, decision.stretch)
        return None

    def _retime(self, stretch: float | None = None) -> None:
        """Choose the time-to-go to the present site afresh.

        A divert does so anyway. Without this a lander that keeps its site would fly on the
        time-to-go of the start, and diverts would seem to save propellant.
        """
        time_to_go, why = self.outlook.time_to(self.site, self.estimate, stretch)
        if np.isfinite(time_to_go):
            self._arrival = self.time + time_to_go
        if why:
            self._refuse(self.site, why, stretch)

    def _arrive_later(self) -> None:
        """Take longer for a path that asks for too much, if a longer one keeps the limits.

        Where the mission fixes the time, or a law its own, that stands.
        """
        if set_by_others(self.approach, self.guidance):
            return
        time_to_go, _ = self.outlook.time_to(self.site, self.estimate)
        if self.time_to_go < time_to_go < np.inf:
            later = time_to_go - self.time_to_go
            self._arrival = self.time + time_to_go
            self._note(self.time, "arrives-later", {"seconds": later})

    def _end_braking(self) -> None:
        """Follow the time-to-go of braking; begin the approach when its end comes."""
        left = self.braking.time_left(self.estimate, self.braking.end(self.site), self.time_to_go)
        self._arrival = self.time + left
        if left > self.braking.ends_at:
            return
        self.phase = APPROACH
        told = {"altitude": self.altitude}
        self._note(self.time, "approach", told)
        gate = self.approach.end(self.site, self.lander)
        admissible, _ = self.outlook.time_to(self.site, self.estimate)
        left, within = time_at_gate(self.approach, self.estimate, gate, admissible)
        if not within:
            self._note(self.time, "approach-out-of-limits", told)
        self._arrival = self.time + left

    def command(self) -> Command:
        """Return what vehicle and sensors are to do until the next cycle."""
        if self.phase == BRAKING:
            self._end_braking()
        if self.phase == APPROACH and self.approach.jerk is not None:
            gate = self.approach.end(self.site, self.lander)
            left = followed_time(self.estimate, gate, self.approach.jerk, self.time_to_go)
            self._arrival = self.time + left
        if self.phase == APPROACH and self.approach.over(self.altitude, self.time_to_go):
            self.phase = VERTICAL
            self._note(self.time, "vertical-descent", {"altitude": self.altitude})
        asked = self._brake_on() if self.phase == BRAKING else self._steer()
        if self.throttle is not None:
            asked = replace(asked, thrust=self.throttle.allowed(asked.thrust))
        command = replace(asked, tasks=self._tasks(), abort=self.phase == ABORT)
        self._thrust = command.thrust
        self.attitude_loop.begin(command, self.estimate.attitude, self.mass)
        return command

    def _brake_on(self) -> Command:
        """Return what braking asks of the vehicle."""
        end = self.braking.end(self.site)
        wanted = self._brake.command(self.estimate, end, self.time, self.time_to_go)
        asked: Command = self.braking.ask(
            wanted, self.mass, self.lander, self.briefing.heading, self.time
        )
        return asked

    def _steer(self) -> Command:
        """Return what approach, descent or climb ask of the vehicle."""
        end: PhaseEnd
        here = self._steadied()
        if self.phase == APPROACH:
            end = self.approach.end(self.site, self.lander)
            given = self.guidance.command(here, end, self.time, self.time_to_go)
            wanted = checked_command("guidance", self.briefing.software.guidance, given, self.time)
            tilt = self.approach.max_tilt
            self._follow_guidance()
            if self._strain.lasts(wanted, self.mass, (tilt, self.lander.thrust_max), self.time):
                self._arrive_later()
        elif self.phase == VERTICAL:
            end = self.approach.ground(self.site, self.lander)
            given = self.vertical.command(here, end, self.time)
            wanted = checked_command("descent", self.briefing.software.descent, given, self.time)
            tilt = self.vertical.lean
        else:
            wanted = climb(self.estimate, self.lander.thrust_max / self.mass)
            tilt = self.approach.max_tilt
        return thrust_to_command(wanted, self.mass, self.lander, self.briefing.heading, tilt)

    def _steadied(self) -> Estimate:
        """Return where guidance takes the lander to be on the last part of the way."""
        if not self.navigation.steps or self.phase not in {APPROACH, VERTICAL}:
            return self.estimate
        return self._place.of(self.estimate, self.time_to_go if self.phase == APPROACH else 0.0)

    def _follow_guidance(self) -> None:
        """Take over when a law means to arrive, if it says so, and what it reports."""
        if not isinstance(self.guidance, PlansArrival):
            return
        if self.guidance.arrival is not None:
            self._arrival = self.guidance.arrival
        self.telemetry += self.guidance.events[self._told :]
        self._told = len(self.guidance.events)

    def _tasks(self) -> tuple[SensorTask, ...]:
        """Return what pointed sensors are to measure at the end of the cycle."""
        soon = self.estimate.ahead(self.briefing.cycle)
        situation = Situation(soon.time, self._height(soon), self.site, soon)
        tasks = (part.task(situation) for part in self.tasking)
        return tuple(task for task in tasks if task is not None)

    def stop_sensors(self) -> None:
        """Ask for no more measurements of pointed sensors."""
        for part in self.tasking:
            part.stop()
