"""Costs for constrained reinforcement learning, returned by `step` of a wrapper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError, suggestion
from lunarsim.scenario import Scenario
from lunarsim.typing import Array, BoolArray
from lunarsim_envs.descent.batch import DescentBatch
from lunarsim_envs.descent.env import DescentEnv, DescentVectorEnv
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.flights import KernelFlight

COSTS = ("unsafe", "glideslope", "tilt", "rate", "reserve", "hazard")
# The glideslope is not evaluated within this horizontal distance of the target, m.
FREE_DISTANCE_M = 10.0


class StateCosts:
    """Evaluate the costs of the states of n landers against the limits of a scenario.

    ``tilt``, ``rate``, ``glideslope`` and ``reserve`` are the excess over the limit as a fraction
    of the limit, 0 within it:

    - ``tilt``: ``approach.max_tilt_deg``.
    - ``rate``: largest component of the angular rate; ``control.slew_limit_deg_s``.
    - ``glideslope``: missing height below the cone of ``approach.glideslope_deg`` about the target,
      over the height of the cone, at most 1; 0 within 10 m of the target. In ``Retarget-v1`` it is
      that of the estimated position.
    - ``reserve``: missing propellant below ``approach.reserve_kg``.

    ``hazard`` is 1 - p_safe of the current site, and 1 if the site was not observed; it is 0 in
    environments without a hazard map.
    """

    def __init__(self, scenario: Scenario) -> None:
        approach, control = scenario.approach.make(), scenario.control.make()
        self.max_tilt, self.reserve = float(approach.max_tilt), float(approach.reserve)
        self.slope = float(np.tan(approach.glideslope))
        self.com_height = float(scenario.vehicle.make().com_height)
        self.max_rate = float(getattr(control, "slew_limit", np.inf))

    def of(
        self, offset: Array, attitude: Array, rate: Array, left: Array, p_safe: Array | None
    ) -> dict[str, Array]:
        """Return the costs (n,) by name, without ``unsafe``.

        Parameters
        ----------
        offset
            Centre of mass relative to the target on the terrain (n, 3), ENU, m.
        attitude, rate
            Quaternion (n, 4), scalar last, and angular rate (n, 3), body axes, rad/s.
        left
            Remaining propellant (n,), kg.
        p_safe
            Probability of safe terrain at the current site (n,), NaN if not observed; None without
            a hazard map.
        """
        axis = 1.0 - 2.0 * (attitude[:, 0] ** 2 + attitude[:, 1] ** 2)
        tilt = np.arccos(np.clip(axis, -1.0, 1.0))
        cone = self.slope * (np.hypot(offset[:, 0], offset[:, 1]) - FREE_DISTANCE_M)
        height = np.maximum(offset[:, 2] - self.com_height, 0.0)
        missing = 1.0 - left / self.reserve if self.reserve > 0.0 else np.zeros(len(left))
        hazard = np.zeros(len(left)) if p_safe is None else 1.0 - np.nan_to_num(p_safe, nan=0.0)
        return {
            "glideslope": np.where(cone > height, 1.0 - height / np.maximum(cone, 1e-12), 0.0),
            "tilt": np.maximum(tilt / self.max_tilt - 1.0, 0.0),
            "rate": np.maximum(np.abs(rate).max(axis=1) / self.max_rate - 1.0, 0.0),
            "reserve": np.maximum(missing, 0.0),
            "hazard": hazard,
        }  # fmt: skip


def _checked_names(names: Sequence[str]) -> tuple[str, ...]:
    """Check that `names` are costs, each given once, and return them."""
    if not isinstance(names, Sequence):
        raise InputError("costs", names, f"must be a list of names: {', '.join(COSTS)}")
    listed = [names] if isinstance(names, str) else list(names)
    for i, name in enumerate(listed):
        if name not in COSTS:
            raise InputError(f"costs[{i}]", name, "is unknown", suggestion(str(name), COSTS))
    if not listed or len(set(listed)) < len(listed):
        raise InputError("costs", listed, "must be one or more names, each given once")
    return tuple(listed)


def _scenario_of(env: Any, kinds: tuple[type, ...], name: str) -> Scenario:
    """Return the scenario of an environment, whose class must be one of `kinds`.

    Another environment raises an `InputError`, which calls the right one `name`.
    """
    holder: Any = getattr(env, "descents", env)
    if not isinstance(env, kinds):
        raise InputError("env", type(env).__name__, f"must be {name} of lunarsim_envs")
    return holder.scenario  # type: ignore[no-any-return]


def _batch_costs(limits: StateCosts, lanes: DescentBatch) -> dict[str, Array]:
    """Return the costs (n,) of a batch of landers by name, without ``unsafe``."""
    place, target, p_safe = lanes.y[:, :3], lanes.target, None
    if isinstance(lanes, SiteDescentBatch):
        place, target = lanes.estimated_state[0], lanes.guidance.site
        p_safe = lanes.candidates.here[:, 0]
    left = lanes.y[:, 13] - lanes.params[:, 3]
    return limits.of(place - target, lanes.y[:, 6:10], lanes.y[:, 10:13], left, p_safe)


class CostWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Return a cost from `step`, as environments of Safety-Gymnasium do.

    `step` returns observation, reward, cost, terminated, truncated and info. The cost is the sum of
    the selected costs after the step; ``info["costs"]`` has all of them by name: ``unsafe`` (1 if
    the episode ends or is truncated without a safe landing, otherwise 0) and those of `StateCosts`.
    The wrapper must be the outermost one, because other wrappers expect five values from `step`.

    Parameters
    ----------
    env
        ``Guidance-v1``, ``Control-v1`` or ``Retarget-v1``, possibly with wrappers.
    costs
        Names of the costs to add.

    Attributes
    ----------
    limits
        Limits of the costs, `StateCosts`.

    Raises
    ------
    InputError
        If a name is unknown or `env` is another environment.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], costs: Sequence[str] = ("unsafe",)) -> None:
        super().__init__(env)
        self.names = _checked_names(costs)
        self.limits = StateCosts(
            _scenario_of(env.unwrapped, (DescentEnv, RetargetEnv), "an environment")
        )

    def _state_costs(self) -> dict[str, Array]:
        """Return the costs (1,) of the current state by name, without ``unsafe``."""
        inner = self.env.unwrapped
        if isinstance(inner, DescentEnv):
            return _batch_costs(self.limits, inner.descents.lanes)
        assert isinstance(inner, RetargetEnv)
        if isinstance(inner.flight, KernelFlight):
            return _batch_costs(self.limits, inner.flight.lanes)
        assert inner.simulation is not None
        seen, state = inner.flight.inputs, inner.simulation.state
        left = np.array([state.mass - inner.simulation.lander.dry_mass])
        return self.limits.of(
            seen.position - seen.site, state.attitude[None], state.rate[None], left, seen.here[:, 0]
        )

    def step(self, action: Any) -> Any:
        """Fly one step; return observation, reward, cost, terminated, truncated and info."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        costs = dict.fromkeys(COSTS, 0.0)
        if "cost" in info:  # not in the step of an automatic reset
            costs["unsafe"] = float((terminated or truncated) and not info.get("safe", False))
            costs |= {name: float(value[0]) for name, value in self._state_costs().items()}
        info["costs"] = costs
        cost = sum(costs[name] for name in self.names)
        return observation, reward, cost, terminated, truncated, info


class VectorCostWrapper(gymnasium.vector.VectorWrapper):
    """Return costs (n,) from `step` of a vector environment, as `CostWrapper` does.

    ``info["costs"]`` has an array (n,) for each cost; flights that had ended before the step have
    cost 0.

    Parameters
    ----------
    env
        Vector environment of ``Guidance-v1``, ``Control-v1`` or ``Retarget-v1``, with its own
        vector entry point and the autoreset mode "NextStep" or "Disabled".
    costs
        Names of the costs to add.

    Attributes
    ----------
    limits
        Limits of the costs, `StateCosts`.

    Raises
    ------
    InputError
        If a name is unknown, `env` is another environment, or its autoreset mode is "SameStep", in
        which the last state of a flight is replaced by the first one of the next.
    """

    def __init__(
        self, env: gymnasium.vector.VectorEnv[Any, Any, Any], costs: Sequence[str] = ("unsafe",)
    ) -> None:
        super().__init__(env)
        self.names = _checked_names(costs)
        inner: Any = env.unwrapped
        self.limits = StateCosts(
            _scenario_of(inner, (DescentVectorEnv, RetargetVectorEnv), "a vector environment")
        )
        is_descent = isinstance(inner, DescentVectorEnv)
        self._lanes: DescentBatch = inner.descents.lanes if is_descent else inner.lanes
        if inner.autoreset_mode is gymnasium.vector.AutoresetMode.SAME_STEP:
            raise InputError("autoreset_mode", "SameStep", "must be 'NextStep' or 'Disabled'")

    def step(self, actions: ArrayLike) -> Any:
        """Fly one step; return observations, rewards, costs, ends and info.

        The ends are two masks (n,): terminated and truncated.
        """
        observations, rewards, terminated, truncated, info = self.env.step(actions)
        moved: BoolArray = info["_cost"]
        states = _batch_costs(self.limits, self._lanes)
        safe = info.get("safe", np.zeros(len(moved), np.bool_))
        costs = {"unsafe": (terminated | truncated) & ~safe} | states
        costs = {name: np.where(moved, value, 0.0) for name, value in costs.items()}
        info |= {"costs": costs, "_costs": moved}
        total = np.sum([costs[name] for name in self.names], axis=0)
        return observations, rewards, total, terminated, truncated, info
