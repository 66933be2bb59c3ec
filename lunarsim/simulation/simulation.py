"""The closed loop: truth, sensors, navigation, map, policy, guidance, vehicle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust, quat_rotate
from lunarsim.messages.commands import Command
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.control.thrust import thrust_to_command
from lunarsim.onboard.guidance.apollo import ApolloGuidance
from lunarsim.onboard.guidance.divert import DivertCost, divert_cost
from lunarsim.onboard.guidance.law import Target
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.candidates import candidate_sites
from lunarsim.onboard.policies.contract import Candidates, Decision, Observation, RetargetingPolicy
from lunarsim.onboard.policies.library import TRUTH_ORACLE, make_policy
from lunarsim.rng import Streams
from lunarsim.scenario import Scenario
from lunarsim.simulation import build
from lunarsim.simulation.eyes import eyes_of
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.oracle import TruthOracle
from lunarsim.simulation.recorder import Recorder
from lunarsim.vehicle import State, Verdict, judge_touchdown, pad_contacts
from lunarsim.world import World
from lunarsim.world.truth import Truth

Array = NDArray[np.float64]

APPROACH, VERTICAL = 0, 1
# Pads are looked for under the lander only below this height above the site, m.
_CONTACT_HEIGHT = 40.0


class Simulation:
    """One descent, stepped a control cycle at a time.

    Order within a cycle: navigate, scan if a scan is due, ask the policy if a decision is due,
    guide, move. `step` is the only clock; the command line, the environments and campaigns all
    step this object.

    Parameters
    ----------
    scenario
        The study.
    seed
        The flight's seed sequence or an integer; every random draw derives from it.
    policy
        A policy, its name, or None to take decisions from outside by `apply`.
    world
        The true world; drawn from the seed when left out.
    truth
        Exact safety of that world, if it has been evaluated already.

    Raises
    ------
    InputError
        If the scenario cannot be flown: see the message.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: np.random.SeedSequence | int,
        policy: RetargetingPolicy | str | None = None,
        *,
        world: World | None = None,
        truth: Truth | None = None,
    ) -> None:
        self.scenario = scenario
        self.streams = Streams(seed)
        self.lander = build.lander_of(scenario)
        self.world = world if world is not None else build.build_world(scenario, self.streams)
        self._truth = truth
        self.dynamics = build.dynamics_of(scenario, self.lander)
        self.lidar = build.lidar_of(scenario)
        self.limits = build.limits_of(scenario)
        self._heading = np.deg2rad(scenario.start.heading_deg)
        self._steps = round(scenario.simulation.cycle_s / scenario.simulation.step_s)
        self._approach_height = scenario.guidance.vertical_altitude_m + self.lander.com_height

        site = self._draw_target()
        self.state = self._draw_start(site)
        self.time = 0.0
        # Elevation of the ground at the target, true frame.
        self.ground = float(site[2])
        self.eyes = eyes_of(self)
        self.estimate = self.eyes.navigation.update(self.state, self.time)
        # Unless navigation finds its place on a map, sites lie in the estimated frame.
        self.site = site if self.eyes.tied_to_map else site + self.navigation_error
        self.vertical = VerticalDescent(scenario.gravity_m_s2, scenario.guidance.vertical_speed_m_s)
        self.guidance = ApolloGuidance(
            scenario.gravity_m_s2,
            self._first_arrival(),
            lead=self.dynamics.response_time,
        )
        self.recorder = Recorder()
        self.phase = APPROACH
        self.state = self._settled(self.state)
        self.eyes.settle(self)
        self.verdict: Verdict | None = None
        self.map_error = np.zeros(3)
        self.first_map_estimate: Estimate | None = None
        self._next_decision = 0.0
        self._retimed = False
        self._aim: tuple[HazardMap, FloatMap] | None = None
        self.policy = self._resolve(policy)

    # --- set-up ---------------------------------------------------------------------------

    def _draw_target(self) -> Array:
        section = self.scenario.target
        offset = self.streams.get("target").uniform(-1.0, 1.0, 2) * np.asarray(section.scatter_m)
        xy = np.asarray(section.position_m) + offset
        west, east, south, north = self.world.terrain.bounds
        reach = np.abs(section.scatter_m)
        low, high = section.position_m - reach, section.position_m + reach
        room = self.lander.leg_radius + self.lander.pad_diameter
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
        elevation = float(type(self.world.terrain)(self.world.terrain.relief).elevation(xy))
        if not np.isfinite(elevation):
            raise InputError("target.position_m", tuple(xy), "a point with a measured elevation")
        return np.array([xy[0], xy[1], elevation])

    def _draw_start(self, site: Array) -> State:
        section = self.scenario.start
        rng = self.streams.get("start")
        position = (
            site
            + np.asarray(section.position_m)
            + section.position_sigma_m * rng.standard_normal(3)
        )
        velocity = np.asarray(section.velocity_m_s) + section.velocity_sigma_m_s * (
            rng.standard_normal(3)
        )
        ground = float(self.world.terrain.elevation(position[:2]))
        if not np.isfinite(ground):
            ground = self.world.terrain.z_range[1]
        if position[2] - self.lander.com_height <= ground:
            raise InputError(
                "start.position_m",
                section.position_m,
                f"above the ground, which lies {ground - site[2]:.0f} m from the target's level",
            )
        mass = self.lander.wet_mass
        up = attitude_from_thrust([0.0, 0.0, 1.0], self._heading)
        return State(position, velocity, up, np.zeros(3), mass, mass * self.scenario.gravity_m_s2)

    def _first_arrival(self) -> float:
        fixed = self.scenario.guidance.time_to_go_s
        if fixed is not None:
            return fixed
        time_to_go = self.cost_of(self.site[None, :]).time_to_go[0]
        if not np.isfinite(time_to_go):
            raise InputError(
                "start.position_m",
                self.scenario.start.position_m,
                "a start from which the target can be reached within thrust, tilt, glideslope and "
                "propellant: no time-to-go is admissible",
            )
        return float(time_to_go)

    def _settled(self, state: State) -> State:
        """Return the start with attitude and thrust as guidance asks for them at once."""
        command = self._command()
        thrust = min(max(command.thrust, self.lander.thrust_min), self.lander.thrust_max)
        return replace(state, attitude=command.attitude, thrust=thrust)

    def _resolve(self, policy: RetargetingPolicy | str | None) -> RetargetingPolicy | None:
        if not isinstance(policy, str):
            return policy
        if policy != TRUTH_ORACLE:
            return make_policy(policy)
        truth = self.truth
        return TruthOracle(
            truth.safety,
            truth.elevation,
            lambda: self.navigation_error,
            self.lander,
            self.scenario.gravity_m_s2,
            self._approach_height,
            self.limits,
        )

    # --- what is known --------------------------------------------------------------------

    @property
    def truth(self) -> Truth:
        """Exact safety of the world, evaluated when first asked for."""
        if self._truth is None:
            self._truth = Truth.of(self.world, self.lander, self.scenario.mapper.posting_m)
        return self._truth

    @property
    def navigation_error(self) -> Array:
        """Estimated minus true position (3,), m."""
        return self.estimate.position - self.state.position

    @property
    def altitude(self) -> float:
        """Estimated height of the pads above the site, m."""
        return float(self.estimate.position[2] - self.site[2] - self.lander.com_height)

    @property
    def done(self) -> bool:
        """True once the flight has ended."""
        return self.verdict is not None

    @property
    def decision_due(self) -> bool:
        """True when the policy is to be asked in this cycle."""
        window = self.scenario.decisions
        return (
            self.phase == APPROACH
            and window.last_altitude_m <= self.altitude <= window.first_altitude_m
            and self.time >= self._next_decision - 1e-9
        )

    def cost_of(self, sites: Array) -> DivertCost:
        """Return what it costs to fly from here to each of the sites (n, 3), estimated ENU."""
        return divert_cost(
            self.estimate,
            sites + np.array([0.0, 0.0, self._approach_height]),
            self.lander,
            self.scenario.gravity_m_s2,
            arrival_velocity=(0.0, 0.0, -self.scenario.guidance.vertical_speed_m_s),
            limits=self.limits,
        )

    def observe(self) -> Observation:
        """Return what the onboard computer knows now."""
        section = self.scenario.decisions
        hazard_map = self.eyes.hazard_map()
        if self._aim is None or self._aim[0] is not hazard_map:
            self._aim = (hazard_map, hazard_map.dispersed(section.touchdown_sigma_m))
        aim = self._aim[1]
        candidates: Candidates = candidate_sites(
            hazard_map,
            aim,
            self.estimate,
            self.site,
            self.lander,
            self.scenario.gravity_m_s2,
            count=section.candidates,
            separation=section.separation_m,
            approach_height=self._approach_height,
            limits=self.limits,
        )
        self.recorder.choice(candidates)
        row, col = (int(v) for v in hazard_map.grid.cell(self.site[:2]))
        inside = bool(hazard_map.grid.contains(self.site[:2]))
        seen = inside and bool(hazard_map.observed[row, col])
        return Observation(
            time=self.time,
            estimate=self.estimate,
            hazard_map=hazard_map,
            candidates=candidates,
            site=self.site,
            site_p_safe=float(aim[row, col]) if seen else float("nan"),
            site_propellant=float(self.cost_of(self.site[None, :]).propellant[0]),
            time_to_go=self.guidance.time_to_go(self.time),
            propellant=self.estimate.mass - self.lander.dry_mass,
        )

    # --- the loop -------------------------------------------------------------------------

    def apply(self, decision: Decision) -> bool:
        """Carry out a decision; return False if its site is out of reach (the old one stays)."""
        self._next_decision = self.time + self.scenario.decisions.interval_s
        first, self._retimed = not self._retimed, True
        if decision.site is None:
            if first and self.scenario.guidance.time_to_go_s is None:
                self.retime()
            return True
        site = np.asarray(decision.site, dtype=np.float64)
        time_to_go = float(self.cost_of(site[None, :]).time_to_go[0])
        if not np.isfinite(time_to_go):
            self.recorder.event(self.time, "divert-refused", site=site, reason="out of reach")
            return False
        self.recorder.decision(self.time, self.site, decision)
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

    def saw(self, scan: LidarScan | None) -> None:
        """Note that the map has been updated, and by which scan, for the record."""
        self.map_error = self.navigation_error
        if scan is not None:
            self.recorder.scan(scan, self.estimate)
            if not self.eyes.tied_to_map:
                returns = int(np.isfinite(scan.range).sum())
                self.recorder.event(self.time, "scan", altitude=self.altitude, returns=returns)
        if self.first_map_estimate is None:
            self.first_map_estimate = self.estimate

    def navigate_and_scan(self) -> None:
        """Do the first half of a cycle: update the estimate and the map."""
        self.estimate = self.eyes.navigation.update(self.state, self.time)
        self.eyes.look(self)

    def guide_and_move(self) -> None:
        """Do the second half of a cycle: command the vehicle and move it."""
        command = self._command()
        self.recorder.row(
            self.time,
            self.state,
            self.estimate,
            self.site,
            self.guidance.time_to_go(self.time),
            self.phase,
        )
        history = self.dynamics.advance(self.state, command, self._steps)
        touched = self._first_contact(history)
        last = history[touched if touched is not None else -1]
        steps = self._steps if touched is None else touched + 1
        self.eyes.sense(self.state, history[:steps], self.scenario.simulation.step_s)
        self.state = State.from_vector(last)
        self.time += steps * self.scenario.simulation.step_s
        if touched is not None:
            self._end(
                judge_touchdown(
                    self.lander, self.state, self.world.terrain, self.scenario.gravity_m_s2
                )
            )
        elif self.state.position[2] < self.world.terrain.z_range[0] - 1.0:
            self._end(Verdict(False, ("off-map",), None))
        elif self.time >= self.scenario.simulation.max_time_s:
            self._end(Verdict(False, ("time-limit",), None))

    def _command(self) -> Command:
        approach_end = self.site + np.array([0.0, 0.0, self._approach_height])
        if self.phase == APPROACH and (
            self.altitude <= self.scenario.guidance.vertical_altitude_m
            or self.guidance.time_to_go(self.time) <= 0.0
        ):
            self.phase = VERTICAL
            self.recorder.event(self.time, "vertical-descent", altitude=self.altitude)
        if self.phase == APPROACH:
            speed = self.scenario.guidance.vertical_speed_m_s
            target = Target(
                approach_end,
                np.array([0.0, 0.0, -speed]),
                np.asarray(self.scenario.guidance.arrival_acceleration_m_s2),
            )
            thrust = self.guidance.command(self.estimate, target, self.time)
            tilt = self.limits.max_tilt
        else:
            landed = self.site + np.array([0.0, 0.0, self.lander.com_height])
            thrust = self.vertical.command(self.estimate, Target(landed), self.time)
            tilt = self.vertical.lean
        return thrust_to_command(thrust, self.estimate.mass, self.lander, self._heading, tilt)

    def _first_contact(self, history: Array) -> int | None:
        """Return the first step at which a pad is at or below the ground, or None."""
        if history[-1, 2] - self.world.terrain.z_range[1] > _CONTACT_HEIGHT:
            return None
        pads = history[:, None, 0:3] + quat_rotate(history[:, None, 6:10], self.lander.pads)
        gap = pads[..., 2] - self.world.terrain.elevation(pads[..., :2])
        if not np.any(gap <= 2.0):
            return None
        for step, y in enumerate(history):
            ground = pad_contacts(self.lander, State.from_vector(y), self.world.terrain)[:, 2]
            if np.any(pads[step, :, 2] <= ground):
                return step
        return None

    def _end(self, verdict: Verdict) -> None:
        self.verdict = verdict
        self.estimate = self.eyes.navigation.update(self.state, self.time)
        self.recorder.row(self.time, self.state, self.estimate, self.site, 0.0, self.phase)
        self.recorder.event(
            self.time, "touchdown" if verdict.touchdown else "end", failed=list(verdict.failed)
        )

    def step(self) -> None:
        """Advance one control cycle."""
        if self.done:
            raise RuntimeError("the flight has ended")
        self.navigate_and_scan()
        if self.policy is not None and self.decision_due:
            self.apply(self.policy.decide(self.observe()))
        self.guide_and_move()

    def run(self) -> Flight:
        """Fly to the end and return the record."""
        while not self.done:
            self.step()
        return self.flight()

    def _last_map(self) -> HazardMap | None:
        """Return the map, or None if nothing was ever seen."""
        if self.eyes.blank or self.first_map_estimate is None:
            return None
        return self.eyes.hazard_map()

    def flight(self) -> Flight:
        """Return the record of the flight so far."""
        seed = self.streams.seed
        return Flight(
            scenario=self.scenario.to_toml(),
            seed={"entropy": seed.entropy, "spawn_key": list(seed.spawn_key)},
            policy=self.policy.name if self.policy is not None else "external",
            verdict=self.verdict or Verdict(False, ("unfinished",), None),
            trajectory=self.recorder.trajectory(),
            decisions=self.recorder.decisions,
            events=self.recorder.events,
            hazard_map=self._last_map(),
            map_error=self.map_error,
            scans=self.recorder.scans,
            candidates=self.recorder.candidates,
        )
