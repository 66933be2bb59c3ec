"""Guidance laws of the onboard computer as agents of ``Guidance-v0``."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import attitude_from_thrust
from lunarsim.messages.briefing import Briefing, Software, StartEstimate
from lunarsim.models.gravity import UniformGravity
from lunarsim.onboard.guidance.contract import PlansArrival
from lunarsim.onboard.guidance.vertical import descent_law
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts import resolve, settings_of
from lunarsim.scenario import Scenario
from lunarsim_envs.agents.contract import refuse
from lunarsim_envs.descent.baseline import PolynomialAgent
from lunarsim_envs.descent.core import Descents
from lunarsim_envs.descent.env import GuidanceEnv

Array = NDArray[np.float64]

# What a law is told of the lander.
_NEEDED = ("position", "velocity", "attitude", "rate", "propellant")
# Where nothing is within the limits of a path: so many times the way over the speed, and at least
# so long, s. The computer does the same after braking.
_LONGER, _LEAST, _SLOWEST = 2.0, 5.0, 1.0


def _descents(name: str, env: gymnasium.Env[Any, Any]) -> Descents:
    flown = env.unwrapped
    if not isinstance(flown, GuidanceEnv):
        raise refuse(name, env, "Guidance-v0")
    missing = [part for part in _NEEDED if part not in flown.descents.shown.places]
    if missing:
        raise refuse(name, env, f"observations with {missing[0]!r} among their parts")
    return flown.descents


def _briefing(scenario: Scenario, software: Software, time_to_go: float) -> Briefing:
    """Return what a law is built from: the target is where positions are counted from."""
    start, clock = scenario.start.make(), scenario.simulation.make()
    upright = attitude_from_thrust([0.0, 0.0, 1.0], start.heading)
    known = StartEstimate(
        np.asarray(start.position, dtype=np.float64), np.asarray(start.velocity, dtype=np.float64),
        upright, 0.0, 0.0, 0.0,
    )  # fmt: skip
    return Briefing(
        software=software, lander=scenario.vehicle.make(), instruments={},
        gravity=UniformGravity(scenario.gravity_m_s2), target=np.zeros(3), heading=start.heading,
        start=known, time_to_go=time_to_go, sun=np.array([0.0, 0.0, 1.0]),
        rocks=scenario.expected_rocks.make(), prior_map=None, step=clock.step, cycle=clock.cycle,
    )  # fmt: skip


class LawAgent:
    """A guidance law to the end of the approach, then the scenario's way down from there.

    Phases, time-to-go and limits are the onboard computer's; navigation is the observation. The
    law is asked as often as the environment asks, not once a cycle of the computer.

    Parameters
    ----------
    env
        ``Guidance-v0``, whose observation has position, velocity, attitude, rate and propellant.
    kind
        As `lunarsim parts guidance` lists it, with its defaults.

    Raises
    ------
    InputError
        If it is another environment, or its observation lacks a part.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], kind: str) -> None:
        self._descents = _descents(kind, env)
        scenario = self._descents.scenario
        own = kind == scenario.guidance.kind
        table = scenario.guidance if own else settings_of(resolve("guidance", kind))()
        self._part = table.make()
        self._software: Software = scenario.software()
        self._approach = self._software.approach
        self._lander = scenario.vehicle.make()
        self._begun = False

    def begin(self, rng: np.random.Generator) -> None:
        """Forget the last flight."""
        self._begun = False

    def _start(self, estimate: Estimate) -> None:
        """Choose the time-to-go from where the flight begins, and build its laws."""
        descents, software = self._descents, self._software
        briefing = _briefing(descents.scenario, software, self._time_to_go(estimate))
        lag = software.control.response_time + self._lander.thrust_lag
        self._law = self._part.build(briefing, lag)
        self._down = descent_law(software.descent, briefing, lag)
        self._arrival = briefing.time_to_go
        self._time, self._vertical, self._begun = 0.0, False, True

    def _time_to_go(self, estimate: Estimate) -> float:
        """Return how long the approach is to take, s: the cheapest within the limits of paths."""
        if self._approach.time_to_go is not None:
            return float(self._approach.time_to_go)
        end = self._approach.end(np.zeros((1, 3)), self._lander)
        gravity = self._descents.lanes.craft.dynamics.gravity
        cost = self._part.cost(estimate, end, self._lander, gravity, self._approach.limits)
        found = float(cost.time_to_go[0])
        if np.isfinite(found):
            return found
        way = float(np.linalg.norm(end.position[0] - estimate.position))
        speed = max(float(np.linalg.norm(estimate.velocity)), _SLOWEST)
        return max(_LONGER * way / speed, _LEAST)

    def _estimate(self, observation: Array, time: float) -> Estimate:
        """Return an observation as laws take it."""
        places = self._descents.shown.places
        seen = {name: observation[places[name]].astype(np.float64) for name in _NEEDED}
        mass = self._lander.dry_mass + float(seen["propellant"][0])
        return Estimate(
            time, seen["position"], seen["velocity"], seen["attitude"], seen["rate"], mass,
            np.zeros((9, 9)),
        )  # fmt: skip

    def act(self, observation: Any, info: dict[str, Any]) -> NDArray[np.float32]:
        """Return the action nearest to the acceleration that the law asks for."""
        estimate = self._estimate(observation, self._time if self._begun else 0.0)
        if not self._begun:
            self._start(estimate)
        left = self._arrival - self._time
        height = float(estimate.position[2]) - self._lander.com_height
        self._vertical |= height <= self._approach.vertical_altitude or left <= 0.0
        if self._vertical:
            end = self._approach.ground(np.zeros(3), self._lander)
            wanted = self._down.command(estimate, end, self._time)
        else:
            end = self._approach.end(np.zeros(3), self._lander)
            wanted = self._law.command(estimate, end, self._time, left)
            if isinstance(self._law, PlansArrival) and self._law.arrival is not None:
                self._arrival = self._law.arrival
        self._time += self._descents.period
        return self._descents.actions.action(wanted)


class Polynomial:
    """`lunarsim_envs.descent.baseline.PolynomialAgent`, which keeps nothing between actions.

    Parameters
    ----------
    env
        ``Guidance-v0``, whose observation begins with position and velocity.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self._law = PolynomialAgent(_descents("polynomial", env))

    def begin(self, rng: np.random.Generator) -> None:
        """Draw nothing."""

    def act(self, observation: Any, info: dict[str, Any]) -> NDArray[np.float32]:
        """Return the law's action."""
        return self._law(observation)
