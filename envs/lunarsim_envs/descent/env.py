"""Environments ``lunarsim/Guidance-v1`` and ``lunarsim/Control-v1``: descents."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Unpack

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.typing import Array, BoolArray
from lunarsim_envs.arguments import checked_options
from lunarsim_envs.descent.batch import FLYING
from lunarsim_envs.descent.core import DescentEnvArguments, DescentEnvCore
from lunarsim_envs.descent.lane_renderer import LaneRenderer
from lunarsim_envs.descent.plane_view import Image, PlaneView
from lunarsim_envs.frame_window import FrameWindow, available_render_modes
from lunarsim_envs.resets import check_all_reset, lane_seeds, reset_mask
from lunarsim_envs.rewards import sum_terms
from lunarsim_envs.step_limit import StepLimit

Shown = NDArray[np.float32]


class DescentEnv(gymnasium.Env[Any, Any]):
    """Base class of the single-lander environments `GuidanceEnv` and `ControlEnv`."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 5}  # noqa: RUF012
    guided: ClassVar[bool]
    rate: ClassVar[float]

    def __init__(
        self, render_mode: str | None = None, **settings: Unpack[DescentEnvArguments]
    ) -> None:
        if render_mode not in (None, "rgb_array", "human"):
            raise ValueError(
                f"render_mode: must be 'rgb_array', 'human' or None, got {render_mode!r}."
            )
        self.render_mode = render_mode
        settings.setdefault("rate_hz", self.rate)
        self.descents = DescentEnvCore(None, guided=self.guided, **settings)
        self.action_space = self.descents.actions.space
        self.observation_space = self.descents.observation_space
        # The class always lists "human", because Gymnasium checks the class before the instance.
        modes = available_render_modes(self.metadata["render_modes"])
        fps = max(round(1.0 / self.descents.period), 1)
        self.metadata = self.metadata | {"render_modes": modes, "render_fps": fps}
        self._one = np.ones(1, np.bool_)
        self._picture = PlaneView(self.descents.lanes) if render_mode is not None else None
        self._screen = FrameWindow(self.metadata["render_fps"]) if render_mode == "human" else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Shown, dict[str, Any]]:
        """Start a new episode; return its first observation (size,) and info."""
        self.descents.apply_options(self._one, options)
        super().reset(seed=seed)
        if seed is not None or not self.descents.lanes.has_key[0]:
            self.descents.sample_key(0, self.np_random)
        self.descents.restart(self._one)
        if self._picture is not None:
            self._picture.begin()
        self._show()
        return self.descents.observe()[0], self._hidden()

    def _hidden(self) -> dict[str, Any]:
        extra_info = self.descents.extra_info()
        if "randomized" in extra_info:
            extra_info["randomized"] = {
                name: float(one[0]) for name, one in extra_info["randomized"].items()
            }
        if "privileged" in extra_info:
            extra_info["privileged"] = extra_info["privileged"][0]
        return extra_info

    def step(self, action: ArrayLike) -> tuple[Shown, float, bool, bool, dict[str, Any]]:
        """Fly with an action until the next action is due, or to the end of the flight."""
        d = self.descents
        if d.lanes.ended[0] != FLYING:
            raise gymnasium.error.ResetNeeded("The episode has ended. Call reset().")
        terms, _, over = d.step(action)
        named = {name: float(term[0]) for name, term in terms.items()}
        if self._picture is not None:
            self._picture.note()
        self._show()
        ended = bool(over[0])
        cost = float(ended and not d.lanes.safe[0])
        info: dict[str, Any] = {"reward_terms": named, "cost": cost} | self._hidden()
        if ended:
            info |= {"safe": bool(d.lanes.safe[0]), "failure_causes": d.lanes.failure_causes(0)}
            info |= {name: float(value[0]) for name, value in d.outcome().items()}
        return d.observe()[0], float(sum_terms(named)), ended, False, info

    def _show(self) -> None:
        if self._screen is not None and self._picture is not None:
            self._screen.show(self._picture.draw())

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._screen is not None:
            self._screen.close()

    def render(self) -> Any:
        """Return an RGB image of the descent plane and gauges (440, 640, 3).

        Without a render mode, and in the mode ``"human"``, in which a window shows every frame
        during the flight, it returns None.
        """
        if self._picture is None or self._screen is not None:
            return None
        if not self.descents.lanes.has_key[0]:
            raise gymnasium.error.ResetNeeded("Call reset() before render().")
        return self._picture.draw()


class DescentVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Base class of the vector environments, which fly all descents in one kernel.

    Environment i with seed s gives bitwise the same episodes as a single environment with seed
    s + i, for any number of environments and threads.
    """

    guided: ClassVar[bool]
    rate: ClassVar[float]

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: str | gymnasium.vector.AutoresetMode = "NextStep",
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        rendered: Sequence[int] = (0,),
        **settings: Unpack[DescentEnvArguments],
    ) -> None:
        self.descents = DescentEnvCore(
            num_envs, guided=self.guided, **({"rate_hz": self.rate} | settings)
        )
        self.num_envs = num_envs
        self.autoreset_mode = gymnasium.vector.AutoresetMode(autoreset_mode)
        self._renderer = LaneRenderer(render_mode, rendered, self.descents.lanes)
        self.metadata = {
            "render_modes": ["rgb_array"], "autoreset_mode": self.autoreset_mode,
            "render_fps": max(round(1.0 / self.descents.period), 1),
        }  # fmt: skip
        self.single_action_space = self.descents.actions.space
        self.single_observation_space = self.descents.observation_space
        batch = gymnasium.vector.utils.batch_space
        self.action_space = batch(self.single_action_space, num_envs)
        self.observation_space = batch(self.single_observation_space, num_envs)
        self._due, self._was_reset = np.zeros((2, num_envs), np.bool_)
        self._limit = StepLimit(max_episode_steps, num_envs)
        self.render_mode = render_mode

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Shown, dict[str, Any]]:
        """Start episodes in all environments, or those of ``options["reset_mask"]`` (n,)."""
        left = checked_options(options)
        mask = reset_mask(left.pop("reset_mask", None), self.num_envs)
        check_all_reset(self._was_reset, mask)
        seeds = lane_seeds(seed, mask)
        self.descents.apply_options(mask, left)
        self.descents.seed(mask, seeds)
        self._restart(mask)
        self._was_reset |= mask
        self._due[mask] = False
        return self.descents.observe(), self._hidden()

    def _restart(self, mask: BoolArray) -> None:
        self.descents.restart(mask)
        self._limit.begin(mask)
        self._renderer.begin(mask)

    def render(self) -> tuple[Image, ...] | None:
        """Return an RGB image (440, 640, 3) of each environment of `rendered`.

        Without a render mode, it returns None. With the autoreset mode "SameStep", the image after
        the last step of an episode shows the next one.
        """
        if self._renderer.has_views and not self._was_reset.all():
            raise gymnasium.error.ResetNeeded("Call reset() before render().")
        return self._renderer.draw()

    def _hidden(self) -> dict[str, Any]:
        extra_info = self.descents.extra_info()
        every = np.ones(self.num_envs, np.bool_)
        return extra_info | {f"_{name}": every for name in extra_info}

    def step(self, actions: ArrayLike) -> tuple[Shown, Array, BoolArray, BoolArray, dict[str, Any]]:
        """Advance all environments by one action, or to the end of their flights."""
        d, mode = self.descents, gymnasium.vector.AutoresetMode
        idle = d.lanes.ended != FLYING
        if (idle & ~self._due).any():
            raise gymnasium.error.ResetNeeded(
                "An episode has ended. Call reset() with options['reset_mask']."
            )
        terms, moved, terminated = d.step(actions)
        self._renderer.add_positions(moved)
        over = terminated
        info: dict[str, Any] = {"reward_terms": terms, "_reward_terms": moved}
        info |= {"cost": np.where(over & ~d.lanes.safe, 1.0, 0.0), "_cost": moved}
        if over.any():
            info |= {"safe": d.lanes.safe & over, "_safe": over}
            info |= {"failure_causes": np.where(over, d.lanes.failed, 0), "_failure_causes": over}
            for name, values in d.outcome().items():
                info |= {name: np.where(over, values, 0.0), f"_{name}": over}
        truncated = self._limit.reached(moved)
        over = terminated | truncated
        d.lanes.stop(over)
        if self.autoreset_mode is mode.NEXT_STEP:
            if self._due.any():
                self._restart(self._due)
            self._due = over
        elif self.autoreset_mode is mode.SAME_STEP and over.any():
            info |= {"final_obs": d.observe(), "_final_obs": over} | self._hidden()
            left = ("_reward_terms", "_cost", "final_obs", "_final_obs")
            info["final_info"] = {name: info[name] for name in info if name not in left}
            info["_final_info"] = over
            self._restart(over)
        info |= self._hidden()
        return d.observe(), sum_terms(terms), terminated, truncated, info


class GuidanceEnv(DescentEnv):
    """Fly a lander to its target with thrust acceleration commands.

    The agent replaces the guidance law. The attitude loop and the throttle follow its commands with
    perfect sensors.

    ## Action Space

    ``Box(-1, 1, (3,))`` at 5 Hz: commanded thrust acceleration, ENU. East and north range from
    -A / 2 to A / 2, up from 0 to A, with A = thrust_max / dry_mass (5.45 m/s^2). Action 0 is a
    vertical thrust equal to the weight. The difference to it grows with the square of the action,
    so that small commands are well resolved. Commands beyond the thrust range or the maximum tilt
    of the scenario's approach are limited as for a guidance law.
    ``env.unwrapped.descents.actions.action(acceleration)`` converts m/s^2 to an action.

    ## Observation Space

    ``Box`` of float32 (32,), scaled for neural networks. With ``scaled=False`` it is (16,) in SI
    units, with these components in sequence (``observation=[...]`` selects others):

    - ``position`` (3,): centre of mass relative to the target, ENU, m.
    - ``velocity`` (3,): velocity, ENU, m/s.
    - ``attitude`` (4,): quaternion, body axes to ENU, scalar last.
    - ``rate`` (3,): angular rate, body axes, rad/s.
    - ``thrust`` (1,): current thrust over mass, m/s^2.
    - ``propellant`` (1,): remaining propellant, kg.
    - ``time_left`` (1,): time until the time limit, s.

    The scaled observation has x / far of all values x, then asinh(x / near) of all values. The
    scales of position are far = 600 m and near = 3 m, of velocity 40 and 1 m/s, of attitude 1 and
    0.1, of rate 0.5 and 0.1 rad/s, of thrust 4 and 1 m/s^2, of propellant 400 kg, of time 120 and
    10 s. ``env.unwrapped.descents.physical(observation)`` returns the SI values.
    `lunarsim_envs.descent.observations.register` adds custom components.

    ## Rewards

    The reward is the sum of the terms in ``info["reward_terms"]``:

    - ``touchdown``: +10 for a touchdown within all limits, 0 for a crash, -15 for a flight
      without touchdown.
    - ``propellant``: -0.002 per kilogram.
    - ``miss``: -0.1 per metre between a safe touchdown and the target, up to 50 m.
    - ``severity``: up to -6 for the distance of a crash from the target, relative to that of the
      planned start.
    - ``excess``: -0.2 ln(value / limit), at most -0.6, for each limit of speed, tilt and rate that
      a crash exceeds. A crash outside the stored terrain costs the maximum.
    - ``shaping``: difference of a potential, which falls with the deviation of the velocity from
      one that leads to the target with constant deceleration and, near the target, with the angular
      rate. It is 0 after the end, so the sum over an episode depends only on the start state.

    ``info["score"]`` at the end is the sum without shaping. Every safe landing has a higher score
    than any crash, and every crash a higher score than any flight without touchdown; weights that
    violate this are refused. From the same start, returns and scores rank flights in the same way.

    A discount factor per step depends on the action rate: 0.99 at 5 Hz is 0.95 per second, and
    corresponds to 0.999 at 50 Hz.

    ``info["cost"]``, for constrained methods, is 1 if the episode ends without a safe landing, and
    0 otherwise. `lunarsim_envs.costs.CostWrapper` adds costs of every step.

    ## Starting State

    About 600 m from the target and 500 m above it, at 28 m/s towards the target and 18 m/s
    downward, upright, with full tanks. The table [start] of the scenario sets these values; by
    default the dispersion is 30 m and 3 m/s (1 sigma per axis).

    For a curriculum, ``reset(options=...)`` accepts ``position_m``, ``velocity_m_s``,
    ``position_sigma_m`` and ``velocity_sigma_m_s`` of that table, ``target_m`` and
    ``target_scatter_m`` of [target] (within the target area of the scenario), and ``cover`` (one of
    ``covers`` or that of the scenario). Options hold until the next call of `reset`; automatic
    resets keep them.

    The table [domain_randomization] of a scenario (``changes={"domain_randomization.payload_kg":
    50.0}``) randomizes each flight: payload mass, specific impulse, thrust, thrust lag, offset of
    the thrust line; failures of thrust and torque from a random time; noise and delay of the
    observation, and delay of the action.
    ``info["randomized"]`` contains the random values.

    ## Episode End

    The episode terminates at touchdown (outside the stored terrain 1 m below its lowest point), at
    1.5 times the start distance from the target (``"flown-away"``), and at the time limit of the
    scenario (120 s, ``"time-limit"``). The simulation evaluates the touchdown (``info["safe"]``,
    ``info["failure_causes"]``). ``info`` then also has ``time_s``, ``propellant_kg`` used,
    ``miss_m``, the horizontal distance from the target, and ``score``. In a vector environment,
    ``info["failure_causes"]`` has one bit for each limit in
    `lunarsim.core.touchdown.CAUSES`.

    ## Arguments

    - ``scenario``: a `lunarsim.scenario.Scenario`, the path of a TOML file or the name of a
      scenario that is supplied with lunarsim. Default: nearly flat terrain without rocks.
    - ``changes``: changed values by key, for example ``{"rocks.cover": 0.05}``.
    - ``rate_hz``: action rate, Hz.
    - ``observation``: names of the observation components.
    - ``scaled``: whether the observation is scaled (default) or in SI units.
    - ``weights``: `lunarsim_envs.descent.rewards.DescentWeights`, ``"dense"`` (default weights) or
      ``"sparse"`` (1 for a safe landing, otherwise 0). Default: the table [descent_reward] of the
      scenario.
    - ``render_mode``: ``"rgb_array"`` returns images of the descent plane with gauges; ``"human"``
      shows them in a window (not with vector environments); None disables rendering.
    - ``worlds``, ``world_seed``: number of worlds (simulated terrains with rocks) in the pool and
      their root seed (defaults: 1 and 0). Each flight uses one of them. The terrain is a raster
      with a grid spacing of 0.1 m around the targets.
    - ``split``: ``"train"`` (default), ``"validation"`` or ``"test"``. No world of one split is a
      world of another, for any seed. ``lunarsim evaluate`` flies ``"test"`` by default.
    - ``covers``: additional rock covers for ``reset(options={"cover": ...})``. The pool has
      ``worlds`` worlds for each cover.
    - ``privileged``: adds ``info["privileged"]`` (29,) for asymmetric critics: the true state with
      the default observation components, then all values of ``info["randomized"]``.
    - ``dispersions``: must be omitted; ``Retarget-v1`` draws faults of sensors and actuators.
    - ``num_envs``, ``autoreset_mode``, ``max_episode_steps``, ``rendered`` with
      ``gymnasium.make_vec(..., vectorization_mode="vector_entry_point")``: number of flights in one
      kernel; "NextStep", "SameStep" or "Disabled"; number of steps until truncation; environments
      whose frames ``render`` returns with ``render_mode="rgb_array"`` (default: the first one).
      Environment i with seed s gives the same episodes as a single environment with seed s + i.

    ## Version History

    - v1: first version.
    """

    guided, rate = True, 5.0


class GuidanceVectorEnv(DescentVectorEnv):
    """Fly many landers at once with thrust acceleration commands.

    It is the vector version of `GuidanceEnv`, with the same arguments.
    """

    guided, rate = True, 5.0


class ControlEnv(DescentEnv):
    """Fly a lander to its target with throttle and torque commands.

    The agent replaces guidance and attitude control.

    ## Action Space

    ``Box(-1, 1, (4,))`` at 50 Hz: thrust from its minimum (-1) to its maximum (1), and torques
    about the body axes. Action 0 is a thrust equal to the weight without propellant, and no torque;
    the difference to it grows with the square of the action. The engine cannot be shut down before
    touchdown.

    ## Observation Space

    Same as `lunarsim/Guidance-v1`.

    ## Rewards

    Same as `lunarsim/Guidance-v1`.

    ## Starting State

    Same as `lunarsim/Guidance-v1`.

    ## Episode End

    Same as `lunarsim/Guidance-v1`.

    ## Arguments

    Same as `lunarsim/Guidance-v1`.

    ## Version History

    - v1: first version.
    """

    guided, rate = False, 50.0


class ControlVectorEnv(DescentVectorEnv):
    """Fly many landers at once with throttle and torque commands.

    It is the vector version of `ControlEnv`, with the same arguments.
    """

    guided, rate = False, 50.0
