"""The closed loop: the one room that holds both plant and onboard computer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.measurements import Measurements
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.divert import DivertCost
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.contract import Decision, Observation, RetargetingPolicy
from lunarsim.onboard.policies.library import TRUTH_ORACLE, make_policy
from lunarsim.rng import Streams
from lunarsim.scenario import Scenario
from lunarsim.simulation import build
from lunarsim.simulation.assembly import assemble
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.mission import draw_start, draw_target
from lunarsim.simulation.oracle import TruthOracle
from lunarsim.simulation.recorder import Recorder
from lunarsim.vehicle import State, Verdict
from lunarsim.world import World
from lunarsim.world.truth import Truth

Array = NDArray[np.float64]


class Simulation:
    """One descent, stepped a control cycle at a time.

    `step` is the only clock; the command line, the environments and campaigns all step this object.

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

    Attributes
    ----------
    plant, computer
        What is true, and what is known.

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
        lander = build.lander_of(scenario)
        world = world if world is not None else build.build_world(scenario, self.streams)
        self._truth = truth
        target = draw_target(scenario, world, lander, self.streams)
        upright = draw_start(scenario, world, lander, self.streams, target)
        self.plant, self.computer = assemble(
            scenario, world, lander, upright, target, self.streams, None
        )
        command = self.computer.command()
        start = replace(
            upright,
            attitude=command.attitude,
            thrust=min(max(command.thrust, lander.thrust_min), lander.thrust_max),
        )
        self.plant, self.computer = assemble(
            scenario, world, lander, start, target, self.streams, self.computer
        )
        self.recorder = Recorder()
        self.map_error = np.zeros(3)
        self.first_map_estimate: Estimate | None = None
        self._measured(self.plant.sense())
        self._fresh = True
        self.policy = self._resolve(policy)

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
            self.scenario.guidance.vertical_altitude_m + self.lander.com_height,
            self.computer.limits,
        )

    # --- taps -----------------------------------------------------------------------------

    @property
    def world(self) -> World:
        """The true world."""
        return self.plant.world

    @property
    def lander(self) -> Lander:
        """The vehicle's figures."""
        return self.plant.lander

    @property
    def state(self) -> State:
        """The true state."""
        return self.plant.state

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self.plant.time

    @property
    def verdict(self) -> Verdict | None:
        """How the flight ended, or None."""
        return self.plant.verdict

    @property
    def estimate(self) -> Estimate:
        """Where the computer believes the lander to be."""
        return self.computer.estimate

    @property
    def site(self) -> Array:
        """Where the computer is flying to (3,), its frame, m."""
        return self.computer.site

    @property
    def altitude(self) -> float:
        """Estimated height of the pads above the site, m."""
        return self.computer.altitude

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
    def done(self) -> bool:
        """True once the flight has ended."""
        return self.plant.verdict is not None

    @property
    def decision_due(self) -> bool:
        """True when the policy is to be asked in this cycle."""
        return self.computer.decision_due

    def cost_of(self, sites: Array, estimate: Estimate | None = None) -> DivertCost:
        """Return what it costs to fly from here to each of the sites (n, 3)."""
        return self.computer.cost_of(sites, estimate)

    def observe(self) -> Observation:
        """Return what a policy is shown now."""
        return self.computer.observe()

    # --- the loop -------------------------------------------------------------------------

    def apply(self, decision: Decision) -> bool:
        """Hand a decision to the computer; return False if its site is out of reach."""
        return self.computer.apply(decision)

    def _measured(self, measurements: Measurements) -> None:
        """Hand measurements to the computer, and note them."""
        self.computer.take(measurements)
        for name, measurement in measurements.items:
            self.recorder.measurement(name, measurement, self.estimate, self.altitude)
        if self.computer.mapped:
            self.map_error = self.navigation_error
            if self.first_map_estimate is None:
                self.first_map_estimate = self.estimate

    def navigate(self) -> None:
        """Do the first half of a cycle: measure, navigate and map."""
        if not self._fresh:
            self._measured(self.plant.sense())
        self._fresh = False
        tasks = self.computer.tasks()
        if tasks:
            self._measured(self.plant.perform(tasks))
        self.computer.refresh()

    def move(self) -> None:
        """Do the second half of a cycle: command the vehicle and move it."""
        computer = self.computer
        command = computer.command()
        left = computer.guidance.time_to_go(self.time)
        self.recorder.row(self.time, self.state, self.estimate, self.site, left, computer.phase)
        self.plant.advance(command)
        if self.plant.verdict is not None:
            self._measured(self.plant.sense())
            self.recorder.row(self.time, self.state, self.estimate, self.site, 0.0, computer.phase)
            verdict = self.plant.verdict
            computer.telemetry.append(
                (
                    self.time,
                    "touchdown" if verdict.touchdown else "end",
                    {"failed": list(verdict.failed)},
                )
            )

    def step(self) -> None:
        """Advance one control cycle."""
        if self.done:
            raise RuntimeError("the flight has ended")
        self.navigate()
        if self.policy is not None and self.decision_due:
            self.apply(self.policy.decide(self.observe()))
        self.move()

    def run(self) -> Flight:
        """Fly to the end and return the record."""
        while not self.done:
            self.step()
        return self.flight()

    def _last_map(self) -> HazardMap | None:
        """Return the map, or None if nothing was ever seen."""
        if self.computer.mapper.blank or self.first_map_estimate is None:
            return None
        return self.computer.mapper.hazard_map()

    def flight(self) -> Flight:
        """Return the record of the flight so far."""
        seed = self.streams.seed
        computer = self.computer
        return Flight(
            scenario=self.scenario.to_toml(),
            seed={"entropy": seed.entropy, "spawn_key": list(seed.spawn_key)},
            policy=self.policy.name if self.policy is not None else "external",
            verdict=self.verdict or Verdict(False, ("unfinished",), None),
            trajectory=self.recorder.trajectory(),
            decisions=self.recorder.decisions(computer.diverts),
            events=self.recorder.events(computer.telemetry),
            hazard_map=self._last_map(),
            map_error=self.map_error,
            scans=self.recorder.scans,
            candidates=self.recorder.choice(computer.candidates),
        )
