"""``lunarsim/Guidance-v0`` and ``lunarsim/Control-v0``: an agent flies the descent itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Unpack

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim_envs.arguments import no_pictures, options_of
from lunarsim_envs.descent.core import Descents, Settings
from lunarsim_envs.descent.lanes import FLYING
from lunarsim_envs.descent.picture import Picture
from lunarsim_envs.resets import check_begun, lane_seeds, reset_mask
from lunarsim_envs.rewards import summed
from lunarsim_envs.screen import Screen, modes_here
from lunarsim_envs.step_limit import StepLimit

Shown = NDArray[np.float32]


class DescentEnv(gymnasium.Env[Any, Any]):
    """One descent; see `GuidanceEnv` and `ControlEnv` for what differs."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 5}  # noqa: RUF012
    guided: ClassVar[bool]
    rate: ClassVar[float]

    def __init__(self, render_mode: str | None = None, **settings: Unpack[Settings]) -> None:
        if render_mode not in (None, "rgb_array", "human"):
            raise ValueError(f"render_mode = {render_mode!r}: must be 'rgb_array', 'human' or None")
        self.render_mode = render_mode
        settings.setdefault("rate_hz", self.rate)
        self.descents = Descents(None, guided=self.guided, **settings)
        self.action_space = self.descents.actions.space
        self.observation_space = self.descents.shown.space
        # Those of the class have "human" everywhere: else Gymnasium would not ask for it here.
        modes = modes_here(self.metadata["render_modes"])
        fps = max(round(1.0 / self.descents.period), 1)
        self.metadata = self.metadata | {"render_modes": modes, "render_fps": fps}
        self._one = np.ones(1, np.bool_)
        self._picture = Picture(self.descents.lanes) if render_mode is not None else None
        self._screen = Screen(self.metadata["render_fps"]) if render_mode == "human" else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Shown, dict[str, Any]]:
        """Draw a new flight."""
        self.descents.take(self._one, options)
        super().reset(seed=seed)
        if seed is not None or not self.descents.lanes.has_key[0]:
            self.descents.key(0, self.np_random)
        self.descents.restart(self._one)
        if self._picture is not None:
            self._picture.begin()
        self._show()
        return self.descents.observe()[0], self._hidden()

    def _hidden(self) -> dict[str, Any]:
        told = self.descents.hidden()
        if "drawn" in told:
            told["drawn"] = {name: float(one[0]) for name, one in told["drawn"].items()}
        if "privileged" in told:
            told["privileged"] = told["privileged"][0]
        return told

    def step(self, action: ArrayLike) -> tuple[Shown, float, bool, bool, dict[str, Any]]:
        """Fly on to the next action, or to the end."""
        d = self.descents
        if d.lanes.ended[0] != FLYING:
            raise gymnasium.error.ResetNeeded("no flight is in the air: call reset()")
        terms, _, terminated, truncated = d.step(action)
        named = {name: float(term[0]) for name, term in terms.items()}
        if self._picture is not None:
            self._picture.note()
        self._show()
        crash = bool(terminated[0]) and not d.lanes.safe[0]
        info: dict[str, Any] = {"reward_terms": named, "cost": float(crash)} | self._hidden()
        if terminated[0] or truncated[0]:
            info |= {"safe": bool(d.lanes.safe[0]), "failed": d.lanes.words(0)}
            info |= {name: float(told[0]) for name, told in d.told().items()}
        ends = bool(terminated[0]), bool(truncated[0])
        return d.observe()[0], float(summed(named)), *ends, info

    def _show(self) -> None:
        if self._screen is not None and self._picture is not None:
            self._screen.show(self._picture.draw())

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._screen is not None:
            self._screen.close()

    def render(self) -> Any:
        """Return the plane of the descent and gauges as an image (440, 640, 3), or None.

        In the mode ``"human"`` a window shows every frame as the flight goes.
        """
        if self._picture is None or self._screen is not None:
            return None
        if not self.descents.lanes.has_key[0]:
            raise gymnasium.error.ResetNeeded("call reset() before render()")
        return self._picture.draw()


class DescentVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Many descents at once, in one kernel; see `GuidanceEnv` and `ControlEnv`.

    Lane i with seed s flies what one environment with seed s + i flies, bit for bit, with any
    number of lanes and threads.
    """

    guided: ClassVar[bool]
    rate: ClassVar[float]

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: str | gymnasium.vector.AutoresetMode = "NextStep",
        render_mode: None = None,
        max_episode_steps: int | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        no_pictures(render_mode)
        self.descents = Descents(
            num_envs, guided=self.guided, **({"rate_hz": self.rate} | settings)
        )
        self.num_envs = num_envs
        self.autoreset_mode = gymnasium.vector.AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_action_space = self.descents.actions.space
        self.single_observation_space = self.descents.shown.space
        batch = gymnasium.vector.utils.batch_space
        self.action_space = batch(self.single_action_space, num_envs)
        self.observation_space = batch(self.single_observation_space, num_envs)
        self._due, self._begun = np.zeros((2, num_envs), np.bool_)
        self._limit = StepLimit(max_episode_steps, num_envs)
        self.render_mode = None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Shown, dict[str, Any]]:
        """Begin new flights in all lanes, or those of ``options["reset_mask"]`` (n,)."""
        left = options_of(options)
        mask = reset_mask(left.pop("reset_mask", None), self.num_envs)
        check_begun(self._begun, mask)
        seeds = lane_seeds(seed, mask)
        self.descents.take(mask, left)
        self.descents.seed(mask, seeds)
        self._restart(mask)
        self._begun |= mask
        self._due[mask] = False
        return self.descents.observe(), self._hidden()

    def _restart(self, mask: NDArray[np.bool_]) -> None:
        self.descents.restart(mask)
        self._limit.begin(mask)

    def _hidden(self) -> dict[str, Any]:
        told = self.descents.hidden()
        every = np.ones(self.num_envs, np.bool_)
        return told | {f"_{name}": every for name in told}

    def step(
        self, actions: ArrayLike
    ) -> tuple[Shown, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Fly all lanes on to the next action, or to their ends."""
        d, mode = self.descents, gymnasium.vector.AutoresetMode
        idle = d.lanes.ended != FLYING
        if (idle & ~self._due).any():
            raise gymnasium.error.ResetNeeded(
                "a lane's flight is not in the air: call reset(), with its reset_mask"
            )
        terms, moved, terminated, truncated = d.step(actions)
        over = terminated | truncated
        info: dict[str, Any] = {"reward_terms": terms, "_reward_terms": moved}
        info |= {"cost": np.where(terminated & ~d.lanes.safe, 1.0, 0.0), "_cost": moved}
        if over.any():
            info |= {"safe": d.lanes.safe & over, "_safe": over}
            info |= {"failed": np.where(over, d.lanes.failed, 0), "_failed": over}
            for name, told in d.told().items():
                info |= {name: np.where(over, told, 0.0), f"_{name}": over}
        truncated = truncated | self._limit.reached(moved)
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
        return d.observe(), summed(terms), terminated, truncated, info


class GuidanceEnv(DescentEnv):
    """Fly a lander to its target by thrust accelerations.

    The agent takes the place of the guidance law: the attitude loop and the throttle follow what
    it asks for, on perfect sensors.

    ## Action Space

    ``Box(-1, 1, (3,))``, five times a second: the wanted thrust acceleration, ENU. East and north
    from -A to A, up from 0 to A, A = thrust_max / dry_mass (5.45 m/s^2). What the engine, or the
    largest tilt of the scenario's approach, does not allow is cut as for a guidance law.
    ``env.unwrapped.descents.actions.action(acceleration)`` turns m/s^2 into an action.

    ## Observation Space

    ``Box`` of float32, named parts one after another (``observation=[...]`` chooses others):

    - ``position`` (3,): of the centre of mass from the target, ENU, m.
    - ``velocity`` (3,): ENU, m/s.
    - ``attitude`` (4,): quaternion from body axes to ENU, scalar last.
    - ``rate`` (3,): of the body, body axes, rad/s.
    - ``thrust`` (1,): of the engine now, over the mass, m/s^2.
    - ``propellant`` (1,): left, kg.

    Also ``time_left`` (1,), s. `lunarsim_envs.descent.observations.register` adds more.

    ## Rewards

    The sum of named terms, in ``info["reward_terms"]``: ``touchdown`` (+1 within all limits, -1
    for a crash or a flight off the map), ``propellant`` (-0.001 a kilogram), ``miss`` (-0.01 a
    metre between a safe touchdown and the target, up to 50 m), ``severity`` and
    ``excess`` (nothing, unless they are given weights: of a crash by its distance and speed, and by
    how far it exceeds the limits of a touchdown), ``shaping`` (of a potential that falls with how
    far the velocity is off one that leads to the target, braking evenly; its discounted
    sum is the same for all flights from one start, where the learner's discount is that of the
    weights). Every crash returns less than any safe landing, shaping aside; weights with which it
    may not are refused.

    ``info["cost"]``, for constrained methods, is 1 at a crash and 0 else.

    ## Starting State

    About 600 m away and 500 m up, at 28 m/s towards the target and 18 m/s down, upright, with
    full tanks (the table [start] of the scenario; by default with 30 m and 3 m/s of dispersion).

    ``reset(options=...)``, for a curriculum, takes ``position_m``, ``velocity_m_s``,
    ``position_sigma_m`` and ``velocity_sigma_m_s`` of that table, ``target_m`` and
    ``target_scatter_m`` of [target] (where the scenario's targets may lie), and ``cover``, one of
    ``covers`` or the scenario's own. They hold until the next reset, also through automatic ones.

    The table [variation] of a scenario (``changes={"variation.load_kg": 50.0}``) lets every flight
    draw its lander anew: load, specific impulse, thrust, lag, the engine's line; failures of thrust
    and of torque from some time on; noise and delay of what is shown, delay of what is commanded.
    ``info["drawn"]`` tells what was drawn.

    ## Episode End

    Terminated at the touchdown, whose verdict is the simulation's (``info["safe"]``,
    ``info["failed"]``), or below the map; ``info`` then has ``time_s``, ``propellant_kg`` burnt
    and ``miss_m``, the distance over the ground from the target. Truncated by the scenario's time
    limit (120 s). In a batch ``info["failed"]`` has a bit for each of
    `lunarsim_envs.descent.lanes.LIMITS`.

    ## Arguments

    - ``scenario``: a `lunarsim.scenario.Scenario`, the path of a TOML file or the name of a shipped
      one; by default nearly level ground without rocks.
    - ``changes``: other values of some of its keys, ``{"rocks.cover": 0.05}``.
    - ``rate_hz``: actions a second.
    - ``observation``: names of its parts.
    - ``weights``: `lunarsim_envs.descent.rewards.DescentWeights`; by default those of the table
      [descent_reward] of the scenario.
    - ``render_mode``: ``"rgb_array"``, the plane of the descent with gauges beside it;
      ``"human"``, the same in a window; or None. A batch draws nothing.
    - ``worlds``, ``world_seed``: how many worlds are drawn, once, and their root seed; each flight
      meets one of them. Ground is a raster of 0.1 m about the targets.
    - ``covers``: further covers of rocks, of each of which as many worlds are drawn, for
      ``reset(options={"cover": ...})``.
    - ``privileged``: ``info["privileged"]`` (28,) for asymmetric critics: the true state as the
      default observation has it, then all of ``info["drawn"]``.
    - ``num_envs``, ``autoreset_mode``, ``max_episode_steps`` with ``gymnasium.make_vec(...,
      vectorization_mode="vector_entry_point")``: number of flights in one kernel; "NextStep",
      "SameStep" or "Disabled"; number of steps after which an episode is truncated. Lane i with
      seed s flies what one environment with seed s + i does.

    ## Version History

    - v0: first version.
    """

    guided, rate = True, 5.0


class GuidanceVectorEnv(DescentVectorEnv):
    """Many of `GuidanceEnv` at once."""

    guided, rate = True, 5.0


class ControlEnv(DescentEnv):
    """Fly a lander to its target by throttle and torques.

    The agent takes the place of guidance and control.

    ## Action Space

    ``Box(-1, 1, (4,))``, fifty times a second: the engine's thrust, from its least (-1) to its
    greatest (1), and torques about the body axes as shares of the greatest. The engine runs all
    the way.

    ## Observation Space

    As `lunarsim/Guidance-v0`.

    ## Rewards

    As `lunarsim/Guidance-v0`.

    ## Starting State

    As `lunarsim/Guidance-v0`.

    ## Episode End

    As `lunarsim/Guidance-v0`.

    ## Arguments

    As `lunarsim/Guidance-v0`.

    ## Version History

    - v0: first version.
    """

    guided, rate = False, 50.0


class ControlVectorEnv(DescentVectorEnv):
    """Many of `ControlEnv` at once."""

    guided, rate = False, 50.0
