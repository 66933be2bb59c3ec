"""Combine landers, observations, actions and rewards of descent environments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.typing import Array, BoolArray
from lunarsim.vehicle.domain_randomization import RANDOM_QUANTITIES
from lunarsim_envs.arguments import (
    check_no_dispersions,
    checked_bool,
    checked_covers,
    checked_int,
    checked_split,
    checked_weights,
    scenario_argument,
)
from lunarsim_envs.descent.actions import Actions
from lunarsim_envs.descent.batch import FLYING, DescentBatch, VehicleParams
from lunarsim_envs.descent.noise_and_delay import SensingModel
from lunarsim_envs.descent.observations import DEFAULT, ObservationLayout, ObservationScaling
from lunarsim_envs.descent.options import apply_options, check_start_height
from lunarsim_envs.descent.rewards import DescentWeights, Rewards
from lunarsim_envs.descent.worlds import WorldPool


def flat_scenario() -> Scenario:
    """Return the default scenario: nearly flat terrain without rocks, start at 500 m."""
    return Scenario.from_dict(
        {
            "name": "level",
            "terrain": {"kind": "fractal", "rms_slope_deg": 1.0},
            "rocks": {"cover": 0.0},
            "start": {"position_sigma_m": 30.0, "velocity_sigma_m_s": 3.0},
            "simulation": {"max_time_s": 120.0},
        }
    )


def _checked_rate(rate_hz: Any) -> float:
    """Check that the argument `rate_hz` is a positive number, and return the value."""
    numbers = int, float, np.integer, np.floating
    if isinstance(rate_hz, bool) or not isinstance(rate_hz, numbers) or not rate_hz > 0:
        raise InputError("rate_hz", rate_hz, "must be a positive number")
    return float(rate_hz)


class DescentEnvArguments(TypedDict, total=False):
    """Arguments that single and vector descent environments share.

    Scenario with changes, action rate, observation components and whether they are scaled, reward
    weights, pool of worlds and privileged information. The docstring of `env.GuidanceEnv` describes
    each one.
    """

    scenario: Scenario | str | Path | None
    changes: Mapping[str, Any] | None
    rate_hz: float
    observation: Sequence[str]
    scaled: bool
    weights: DescentWeights | str | None
    worlds: int
    world_seed: int
    split: str
    covers: Sequence[float]
    privileged: bool
    dispersions: None


class DescentEnvCore:
    """Simulate n landers with observations, actions and rewards of an environment.

    Single and vector environments of ``Guidance-v1`` and ``Control-v1`` wrap this class.

    Parameters
    ----------
    count
        Number of landers n; None for a single environment with actions (size,).
    guided
        Whether actions are thrust accelerations (true), or thrust and torques (false).
    scenario, changes, rate_hz, observation, scaled, weights, worlds, world_seed, split, covers,
    privileged, dispersions
        Arguments of the environment, described in `env.GuidanceEnv`.
    """

    def __init__(
        self,
        count: int | None,
        *,
        guided: bool,
        scenario: Scenario | str | Path | None = None,
        changes: Mapping[str, Any] | None = None,
        rate_hz: float,
        observation: Sequence[str] = DEFAULT,
        scaled: bool = True,
        weights: DescentWeights | str | None = None,
        worlds: int = 1,
        world_seed: int = 0,
        split: str = "train",
        covers: Sequence[float] = (),
        privileged: bool = False,
        dispersions: None = None,
    ) -> None:
        check_no_dispersions(dispersions)
        self.many = count is not None
        count = checked_int("num_envs", 1 if count is None else count, 1)
        worlds, world_seed = (
            checked_int("worlds", worlds, 1),
            checked_int("world_seed", world_seed, 0),
        )
        privileged, weights = (
            checked_bool("privileged", privileged),
            checked_weights(weights, DescentWeights),
        )
        scaled = checked_bool("scaled", scaled)
        rate_hz = _checked_rate(rate_hz)
        self.scenario = scenario_argument(scenario, changes, flat_scenario())
        craft = VehicleParams.of(self.scenario)
        self.shown = ObservationLayout(observation)
        self.scaling = ObservationScaling(self.shown) if scaled else None
        self.actions = Actions(craft.dynamics.lander, craft.dynamics.gravity, guided=guided)
        pool = WorldPool.of(
            self.scenario, worlds, world_seed, checked_covers(covers), checked_split(split)
        )
        self.lanes = DescentBatch(count, craft, pool, guided=guided, rate=rate_hz)
        check_start_height(craft.start, self.lanes)
        self.rewards = Rewards(weights or DescentWeights.of(self.scenario), self.lanes)
        self.truth = ObservationLayout(DEFAULT) if privileged else None
        self.sensing_model = (
            self._create_sensing_model() if craft.domain_randomization is not None else None
        )

    def _create_sensing_model(self) -> SensingModel:
        """Create the model of noise and delays.

        Delayed actions before the first one command a thrust equal to the weight.
        """
        d = self.lanes.craft.dynamics
        weight = d.lander.wet_mass * d.gravity
        initial_command = [0.0, 0.0, d.gravity] if self.lanes.guided else [weight, 0.0, 0.0, 0.0]
        return SensingModel(self.lanes, self.shown, self.period, np.array(initial_command))

    @property
    def period(self) -> float:
        """Time between two actions, s."""
        return self.lanes.steps * self.lanes.craft.dynamics.step

    def seed(self, mask: BoolArray, seeds: Sequence[int | None]) -> None:
        """Set the random keys of landers `mask` (n,) from one seed per selected lander.

        A seed of None keeps the key; a lander without a key then gets a random one.
        """
        for lane, seed in zip(np.flatnonzero(mask), seeds, strict=True):
            if seed is not None or not self.lanes.has_key[lane]:
                self.sample_key(int(lane), seeding.np_random(seed)[0])

    def sample_key(self, lane: int, rng: np.random.Generator) -> None:
        """Sample the random key of a lander (index `lane`), which fixes its later flights."""
        one = np.zeros(self.lanes.count, np.bool_)
        one[lane] = True
        self.lanes.seed(one, rng.integers(2**64, size=1, dtype=np.uint64))

    def apply_options(self, mask: BoolArray, options: Mapping[str, Any] | None) -> None:
        """Apply options of `reset` to the landers of `mask` (n,), until the next call."""
        apply_options(options, self.lanes, mask)

    def restart(self, mask: BoolArray) -> None:
        """Start new episodes for the landers of `mask` (n,), with their current options."""
        self.lanes.begin(mask)
        self.rewards.begin(mask)
        if self.sensing_model is not None:
            self.sensing_model.begin(mask)

    @property
    def observation_space(self) -> spaces.Box:
        """Observation space of one lander."""
        return self.shown.space if self.scaling is None else self.scaling.space

    def observe(self) -> NDArray[np.float32]:
        """Return the observations of all landers (n, size), with noise and delay if set."""
        physical = (
            self.shown.of(self.lanes)
            if self.sensing_model is None
            else self.sensing_model.delayed_observations
        )
        return physical if self.scaling is None else self.scaling.scaled(physical)

    def physical(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return observations of `observe` as components (..., size) in SI units."""
        given = np.asarray(observation, np.float32)
        return given if self.scaling is None else self.scaling.physical(given)

    def extra_info(self) -> dict[str, Any]:
        """Return values for `info` that are not part of the observation, by name.

        ``randomized``: randomized parameters of each flight by name (n,), if the scenario has them.
        ``privileged``: true state with the components of `observations.DEFAULT`, followed by all
        randomized parameters (n, 29), if requested.
        """
        extra_info: dict[str, Any] = {}
        randomized = self.lanes.randomized
        if self.sensing_model is not None:
            extra_info["randomized"] = {
                name: randomized[:, i].copy() for i, name in enumerate(RANDOM_QUANTITIES)
            }
        if self.truth is not None:
            finite = np.minimum(randomized, self.lanes.craft.time_limit).astype(np.float32)
            extra_info["privileged"] = np.hstack((self.truth.of(self.lanes), finite))
        return extra_info

    def outcome(self) -> dict[str, Array]:
        """Return the values of `info` at the end of an episode, by name, each (n,).

        Flight time (s), propellant used (kg), miss distance (m) and score.
        """
        lanes = self.lanes
        return {
            "time_s": lanes.time, "propellant_kg": lanes.propellant_used, "miss_m": lanes.miss,
            "score": self.rewards.score,
        }  # fmt: skip

    def step(self, action: Any) -> tuple[dict[str, Array], BoolArray, BoolArray]:
        """Fly all flying landers with actions from -1 to 1 until the next action is due.

        Returns the reward terms (n,) by name and two masks (n,): landers that were flying before
        the step, and flights that it ended.
        """
        physical = self.actions.physical(action, self.lanes.count if self.many else None)
        moved = self.lanes.ended == FLYING
        if self.sensing_model is not None:
            physical = self.sensing_model.act(moved, physical)
        self.lanes.move(physical)
        if self.sensing_model is not None:
            self.sensing_model.observe(moved)
        return self.rewards.terms(moved), moved, moved & (self.lanes.ended != FLYING)
