"""Onboard computer: turns measurements into commands.

It is built from a `Briefing` and has no access to the world, the true state or the simulation
loop. `step` runs a complete control cycle. A caller that decides on the landing site itself calls
`update`, `apply` and `command` separately.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lunarsim._blas import one_blas_thread
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import Command, SensorTask
from lunarsim.messages.measurements import InertialSamples, Measurements
from lunarsim.models.jet_lander import JetLander
from lunarsim.onboard.component_errors import checked_command, prefix_input_errors
from lunarsim.onboard.control.jets import JetLoop, attitude_loop
from lunarsim.onboard.control.throttle import ThrottleRegions
from lunarsim.onboard.control.thrust import thrust_to_command
from lunarsim.onboard.divert_inhibit import DivertInhibit
from lunarsim.onboard.guidance.command_limits import (
    LimitViolationMonitor,
    PositionCorrectionLimiter,
)
from lunarsim.onboard.guidance.contract import PhaseEnd, PlansArrival, UsesHazardMap
from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.guidance.vertical import Hovers, climb, descent_law
from lunarsim.onboard.hazards.hazard_map import HazardMap, lookup_elevation
from lunarsim.onboard.hazards.map_tilt_correction import MapTiltCorrection
from lunarsim.onboard.hazards.mapper import HazardMapper, build_mappers, sensor_names
from lunarsim.onboard.mass_estimator import MassEstimator
from lunarsim.onboard.navigation.estimate import Estimate, ThrustAware
from lunarsim.onboard.navigation.landing_accuracy import allows_landing
from lunarsim.onboard.navigation.measurement_sequencer import MeasurementSequencer
from lunarsim.onboard.phases import Phase, PhaseSequence
from lunarsim.onboard.policies.contract import (
    BuiltPerFlight,
    Candidates,
    Decision,
    Observation,
    RetargetingPolicy,
    checked_decision,
)
from lunarsim.onboard.site_evaluator import DescentStatus, SiteEvaluator
from lunarsim.onboard.tasking.contract import Situation
from lunarsim.typing import Array


class OnboardComputer:
    """Runs navigation, mapping, tasking, policy, guidance and control of one lander.

    Parameters
    ----------
    briefing
        Everything known before the flight, including the software configuration.
    policy
        Policy that decides where to land. None: the caller decides and calls `apply`.

    Attributes
    ----------
    site
        Landing site that the lander flies to, local frame (3,), m.
    telemetry
        Events: time (s), name, details.
    site_evaluator
        Evaluates sites and prepares the observation of the policy.
    mass_estimator
        Estimates the mass from the commanded thrust.
    phases
        Phase of the descent and its time-to-go.
    diverts
        Decisions that changed the site: time (s), old site (3,) in m, decision.
    updated_mappers
        Names of the mappers that received a measurement in this cycle, and of those that combine
        the maps of such mappers.
    guidance_target, guidance_acceleration
        Target of guidance in the last command, None during hover and abort, and the thrust
        acceleration (3,) that guidance commanded, m/s^2; NaN before the first command.
    expected_miss
        Miss distance at the site in the last observation, 1 sigma per axis, m; NaN before the first
        observation.
    """

    def __init__(self, briefing: Briefing, policy: RetargetingPolicy | None = None) -> None:
        software = briefing.software
        self.briefing = briefing
        with prefix_input_errors("policy"):
            built = policy.build(briefing) if isinstance(policy, BuiltPerFlight) else policy
        self.policy: RetargetingPolicy | None = built
        self.lander = briefing.lander
        self.approach = software.approach
        self.decisions = software.decisions
        with prefix_input_errors("navigation"):
            self.navigation = software.navigation.build(briefing)
        self.mappers = build_mappers(briefing, self.navigation)
        self.tasking = [part.build(name, briefing) for name, part in software.tasking.items()]
        control = software.control
        lag = control.response_time + self.lander.thrust_lag
        with prefix_input_errors("guidance"):
            self.guidance = software.guidance.build(briefing, lag)
        if isinstance(self.guidance, UsesHazardMap):
            self.guidance.hazard_map_source = self._current_map
        self.vertical = descent_law(software.terminal_descent, briefing, lag)
        self.site_evaluator = SiteEvaluator(briefing, self.navigation, self.mappers, self.vertical)
        self.braking = software.braking
        self._braking_law: Any = None
        if self.braking is not None:
            self._braking_law = self.braking.law_settings().build(briefing, lag)
        with prefix_input_errors("control"):
            self.attitude_loop = attitude_loop(briefing)
        self.throttle = (
            ThrottleRegions(self.lander.engine) if isinstance(self.lander, JetLander) else None
        )
        self.site: Array = briefing.target.copy()
        self.time = 0.0
        self.mass_estimator = MassEstimator(self.lander, self.attitude_loop)
        self.estimate: Estimate = self.navigation.estimate(0.0, self.mass)
        self._position_limiter = PositionCorrectionLimiter()
        self._limit_monitor = LimitViolationMonitor()
        self.telemetry: list[tuple[float, str, dict[str, Any]]] = []
        self.diverts: list[tuple[float, Array, Decision]] = []
        self.candidates: Candidates | None = None
        self.updated_mappers: set[str] = set()
        self.expected_miss = float("nan")
        self.guidance_target: PhaseEnd | None = None
        self.guidance_acceleration: Array = np.full(3, np.nan)
        self.phases = PhaseSequence(
            briefing, self.site_evaluator, self.guidance, self.vertical, self._record
        )
        self._thrust = 0.0
        self._failed_thrusters = 0
        self._corrected_target: Array = briefing.target.copy()
        self._next_decision = 0.0
        self._has_decided = False
        self._is_inaccurate = False
        self._recorded_navigation_events = 0
        self._arrivals = MeasurementSequencer.of(briefing, self._record)
        self._divert_inhibit = DivertInhibit()
        self._tilt_correction = MapTiltCorrection(self.mappers, self.navigation)

    # --- Current knowledge ------------------------------------------------------------------

    @property
    def mass(self) -> float:
        """Estimated mass of the lander from the commanded thrust, kg."""
        return self.mass_estimator.mass

    @property
    def altitude(self) -> float:
        """Estimated height of the pads above the site, m."""
        return self._height(self.estimate)

    def _record(self, time: float, name: str, details: dict[str, Any]) -> None:
        self.telemetry.append((time, name, details))

    def _height(self, estimate: Estimate) -> float:
        level = float(self.briefing.gravity.height(estimate.position))
        return level - float(self.site[2]) - self.lander.com_height

    @property
    def time_to_go(self) -> float:
        """Time until the planned end of braking or of the approach, s.

        During braking it counts to the end of braking, afterwards to the end of the approach.
        """
        return self.phases.arrival - self.time

    @property
    def phase(self) -> Phase:
        """Current phase of the descent."""
        return self.phases.phase

    @property
    def status(self) -> DescentStatus:
        """State of the descent, from which landing sites are evaluated."""
        return DescentStatus(
            self.time, self.mass, self.estimate, self.site, self.altitude, self.time_to_go
        )

    @property
    def decision_map_name(self) -> str:
        """Name of the mapper whose map is used for decisions; empty without a mapper."""
        return self.site_evaluator.decision_map_name

    @property
    def mapper(self) -> HazardMapper | None:
        """Mapper whose map is used for decisions; None for a lander without one."""
        return self.site_evaluator.mapper

    def _current_map(self) -> HazardMap | None:
        """Return the current hazard map used for decisions; None without a mapper."""
        return None if self.mapper is None else self.mapper.hazard_map()

    @property
    def navigation_lost(self) -> bool:
        """Whether measurements contradict navigation, or it is too inaccurate to land.

        The accuracy is tested below the altitudes for decisions, in the vertical descent and in the
        hover.
        """
        return self.estimate.lost or self._is_inaccurate

    @property
    def diverts_inhibited(self) -> bool:
        """Whether diverts are inhibited, whatever the policy decides.

        Diverts are inhibited while measurements contradict the estimate, and permanently after a
        scan was mapped with such an estimate.
        """
        return self._divert_inhibit.inhibited

    @property
    def decision_due(self) -> bool:
        """Whether the policy must be asked for a decision in this cycle.

        This is the case during the approach, within the altitudes for decisions, if the interval
        since the last decision has passed, diverts are not inhibited, and there is a mapper.
        """
        window = self.decisions
        return (
            self.phase == Phase.APPROACH
            and not self.diverts_inhibited
            and self.mapper is not None
            and window.last_altitude <= self.altitude <= window.first_altitude
            and self.time >= self._next_decision - 1e-9
        )

    def cost_of(self, sites: Array, estimate: Estimate | None = None) -> DivertCost:
        """Return the propellant and time-to-go of flying from an estimate to each site.

        Sites are (n, 3), local frame, m. The result also states which sites are within the limits.
        If no estimate is given, the current one is used.
        """
        return self.site_evaluator.cost_of(sites, estimate or self.estimate)

    def observe(self) -> Observation:
        """Return the current observation of the policy, and store its candidate sites.

        Its expected miss is stored too. A `RuntimeError` is raised if the lander has no mapper.
        """
        observation = self.site_evaluator.observe(self.status)
        self.candidates, self.expected_miss = observation.candidates, observation.expected_miss
        return observation

    # --- Control cycle ----------------------------------------------------------------------

    @one_blas_thread()
    def step(self, measurements: Measurements) -> Command:
        """Run a complete control cycle; return the command for the next cycle.

        `measurements` are all measurements since the last cycle.
        """
        self.update(measurements)
        self.decide()
        return self.command()

    def decide(self) -> None:
        """Apply the decision of the policy, if there is a policy and a decision is due."""
        if self.policy is not None and self.decision_due:
            self.apply(self.policy.decide(self.observe()))

    def update(self, measurements: Measurements) -> None:
        """Update navigation and the maps with the measurements since the last cycle.

        A measurement is dropped and reported as "out-of-order" if it is older than the previous
        one of its sensor or lies in the future, and as "stale" if it is too old for the filter
        (`MeasurementSequencer`).

        Raises
        ------
        InputError
            If the time of the measurements lies before the current time.
        """
        self._arrivals.advance(measurements.time)
        elapsed = measurements.time - self.time
        self._update_actuators(measurements.time, elapsed)
        self.time = measurements.time
        self.updated_mappers = set()
        # Inertial samples come first: they propagate the state before other measurements correct
        # it.
        for sensor, measurement in sorted(
            measurements.items, key=lambda item: not isinstance(item[1], InertialSamples)
        ):
            self._process(sensor, measurement)
        self.site_evaluator.record_update(self.updated_mappers, self.time)
        self._report_overdue_samples()
        self.estimate = self.navigation.estimate(self.time, self.mass)
        self._test_accuracy()
        for mapper in self.mappers.values():
            mapper.refresh(self.time)
        if self._divert_inhibit.update(self.estimate.lost, bool(self.updated_mappers)):
            name = "diverts-inhibited" if self.diverts_inhibited else "diverts-enabled"
            self._record(self.time, name, {"site": self.site.copy()})
        self._update_site_height()
        if not self._has_decided and elapsed == 0.0 and self.phases.chooses_time:
            # The plan was made for the planned start; replan from the actual position.
            self._replan()

    def _test_accuracy(self) -> None:
        """Test whether navigation is accurate enough to land, near the end of the flight."""
        is_near = self.phase in (Phase.VERTICAL, Phase.HOVER) or (
            self.phase == Phase.APPROACH and self.altitude < self.decisions.last_altitude
        )
        is_inaccurate = is_near and not allows_landing(self.estimate, self.lander)
        if is_inaccurate != self._is_inaccurate:
            self._is_inaccurate = is_inaccurate
            name = "navigation-inaccurate" if is_inaccurate else "navigation-accurate"
            self._record(self.time, name, {"altitude": self.altitude})

    def _update_actuators(self, time: float, elapsed: float) -> None:
        """Update mass and failed thrusters, and give navigation the commanded thrust.

        `elapsed` is the length of the cycle that ends at `time`, both in s. Navigation gets the
        thrust only if it uses it. New events (empty tanks, failed thrusters) are recorded.
        """
        # The tanks have no gauges: the commanded thrust is taken as burnt.
        if isinstance(self.navigation, ThrustAware):
            self.navigation.record_thrust(self._thrust, elapsed)
        for name in self.mass_estimator.update(self._thrust, elapsed):
            self._record(time, name, {"altitude": self.altitude})
        if isinstance(self.attitude_loop, JetLoop):
            failed = self.attitude_loop.failure_detector.failed
            for number in failed[self._failed_thrusters :]:
                self._record(time, "thruster-failed", {"thruster": number})
            self._failed_thrusters = len(failed)

    def _report_overdue_samples(self) -> None:
        """Pass NaN samples to navigation in place of inertial samples that are overdue."""
        overdue = self._arrivals.overdue_samples(self.time)
        if overdue is not None:
            self.navigation.take(*overdue, self.time)
            self._follow_navigation()

    def _process(self, sensor: str, received: Any) -> None:
        """Update navigation, then the mappers that use `sensor`, with one measurement.

        `received` is the measurement; it is dropped if it is out of order. Mappers get the
        measurement corrected by navigation; inertial samples go to navigation only.
        """
        measurement = self._arrivals.admit(sensor, received, self.time)
        if measurement is None:
            return
        if isinstance(measurement, InertialSamples):
            self.navigation.take(sensor, measurement, self.time)
            self._follow_navigation()
            return
        self._report_overdue_samples()
        self.navigation.take(sensor, measurement, self.time)
        self._follow_navigation()
        software = self.briefing.software.mappers
        taking = [name for name in self.mappers if sensor in sensor_names(software[name])]
        if not taking:
            return
        after = self.navigation.estimate(self.time, self.mass)
        before = None if self.mapper is None else self.mapper.displacement
        for name in taking:
            self.mappers[name].update_from_sensor(
                sensor, *self.navigation.correct_measurement(sensor, measurement, after)
            )
            self.updated_mappers.add(name)
        is_on_map = bool(self.diverts) and self.phase != Phase.VERTICAL
        if is_on_map and before is not None and self.mapper is not None:
            self.site = self.site + (self.mapper.displacement - before)
        self.updated_mappers |= {
            n for n, m in self.mappers.items() if m.source_mappers & self.updated_mappers
        }

    def _follow_navigation(self) -> None:
        """Adapt site, maps and time-to-go to new results of navigation; record its events.

        The site moves with the corrected target, unless a divert was made or the vertical descent
        has begun. The maps follow corrections of the tilt. After a lock on the prior map, the
        time-to-go is chosen again if it is free.
        """
        shift = self.navigation.site_to_local
        target = shift.to_local(self.briefing.target)
        if not np.array_equal(target, self._corrected_target):
            self._corrected_target = target
            # Guidance would chase corrections during the last metres.
            if not self.diverts and self.phase != Phase.VERTICAL:
                self.site = target
                for mapper in self.mappers.values():
                    mapper.recentre(target)
        self._tilt_correction.apply(self.time, self.mass)
        for event in self.navigation.events[self._recorded_navigation_events :]:
            self._record(event.time, event.name, dict(event.details))
            if event.name in {"lock", "relock"} and self.phases.chooses_time:
                # A position error of tens of metres invalidates the planned path.
                self.estimate = self.navigation.estimate(self.time, self.mass)
                self._replan()
        self._recorded_navigation_events = len(self.navigation.events)

    def _update_site_height(self) -> None:
        """Set the height of the site to the height of the mapped terrain there.

        The site stays unchanged without a mapper or while the height there is unknown.
        """
        mapper = self.mapper
        if mapper is None or mapper.is_empty:
            return
        height = mapper.terrain_height(self.site[:2])
        if height is None:
            height = lookup_elevation(mapper.terrain_surface(), self.site[:2])
        if np.isfinite(height):
            self.site = np.array([self.site[0], self.site[1], height])

    def apply(self, decision: Decision) -> bool:
        """Carry out a decision; return False if its new site is refused.

        A new site is refused if it is out of reach or out of sight, or while diverts are inhibited.
        `Decision.time_scale` describes what happens with a time scale that is out of limits.

        Raises
        ------
        InputError
            If the decision is not a valid `Decision`.
        """
        decision = checked_decision(self.policy, decision, self.time)
        self._next_decision = self.time + self.decisions.interval
        if decision.abort:
            self.phases.abort(self.status, decision.reason)
            return True
        first, self._has_decided = not self._has_decided, True
        time_scale, why = self.phases.allowed_time_scale(
            self.status, decision.time_scale, self.diverts_inhibited
        )
        if why:
            site = self.site if decision.site is None else np.asarray(decision.site, np.float64)
            self._record_refusal(site, why, decision.time_scale)
        if decision.site is None:
            if time_scale is not None or (first and self.approach.has_free_time_to_go):
                self._replan(time_scale)
            return True
        site = np.asarray(decision.site, dtype=np.float64)
        if self.diverts_inhibited:
            self._record_refusal(site, "navigation is lost")
            return False
        time_to_go, why = self.site_evaluator.time_to(site, self.estimate, time_scale)
        if not np.isfinite(time_to_go):
            self._record_refusal(site, "out of reach")
            return False
        if not self.site_evaluator.is_visible(site, self.estimate):
            self._record_refusal(site, "out of sight")
            return False
        self.diverts.append((self.time, self.site, decision))
        self.site = site
        self.phases.arrival = self.time + time_to_go
        if why:
            self._record_refusal(site, why, time_scale)
        return True

    def _replan(self, time_scale: float | None = None) -> None:
        """Choose a new time-to-go to the current site; record a refused time scale.

        `time_scale` is a factor on the minimum-propellant time-to-go; None: 1.
        """
        why = self.phases.replan(self.status, time_scale)
        if why:
            self._record_refusal(self.site, why, time_scale)

    def _record_refusal(self, site: Array, reason: str, time_scale: float | None = None) -> None:
        """Record the event that a divert to a site (3,) is refused, and the reason.

        With `time_scale` (factor on the time-to-go), only the time scale is refused, and the event
        is "time-scale-refused".
        """
        details = {"site": site.copy(), "reason": reason}
        if time_scale is None:
            self._record(self.time, "divert-refused", details)
        else:
            self._record(
                self.time, "time-scale-refused", details | {"time_scale": float(time_scale)}
            )

    def command(self) -> Command:
        """Return the command to vehicle and sensors for the next control cycle."""
        if self.phases.advance(self.status):
            # The vertical descent lands below the lander.
            self.site = np.array([*self.estimate.position[:2], self.site[2]])
            self._update_site_height()
        request = (
            self._braking_command() if self.phase == Phase.BRAKING else self._guidance_command()
        )
        if self.throttle is not None:
            request = replace(request, thrust=self.throttle.select_thrust(request.thrust))
        command = replace(request, tasks=self._tasks(), abort=self.phase == Phase.ABORT)
        self._thrust = command.thrust
        self.attitude_loop.start_cycle(command, self.estimate.attitude, self.mass)
        return command

    def _braking_command(self) -> Command:
        """Return the vehicle command during braking."""
        end = self.braking.end(self.site)
        wanted = self._braking_law.command(self.estimate, end, self.time, self.time_to_go)
        self.guidance_target, self.guidance_acceleration = end, wanted
        request: Command = self.braking.build_command(
            wanted, self.mass, self.lander, self.briefing.heading, self.time
        )
        return request

    def _guidance_command(self) -> Command:
        """Return the vehicle command during approach, hover, terminal descent or abort."""
        end: PhaseEnd | None = None
        here = self._position_limited_estimate()
        if self.phase == Phase.APPROACH:
            end = self.approach.end(self.site, self.lander)
            given = self.guidance.command(here, end, self.time, self.time_to_go)
            wanted = checked_command("guidance", self.briefing.software.guidance, given, self.time)
            self.phases.follow_guidance()
            limits = self.approach.max_tilt, self.lander.thrust_max
            if self._limit_monitor.exceeds_duration(wanted, self.mass, limits, self.time):
                self.phases.extend(self.status)
            tilt = self.approach.max_tilt
            if not isinstance(self.guidance, PlansArrival):  # others limit the tilt of their plans
                tilt = self.site_evaluator.max_tilt(self.time_to_go, self.mass)
        elif self.phase == Phase.VERTICAL:
            end = self.approach.touchdown_end(self.site, self.lander)
            given = self.vertical.command(here, end, self.time)
            wanted = checked_command(
                "terminal_descent", self.briefing.software.terminal_descent, given, self.time
            )
            tilt = self.vertical.max_tilt
        elif self.phase == Phase.HOVER:
            # Only a law that can hover begins this phase.
            assert isinstance(self.vertical, Hovers)
            wanted = self.vertical.hover(self.estimate, self.phases.hover_height)
            tilt = self.approach.max_tilt
        else:
            wanted = climb(self.estimate, self.lander.thrust_max / self.mass)
            tilt = self.approach.max_tilt
        self.guidance_target, self.guidance_acceleration = end, wanted
        return thrust_to_command(wanted, self.mass, self.lander, self.briefing.heading, tilt)

    def _position_limited_estimate(self) -> Estimate:
        """Return the estimate for guidance, in which steps of the position are limited.

        The position steps when a navigation update corrects it. Steps are limited during the
        approach; the vertical descent limits its speed towards the site itself. An approach after a
        hover begins with the estimated position.
        """
        if not self.navigation.has_position_steps:
            return self.estimate
        return self._position_limiter.limit(
            self.estimate, self.time_to_go if self.phase == Phase.APPROACH else np.inf
        )

    def _tasks(self) -> tuple[SensorTask, ...]:
        """Return the measurement tasks of the steerable sensors for the end of the cycle."""
        soon = self.estimate.extrapolate(self.briefing.cycle)
        situation = Situation(soon.time, self._height(soon), self.site, soon)
        tasks = (part.task(situation) for part in self.tasking)
        return tuple(task for task in tasks if task is not None)

    def close(self) -> None:
        """End external software of this flight; all other parts need no end."""
        for part in (
            self.guidance, self.vertical, self.policy, self.attitude_loop.law,
            *self.mappers.values(),
        ):  # fmt: skip
            if hasattr(part, "close"):
                part.close()

    def stop_sensors(self) -> None:
        """Stop the measurements of all steerable sensors."""
        for part in self.tasking:
            part.stop()
