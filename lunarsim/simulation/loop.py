"""Closed loop of plant and onboard computer; only this module holds both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim import forks
from lunarsim._blas import one_blas_thread
from lunarsim.errors import InputError
from lunarsim.frames import SiteToLocal, quat_conjugate, quat_multiply, quat_to_rotation_vector
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import Command
from lunarsim.messages.measurements import CameraImage, Measurements
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.onboard.component_errors import prefix_input_errors
from lunarsim.onboard.computer import OnboardComputer
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.onboard.external.recording import recorded_in
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.contract import Decision, Observation, RetargetingPolicy
from lunarsim.parts import resolve, settings_of
from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.scenario.mission import RecordSettings
from lunarsim.sensors.faults import SensorFault
from lunarsim.simulation.columns import CommandCycle, Cycle
from lunarsim.simulation.command_delay import CommandQueue, Stopwatch
from lunarsim.simulation.cycle import fly_cycle
from lunarsim.simulation.fault_events import fault_events
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.map_edge import MapEdgeMonitor
from lunarsim.simulation.mission import plan
from lunarsim.simulation.pacing import Pacer
from lunarsim.simulation.plant import Plant
from lunarsim.simulation.recorder import MessageRecorder, Recorder, RecordExtent
from lunarsim.simulation.worlds import build_world
from lunarsim.typing import Array
from lunarsim.vehicle import Dynamics, LandingOutcome, State
from lunarsim.vehicle.actuators import Actuators
from lunarsim.vehicle.faults import Faults
from lunarsim.world import World
from lunarsim.world.truth import TerrainTruth

# Cause of failure, and event, if external software fails.
SOFTWARE_FAILED = "software-failed"


def make_policy(scenario: Scenario, policy: RetargetingPolicy | str | None) -> Any:
    """Create the policy with a name; return a policy object or None unchanged.

    A named policy has the scenario's settings if the scenario uses it, else the default settings.

    Raises
    ------
    InputError
        If the policy does not exist, or uses the truth without stating this in its name.
    """
    made: Any = policy
    if isinstance(policy, str):
        own = policy == scenario.policy.kind
        table = scenario.policy if own else settings_of(resolve("policy", policy, "policy"))()
        made = table.make()
    if getattr(made, "knows_truth", False) and "truth" not in made.name:
        raise InputError(
            "policy",
            made.name,
            "must have 'truth' in its name, because this policy uses the true hazard map",
        )
    return made


def _vehicle_faults(scenario: Scenario) -> Faults | None:
    """Create the faults of thrusters, throttle and engine; None if there are none."""
    made: Faults | None = None if scenario.faults is None else scenario.faults.make()
    return made if made is not None and made.occurs else None


def _actuators(scenario: Scenario, lander: Lander, step: float) -> Actuators | None:
    """Create thrusters, gimbal and throttle of a lander, with the scenario's faults.

    `step` is the integration step, s. Return None for a lander without such actuators.
    """
    if not isinstance(lander, JetLander):
        return None
    return Actuators(lander, step, _vehicle_faults(scenario))


def _recorded_sensors(scenario: Scenario) -> tuple[list[str], list[str]]:
    """Return the names of the recorded sensors, and of the recorded cameras."""
    settings = RecordSettings() if scenario.record is None else scenario.record.make()
    readings: list[str] = []
    cameras: list[str] = []
    for name, part in scenario.sensors.items():
        sensor = part.make()
        is_camera = issubclass(sensor.measurement_type, CameraImage)
        is_kept = settings.images if is_camera else settings.measurements
        if is_kept or getattr(sensor, "is_recorded", False):
            (cameras if is_camera else readings).append(name)
    return readings, cameras


def _sensor_faults(
    scenario: Scenario, streams: RandomStreams
) -> dict[str, list[tuple[SensorFault, np.random.Generator]]]:
    """Create the sensor faults by sensor, with the generators of their random numbers."""
    found: dict[str, list[tuple[SensorFault, np.random.Generator]]] = {}
    for name, part in scenario.sensor_faults.items():
        rng = streams.get(f"sensor_faults.{name}")
        found.setdefault(part.sensor, []).append((part.make(), rng))
    return found


def _make_computer(briefing: Briefing, policy: RetargetingPolicy | None) -> OnboardComputer:
    """Create the onboard computer of a flight: that of lunarsim, or external software.

    External software has those attributes of `OnboardComputer` that a flight without decisions of
    lunarsim uses.
    """
    settings = briefing.software.computer
    if settings is None:
        return OnboardComputer(briefing, policy)
    with prefix_input_errors("computer"):
        return settings.build(briefing)  # type: ignore[no-any-return]


class Simulation:
    """Simulation of one descent in closed loop, advanced one control cycle at a time.

    The command line, the environments and campaigns all advance a flight by the method `step`.

    Parameters
    ----------
    scenario
        Scenario to fly.
    seed
        Seed sequence of the flight, or an integer; every random draw derives from it.
    policy
        Divert policy, its name, or None if a caller applies decisions with `apply`.
    world
        True world; omitted: generated from the seed.
    truth
        True landing safety of `world`, if already computed.
    tap
        Recorder of all messages between plant and computer, or None.
    messages
        Folder for records of the calls of external software; None: no records.

    Attributes
    ----------
    plant, computer
        True world and vehicle; onboard computer.
    briefing
        Data that the onboard computer knows before the flight.

    Raises
    ------
    InputError
        If the scenario cannot be flown.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: np.random.SeedSequence | int,
        policy: RetargetingPolicy | str | None = None,
        *,
        world: World | None = None,
        truth: TerrainTruth | None = None,
        tap: MessageRecorder | None = None,
        messages: Path | None = None,
    ) -> None:
        forks.check()  # parallel kernels check too, but some flights reach them late
        if scenario.domain_randomization is not None:
            raise InputError(
                "domain_randomization",
                "given",
                "must be omitted, because only Guidance-v1 and Control-v1 randomise the lander",
                "Use: lunarsim evaluate Guidance-v1 --scenario FILE --agent apollo.",
                show_value=False,
            )
        self.scenario = scenario
        self.streams = RandomStreams(seed)
        # External computers decide by themselves.
        self.policy = None if scenario.computer else make_policy(scenario, policy)
        world = world if world is not None else build_world(scenario, self.streams)
        self._truth = truth
        state, self.briefing = plan(scenario, world, self.streams)
        clock, lander = scenario.simulation.make(), scenario.true_lander()
        self.plant = Plant(
            world,
            Dynamics(lander, world.gravity, clock.step, world.moon),
            state,
            {
                name: (part.make(), self.streams.get(f"sensors.{name}"))
                for name, part in scenario.sensors.items()
            },
            steps=clock.steps,
            max_time=clock.max_time,
            legs=None if scenario.legs is None else scenario.legs.make(),
            actuators=_actuators(scenario, lander, clock.step),
            # Actuators simulate the faults of a lander with thrusters.
            faults=None if isinstance(lander, JetLander) else _vehicle_faults(scenario),
            sensor_faults=_sensor_faults(scenario, self.streams),
        )
        # A policy that uses the truth is queried here; any other runs on the computer.
        self._oracle = self.policy if getattr(self.policy, "knows_truth", False) else None
        with recorded_in(messages):
            self.computer = _make_computer(self.briefing, None if self._oracle else self.policy)
        self.recorder = Recorder(self.briefing.target, *_recorded_sensors(scenario))
        self._map_edge = MapEdgeMonitor(world, self.briefing.instruments)
        delay = scenario.command_delay
        self._stopwatch = Stopwatch()
        self._commands = CommandQueue(
            None if delay is None else delay.make(), self.streams.get("command_delay"),
            clock.step, Command(state.thrust, state.attitude),
        )  # fmt: skip
        self._tap = tap
        if tap is not None:
            tap.briefing = self.briefing
        self._take(self.plant.measure())

    # --- state ----------------------------------------------------------------------------

    @property
    def world(self) -> World:
        """True world: terrain, rocks, gravity and illumination."""
        return self.plant.world

    @property
    def lander(self) -> Lander:
        """Parameters of the true lander."""
        return self.plant.lander

    @property
    def state(self) -> State:
        """True state of the lander."""
        return self.plant.state

    @property
    def time(self) -> float:
        """Time since the start of the flight, s."""
        return self.plant.time

    @property
    def outcome(self) -> LandingOutcome | None:
        """Landing outcome of the flight; None while it is in progress."""
        return self.plant.outcome

    @property
    def done(self) -> bool:
        """Whether the flight has ended."""
        return self.plant.outcome is not None

    @property
    def estimate(self) -> Estimate:
        """Navigation estimate of the lander's state, local frame."""
        return self.computer.estimate

    @property
    def site(self) -> Array:
        """Current landing site (3,), local frame, m."""
        return self.computer.site

    @property
    def altitude(self) -> float:
        """Estimated height of the pads above the site, m."""
        return self.computer.altitude

    @property
    def truth(self) -> TerrainTruth:
        """True landing safety of the terrain; sites are evaluated when they are needed."""
        if self._truth is None:
            self._truth = TerrainTruth.of(self.world, self.lander)
        return self._truth

    @property
    def true_to_local(self) -> SiteToLocal:
        """Transformation from the true to the local frame of navigation and maps.

        It follows from the error of the estimated position and, if the local frame has its own
        azimuth, from the error of the estimated azimuth.
        """
        e, turn = self.estimate, 0.0
        if self.computer.navigation.has_local_azimuth:
            off = quat_multiply(e.attitude, quat_conjugate(self.state.attitude))
            turn = float(quat_to_rotation_vector(off)[2])
        return SiteToLocal(e.position - SiteToLocal(turn=turn).to_local(self.state.position), turn)

    @property
    def navigation_error(self) -> Array:
        """Local minus true coordinates of the terrain at the site (3,), m.

        Subtract this error from a point of a map to get the true point. If the local frame is
        rotated, this is valid only near the site.
        """
        return np.asarray(self.site - self.true_to_local.to_site(self.site))

    @property
    def site_error(self) -> Array:
        """Estimated minus true position of the lander in the site frame (3,), m."""
        shift = self.computer.navigation.site_to_local
        return np.asarray(shift.to_site(self.estimate.position) - self.state.position)

    @property
    def decision_due(self) -> bool:
        """Whether the policy must decide on the landing site in this control cycle."""
        return self.computer.decision_due

    @one_blas_thread()
    def observe(self) -> Observation:
        """Return the observation that a divert policy receives in this control cycle."""
        return self.computer.observe()

    # --- the loop -------------------------------------------------------------------------

    def apply(self, decision: Decision) -> bool:
        """Apply a divert decision; return False if its new site is refused.

        A site is refused if it is out of reach or out of sight, or while diverts are inhibited.
        """
        return self.computer.apply(decision)

    @contextmanager
    def _failure_ends_flight(self) -> Iterator[None]:
        """End the flight as failed if external software fails within a `with` statement."""
        try:
            yield
        except SoftwareFailure as failure:
            if self.plant.outcome is None:
                self.plant.outcome = LandingOutcome(False, (SOFTWARE_FAILED,), None)
            details = {"role": failure.role, "reason": failure.reason, "detail": failure.detail}
            self.computer.telemetry.append((self.time, SOFTWARE_FAILED, details))
            self.computer.close()

    @one_blas_thread()
    def _take(self, measurements: Measurements) -> None:
        """Pass measurements to the onboard computer, and record truth and estimate."""
        self._measurements = measurements
        c = self.computer
        with self._failure_ends_flight(), self._stopwatch:
            c.update(measurements)
        self.recorder.record_measurements(measurements, c, self.navigation_error, self.state)
        self.recorder.add_events(self._map_edge.events(measurements, self.state))
        left = 0.0 if self.done else max(c.time_to_go, 0.0)
        self.recorder.add_cycle(Cycle(self.time, self.state, c, left))
        if self.done:
            c.close()

    @one_blas_thread()
    def decide(self) -> None:
        """Query the policy and apply its decision, if a decision is due."""
        if self._oracle is None:
            with self._failure_ends_flight(), self._stopwatch:
                self.computer.decide()
        elif self.decision_due:
            self.apply(self.ask(self._oracle, self.observe()))

    def ask(self, policy: Any, observation: Observation) -> Decision:
        """Return the decision of a policy on an observation, without applying it.

        A policy that uses the truth also receives the true landing safety.
        """
        if getattr(policy, "knows_truth", False):
            truth_inputs = self.truth, self.navigation_error, self.computer.cost_of
            return policy.decide_by_truth(observation, *truth_inputs)  # type: ignore[no-any-return]
        return policy.decide(observation)  # type: ignore[no-any-return]

    @one_blas_thread()
    def move(self) -> None:
        """Advance the simulation by one control cycle without a new divert decision.

        The cycle consists of command, motion, measurements, and update of the onboard computer.
        """
        if self.done:
            raise RuntimeError("the flight has ended")
        time, loop = self.time, self.computer.attitude_loop
        with self._failure_ends_flight():
            with self._stopwatch:
                command = self.computer.command()
            active, changes = self._commands.add(command, self._stopwatch.seconds, self.plant.steps)
            self._stopwatch.seconds = 0.0
            if active is not command:
                loop.set_command(active)
            cycle = fly_cycle(self.plant, loop, active, changes)
        if self.plant.outcome is not None and self.plant.time == time:
            return  # external software has failed
        if self._tap is not None:
            self._tap.exchange(self._measurements, command, cycle.torques)
        torque = cycle.torques.mean(axis=0) if len(cycle.torques) else np.full(3, np.nan)
        self.recorder.add_command(CommandCycle(time, command, self.computer, torque))
        self._take(cycle.measurements)

    def step(self) -> None:
        """Let the policy decide if a decision is due, and advance by one control cycle."""
        if self.done:
            raise RuntimeError("the flight has ended")
        self.decide()
        if not self.done:
            self.move()

    def run(
        self, pacer: Pacer | None = None, watch: Callable[[Flight], object] | None = None
    ) -> Flight:
        """Simulate the flight to its end and return its record.

        `pacer` slows the flight down to wall-clock rate. `watch` is called with the record of each
        control cycle, which has only what this cycle added.
        """
        extent = RecordExtent()
        while True:
            if watch is not None:
                watch(self.flight(since=extent))
                extent = self.recorder.extent(self.computer)
            if self.done:
                return self.flight()
            self.step()
            if pacer is not None:
                pacer.wait()

    def close(self) -> None:
        """End external software of a flight that is not flown to its end."""
        self.computer.close()

    def flight(self, since: RecordExtent | None = None) -> Flight:
        """Return the record of the flight up to now, or of what was added `since`."""
        seed = self.streams.seed
        return self.recorder.flight(
            self.computer,
            scenario=self.scenario.to_toml(),
            seed={"entropy": seed.entropy, "spawn_key": list(seed.spawn_key)},
            policy=self.policy.name if self.policy is not None else "external",
            outcome=self.outcome or LandingOutcome(False, ("unfinished",), None),
            ending=self._ending_details(),
            # A part of the record has no actuators: they are sampled faster than control cycles.
            actuators=[]
            if self.plant.actuators is None or since
            else self.plant.actuators.commands,
            fault_events=fault_events(self.scenario, self.time),
            since=since,
        )

    def _ending_details(self) -> dict[str, Any]:
        """Return values of thrusters, slosh and legs at the end of the flight, by name.

        They are recorded with the last event; empty if none of these is simulated.
        """
        actuators, rest = self.plant.actuators, self.plant.rest
        details: dict[str, Any] = {} if rest is None else rest.record_values()
        if actuators is None:
            return details
        if actuators.slosh_pendulums is not None:
            details["slosh_most_deg"] = np.rad2deg(actuators.slosh_pendulums.max_angles)
        return details | {
            "thruster_propellant_kg": actuators.spent,
            "thruster_on_time_s": actuators.on_time,
            "thruster_firings": actuators.firings,
        }
