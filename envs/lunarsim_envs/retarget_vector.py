"""Vector environment of ``lunarsim/Retarget-v1``, flown by compiled kernels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from numpy.typing import ArrayLike

from lunarsim.scenario import Scenario
from lunarsim.typing import Array, BoolArray
from lunarsim_envs.arguments import (
    check_no_dispersions,
    checked_int,
    checked_options,
    checked_split,
    checked_weights,
)
from lunarsim_envs.descent.batch import FLYING
from lunarsim_envs.descent.lane_renderer import LaneRenderer
from lunarsim_envs.descent.options import apply_options
from lunarsim_envs.descent.plane_view import Image
from lunarsim_envs.resets import check_all_reset, lane_seeds, reset_mask
from lunarsim_envs.retarget import retarget_scenario
from lunarsim_envs.rewards import RewardWeights, SiteRewards, sum_terms, touchdown_limit_ratios
from lunarsim_envs.sites.actions import DEFAULT_ACTION, SiteActions
from lunarsim_envs.sites.flights import site_inputs
from lunarsim_envs.sites.map_view import MapView
from lunarsim_envs.sites.observations import DEFAULT, Shown, SiteObservationLayout
from lunarsim_envs.sites.perception import create_batch
from lunarsim_envs.sites.site_inputs import MAP_CELLS, SiteInputs, downsample_maps
from lunarsim_envs.step_limit import StepLimit

_MODE = gymnasium.vector.AutoresetMode


class RetargetVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Choose the landing sites of many landers at once, flown by compiled kernels.

    It is the vector version of `RetargetEnv`, with the same arguments. Environment i with seed s
    gives bitwise the same episodes as a single environment with seed s + i, for any number of
    environments and threads.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: str | gymnasium.vector.AutoresetMode = "NextStep",
        scenario: Scenario | str | Path | None = None,
        weights: RewardWeights | str | None = None,
        *,
        perception: str = "surrogate",
        observation: Sequence[str] = DEFAULT,
        action: Sequence[str] = DEFAULT_ACTION,
        changes: Mapping[str, Any] | None = None,
        worlds: int = 4,
        world_seed: int = 0,
        split: str = "train",
        covers: Sequence[float] = (),
        surrogate: Any = None,
        dispersions: None = None,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        rendered: Sequence[int] = (0,),
    ) -> None:
        check_no_dispersions(dispersions)
        num_envs, worlds = checked_int("num_envs", num_envs, 1), checked_int("worlds", worlds, 1)
        world_seed = checked_int("world_seed", world_seed, 0)
        self.scenario = retarget_scenario(scenario, changes)
        self.actions = SiteActions(action)
        split = checked_split(split)
        self.lanes = create_batch(
            num_envs, perception, self.scenario, worlds, world_seed, surrogate, covers, split
        )
        self.weights = checked_weights(weights, RewardWeights) or RewardWeights.of(self.scenario)
        self._lander = self.scenario.vehicle.make()
        self.rewards = SiteRewards(self.weights, self._lander.propellant_mass, num_envs)
        self.shown = SiteObservationLayout(observation)
        self.num_envs = num_envs
        self.autoreset_mode = _MODE(autoreset_mode)
        self._renderer = LaneRenderer(render_mode, rendered, self.lanes, MapView)
        self.metadata = {
            "render_modes": ["rgb_array"], "autoreset_mode": self.autoreset_mode,
            "render_fps": 1,
        }  # fmt: skip
        self.single_action_space = self.actions.space
        self.single_observation_space = self.shown.space
        batch = gymnasium.vector.utils.batch_space
        self.action_space = batch(self.single_action_space, num_envs)
        self.observation_space = batch(self.single_observation_space, num_envs)
        self.render_mode = render_mode
        self._small = np.zeros((num_envs, 2, MAP_CELLS, MAP_CELLS), np.float32)
        self._rngs: list[np.random.Generator | None] = [None] * num_envs
        self._due = np.zeros(num_envs, np.bool_)
        self._limit = StepLimit(max_episode_steps, num_envs)
        # Lanes with an episode whose end has not been reported; flights may end before a decision.
        self._open = np.zeros(num_envs, np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Shown, dict[str, Any]]:
        """Start episodes in all environments, or those of ``options["reset_mask"]`` (n,)."""
        left = checked_options(options)
        mask = reset_mask(left.pop("reset_mask", None), self.num_envs)
        check_all_reset(np.array([rng is not None for rng in self._rngs]), mask)
        seeds = lane_seeds(seed, mask)
        apply_options(left, self.lanes, mask)
        for lane, one in zip(np.flatnonzero(mask), seeds, strict=True):
            if one is not None or self._rngs[lane] is None:
                self._rngs[lane] = seeding.np_random(one)[0]
        self._begin(mask)
        self._due[mask] = False
        return self._observe(), self._info()

    def _begin(self, mask: BoolArray) -> None:
        keys = np.zeros(self.num_envs, np.uint64)
        for lane in np.flatnonzero(mask):
            rng = self._rngs[int(lane)]
            assert rng is not None
            keys[lane] = rng.integers(2**64, size=1, dtype=np.uint64)[0]
        self.lanes.seed(mask, keys[mask])
        self.lanes.begin(mask)
        self._open |= mask
        self._limit.begin(mask)
        self._shrink(mask)
        self.rewards.begin(mask, *self.reward_inputs())
        self._renderer.begin(mask)

    def render(self) -> tuple[Image, ...] | None:
        """Return an RGB image (440, 1080, 3) of each environment of `rendered`.

        Without a render mode, it returns None. With the autoreset mode "SameStep", the image after
        the last step of an episode shows the next one.
        """
        if self._renderer.has_views and any(rng is None for rng in self._rngs):
            raise gymnasium.error.ResetNeeded("Call reset() before render().")
        return self._renderer.draw()

    def reward_inputs(self) -> tuple[Any, ...]:
        """Return the arguments of `SiteRewards.begin` after the mask.

        They are the masses (n,), kg, p_safe of the current sites (n,), and the maps of p_safe and
        of observed cells (n, rows, cols).
        """
        lanes = self.lanes
        return lanes.y[:, 13], lanes.candidates.here[:, 0], lanes.maps.p, lanes.maps.seen

    def _shrink(self, mask: BoolArray) -> None:
        """Downsample the hazard maps of the environments of `mask` (n,) for observations.

        Nothing is done if the observation does not have the component ``hazard_map``.
        """
        if mask.any() and any(part.name == "hazard_map" for part in self.shown.parts):
            maps = self.lanes.maps
            self._small[mask] = downsample_maps(maps.p[mask], maps.seen[mask])

    @property
    def inputs(self) -> SiteInputs:
        """Values of all landers from which observations and action masks are computed."""
        return site_inputs(self.lanes, self._small)

    def _observe(self) -> Shown:
        return self.shown.of(self.inputs)

    def action_masks(self) -> BoolArray:
        """Return the mask of available actions of each environment (n, 21).

        With several action components, their masks are concatenated.
        """
        if any(rng is None for rng in self._rngs):
            raise gymnasium.error.ResetNeeded("Call reset() before action_masks().")
        return self.actions.masks(self.inputs)

    def _info(self) -> dict[str, Any]:
        every = np.ones(self.num_envs, np.bool_)
        values = {
            "time": self.lanes.time.copy(),
            "action_mask": self.action_masks().astype(np.int8),
        }
        return values | {f"_{name}": every for name in values}

    def step(self, actions: ArrayLike) -> tuple[Shown, Array, BoolArray, BoolArray, dict[str, Any]]:
        """Apply site decisions in all environments; fly to the next decisions or the end."""
        lanes = self.lanes
        chosen = self.actions.checked_batch_choices(actions, self.num_envs)
        moved = self._open.copy()
        if (~moved & ~self._due).any():
            raise gymnasium.error.ResetNeeded(
                "An episode has ended. Call reset() with options['reset_mask']."
            )
        decisions = self.actions.decisions(chosen, self.inputs)
        lanes.decide(decisions.site, moved, decisions.time_scale)
        self._shrink(lanes.mapped)
        self._renderer.add_positions(moved)
        terminated = moved & (lanes.ended != FLYING)
        terms = self._terms(moved, terminated, decisions.invalid)
        rewards = sum_terms(terms)
        info = self._step_info(terms, moved, terminated)
        truncated = self._limit.reached(moved)
        over = terminated | truncated
        self._open &= ~over
        if self.actions.has_time_scale:
            info["time_scale_refused"] = moved & (
                decisions.factor_ignored | lanes.time_scale_refused
            )
            info["_time_scale_refused"] = moved
        if self.autoreset_mode is _MODE.NEXT_STEP:
            if self._due.any():
                self._begin(self._due)
            self._due = over
        elif self.autoreset_mode is _MODE.SAME_STEP and over.any():
            info |= {"final_obs": self._observe(), "_final_obs": over} | self._info()
            left = ("_reward_terms", "_cost", "_time_scale_refused", "final_obs", "_final_obs")
            info["final_info"] = {name: info[name] for name in info if name not in left}
            info["_final_info"] = over
            self._begin(over)
        return self._observe(), rewards, terminated, truncated, info | self._info()

    def _terms(self, moved: BoolArray, over: BoolArray, invalid: BoolArray) -> dict[str, Any]:
        lanes = self.lanes
        touchdown_ratios = touchdown_limit_ratios(self._lander, lanes.touchdown_values)
        return self.rewards.terms(
            moved, invalid, over, lanes.safe, touchdown_ratios, lanes.mapped, *self.reward_inputs()
        )

    def _step_info(
        self, terms: dict[str, Any], moved: BoolArray, over: BoolArray
    ) -> dict[str, Any]:
        info: dict[str, Any] = {"reward_terms": terms, "_reward_terms": moved}
        info |= {"cost": np.where(over & ~self.lanes.safe, 1.0, 0.0), "_cost": moved}
        if over.any():
            info |= {"safe": self.lanes.safe & over, "_safe": over}
            info |= {
                "failure_causes": np.where(over, self.lanes.failed, 0),
                "_failure_causes": over,
            }
            info |= {
                "propellant_kg": np.where(over, self.lanes.propellant_used, 0.0),
                "_propellant_kg": over,
            }
            info |= {"score": np.where(over, self.rewards.score, 0.0), "_score": over}
        return info
