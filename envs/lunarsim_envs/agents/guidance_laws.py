"""Fly descent environments with the guidance laws of the onboard computer."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.core.guidance import fallback_time
from lunarsim.frames import (
    attitude_from_thrust,
    quat_conjugate,
    quat_multiply,
    quat_to_rotation_vector,
)
from lunarsim.messages.briefing import Briefing, FlightSoftware, InitialStateEstimate
from lunarsim.models.gravity import UniformGravity
from lunarsim.onboard.control.thrust import thrust_to_command
from lunarsim.onboard.guidance.contract import PlansArrival
from lunarsim.onboard.guidance.vertical import descent_law
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts import resolve, settings_of
from lunarsim.scenario import Scenario
from lunarsim.typing import Array
from lunarsim_envs.agents.agent_interface import incompatible_agent_error
from lunarsim_envs.descent.baseline import PolynomialGuidance
from lunarsim_envs.descent.core import DescentEnvCore
from lunarsim_envs.descent.env import DescentEnv, GuidanceEnv

# Observation components that a law needs.
_NEEDED = ("position", "velocity", "attitude", "rate", "propellant")


def _descent_core(
    agent_name: str, env: gymnasium.Env[Any, Any], kind: type[DescentEnv] = DescentEnv
) -> DescentEnvCore:
    """Return the simulated batch of a descent environment of a `kind` for an agent.

    If the environment is another one, or its observation lacks a component that guidance laws need,
    an `InputError` with `agent_name` is raised.
    """
    flown = env.unwrapped
    if not isinstance(flown, kind):
        needed = "Guidance-v1" if kind is GuidanceEnv else "Guidance-v1 or Control-v1"
        raise incompatible_agent_error(agent_name, env, needed)
    missing = [part for part in _NEEDED if part not in flown.descents.shown.places]
    if missing:
        raise incompatible_agent_error(agent_name, env, f"the observation component {missing[0]!r}")
    return flown.descents


def _briefing(scenario: Scenario, software: FlightSoftware, time_to_go: float) -> Briefing:
    """Return the data known before the flight, from which a guidance law is built.

    Positions are relative to the target; `time_to_go` is the planned approach duration, s.
    """
    start, clock = scenario.start.make(), scenario.simulation.make()
    upright = attitude_from_thrust([0.0, 0.0, 1.0], start.heading)
    known = InitialStateEstimate(
        np.asarray(start.position, dtype=np.float64), np.asarray(start.velocity, dtype=np.float64),
        upright, 0.0, 0.0, 0.0,
    )  # fmt: skip
    return Briefing(
        software=software, lander=scenario.vehicle.make(), instruments={},
        gravity=UniformGravity(scenario.gravity_m_s2), target=np.zeros(3), heading=start.heading,
        start=known, time_to_go=time_to_go, sun=np.array([0.0, 0.0, 1.0]),
        rocks=scenario.expected_rocks.make(), prior_map=None, step=clock.step, cycle=clock.cycle,
    )  # fmt: skip


class GuidanceLawAgent:
    """Fly the approach with a guidance law, then the scenario's terminal descent.

    Phases, time-to-go and limits are as in the onboard computer; the observation replaces
    navigation. In ``Control-v1``, the scenario's attitude control law follows the commanded
    attitude. Both laws are evaluated at every step of the environment.

    Parameters
    ----------
    env
        ``Guidance-v1`` or ``Control-v1`` with position, velocity, attitude, rate and propellant in
        its observation.
    kind
        Kind of guidance law, as listed by `lunarsim parts guidance`. The scenario's settings apply
        if the kind is that of the scenario, otherwise the default settings of the kind.

    Raises
    ------
    InputError
        If the environment is another one or its observation lacks a component.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], kind: str) -> None:
        self._descents = _descent_core(kind, env)
        scenario = self._descents.scenario
        own = kind == scenario.guidance.kind
        table = scenario.guidance if own else settings_of(resolve("guidance", kind))()
        self._part = table.make()
        self._software: FlightSoftware = scenario.software()
        self._approach = self._software.approach
        self._lander = scenario.vehicle.make()
        self._end = self._approach.end(np.zeros(3), self._lander)
        self._touchdown_end = self._approach.touchdown_end(np.zeros(3), self._lander)
        self._has_started = False

    def begin(self, rng: np.random.Generator) -> None:
        """Reset the agent for a new episode."""
        self._has_started = False

    def _start(self, estimate: Estimate) -> None:
        """Build the guidance laws of approach and terminal descent from the start state.

        Also sets the planned arrival time and sets the agent's clock to zero.
        """
        descents, software = self._descents, self._software
        briefing = _briefing(descents.scenario, software, self._time_to_go(estimate))
        lag = software.control.response_time + self._lander.thrust_lag
        self._law = self._part.build(briefing, lag)
        self._planner = self._law if isinstance(self._law, PlansArrival) else None
        self._down = descent_law(software.terminal_descent, briefing, lag)
        self._arrival = briefing.time_to_go
        self._time, self._vertical, self._has_started = 0.0, False, True

    def _time_to_go(self, estimate: Estimate) -> float:
        """Return the minimum-propellant duration of the approach within its limits, s.

        A duration that the scenario sets has priority. If no duration is within the limits, it
        follows from distance over speed.
        """
        if self._approach.time_to_go is not None:
            return float(self._approach.time_to_go)
        end = self._approach.end(np.zeros((1, 3)), self._lander)
        gravity = self._descents.lanes.craft.dynamics.gravity
        cost = self._part.cost(estimate, end, self._lander, gravity, self._approach.limits)
        found = float(cost.time_to_go[0])
        if np.isfinite(found):
            return found
        distance = float(np.linalg.norm(end.position[0] - estimate.position))
        return float(fallback_time(distance, float(np.linalg.norm(estimate.velocity))))

    def _estimate(self, observation: Array, time: float) -> Estimate:
        """Convert an observation (size,) at `time`, s, to a state estimate."""
        places = self._descents.shown.places
        values = self._descents.physical(observation).astype(np.float64)
        position, velocity, attitude, rate, propellant = (values[places[name]] for name in _NEEDED)
        mass = self._lander.dry_mass + float(propellant[0])
        return Estimate(time, position, velocity, attitude, rate, mass, np.zeros((9, 9)))

    def act(self, observation: Any, info: dict[str, Any]) -> NDArray[np.float32]:
        """Return the action (3,) or (4,) closest to what the laws command.

        The first call of an episode also builds the laws. Each call advances the agent's clock by
        one action period.
        """
        estimate = self._estimate(observation, self._time if self._has_started else 0.0)
        if not self._has_started:
            self._start(estimate)
        left = self._arrival - self._time
        height = float(estimate.position[2]) - self._lander.com_height
        self._vertical |= height <= self._approach.vertical_altitude or left <= 0.0
        if self._vertical:
            wanted = self._down.command(estimate, self._touchdown_end, self._time)
        else:
            wanted = self._law.command(estimate, self._end, self._time, left)
            planned = self._planner.arrival if self._planner else None
            if planned is not None:
                self._arrival = planned
        self._time += self._descents.period
        return self._descents.actions.action(self._physical(wanted, estimate))

    def _physical(self, wanted: Array, estimate: Estimate) -> Array:
        """Return the command for a thrust acceleration `wanted` (3,), m/s^2.

        It is the acceleration in ``Guidance-v1``, and thrust and torques (4,), N and N m, in
        ``Control-v1``.
        """
        craft, lander = self._descents.lanes.craft, self._lander
        if self._descents.lanes.guided:
            return wanted
        command = thrust_to_command(wanted, estimate.mass, lander, craft.heading, craft.max_tilt)
        error = quat_to_rotation_vector(
            quat_multiply(quat_conjugate(estimate.attitude), command.attitude)
        )
        full = (estimate.mass - lander.dry_mass) / lander.propellant_mass
        dry, loaded = craft.dynamics.inertia
        torque = self._software.control.torque(error, estimate.rate, dry + full * (loaded - dry))
        return np.array([command.thrust, *torque])


class PolynomialLawAgent:
    """Fly ``Guidance-v1`` by E-guidance, then vertically, with `PolynomialGuidance`.

    Parameters
    ----------
    env
        ``Guidance-v1`` whose observation begins with position and velocity, and also has attitude,
        rate and propellant.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self._law = PolynomialGuidance(_descent_core("polynomial", env, GuidanceEnv))

    def begin(self, rng: np.random.Generator) -> None:
        """Do nothing: the agent has no memory and is deterministic."""

    def act(self, observation: Any, info: dict[str, Any]) -> NDArray[np.float32]:
        """Return the action (3,) of the guidance law for an observation."""
        return self._law(observation)
