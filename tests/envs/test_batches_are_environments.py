"""A batch is as many environments: through any steps, ends, resets by hand, options and copies."""

from __future__ import annotations

import copy
import pickle
from itertools import product

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.descent.env import GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.rewards import RewardWeights
from lunarsim_envs.step_limit import StepLimit
from tests.envs.site_scene import SMALL, made_up

LANES = 4
MODES = ["NextStep", "SameStep", "Disabled"]
# What a reset tells of a lane.
BEGUN = ("time", "action_mask", "randomized", "privileged")
SHORT = SMALL.changed(simulation={"max_time_s": 25.0})
SITE = {
    "scenario": SHORT, "perception": "surrogate", "worlds": 1, "world_seed": 5, "covers": [0.02],
    "surrogate": made_up(SHORT), "action": ("site", "time_scale"),
    "weights": RewardWeights(safe=3.0, speed=0.1, tilt=0.2, hazard=0.1, information=0.1,
                             shaping=0.3),
}  # fmt: skip
SITE_OPTIONS = [
    {}, {"position_m": [-150.0, 20.0, 150.0], "position_sigma_m": 1.0}, {"cover": 0.02},
    {"target_m": [4.0, -3.0], "target_scatter_m": [2.0, 1.0], "velocity_sigma_m_s": 2.0},
    {"position_m": [-20.0, 0.0, 40.0], "velocity_m_s": [0.0, 0.0, -6.0]},
]  # fmt: skip
DESCENT = {
    "covers": [0.1], "worlds": 2, "privileged": True,
    "changes": {
        "start.position_m": [0.0, 0.0, 25.0], "start.velocity_m_s": [0.0, 0.0, -1.0],
        "start.position_sigma_m": 1.0, "simulation.max_time_s": 5.0,
        "domain_randomization.payload_kg": 20.0,
        "target.scatter_m": [8.0, 8.0], "terrain.size_m": 90.0,
    },
}  # fmt: skip
DESCENT_OPTIONS = [
    {}, {"position_m": [0.0, 0.0, 60.0]}, {"cover": 0.1, "velocity_m_s": [0.0, 0.0, -6.0]},
    {"target_m": [4.0, -3.0], "target_scatter_m": [2.0, 1.0]},
]  # fmt: skip


def check(info, i, own, names=None, masks=True):
    """Compare what a batch tells of a lane with what its environment tells."""
    for name in own if names is None else own.keys() & set(names):
        if name == "failure_causes":  # a bit each in a batch
            continue
        if isinstance(own[name], dict):
            assert {term: value[i] for term, value in info[name].items()} == own[name], name
        else:
            assert np.array_equal(info[name][i], own[name]), name
        assert not masks or info[f"_{name}"][i], name


def same(shown, i, own):
    if isinstance(own, dict):
        assert all(np.array_equal(shown[name][i], own[name]) for name in own)
    else:
        assert np.array_equal(shown[i], own)


class Pair:
    """A batch and its lanes' environments, which go through the same."""

    def __init__(self, many, ones, mode, rng):
        self.many, self.ones, self.mode, self.rng = many, ones, mode, rng
        self.told, self.over, self.ends = [{}] * LANES, [False] * LANES, [0, 0]
        self.reset({}, np.ones(LANES, bool), 3)

    def reset(self, options, mask, seed):
        shown, info = self.many.reset(seed=seed, options=options | {"reset_mask": mask})
        for i in np.flatnonzero(mask):
            one = seed[i] if isinstance(seed, list) else None if seed is None else seed + int(i)
            own, tells = self.ones[i].reset(seed=one, options=options)
            same(shown, i, own)
            check(info, i, tells, BEGUN)
            self.told[i], self.over[i] = options, False

    def some_reset(self, options):
        rng, over = self.rng, np.array(self.over)
        must = over if self.mode == "Disabled" else np.zeros(LANES, bool)
        mask = must | (rng.random(LANES) < 0.2)
        drawn = rng.integers(100, size=LANES).tolist()
        listed = [None if rng.random() < 0.4 else one for one in drawn]
        seed = [None, drawn[0], listed][rng.integers(3)]
        if mask.any():
            self.reset(options[rng.integers(len(options))], mask, seed)

    def some_copies(self):
        k, i = self.rng.integers(12), self.rng.integers(LANES)
        if k == 0:
            self.many = pickle.loads(pickle.dumps(self.many))
        elif k == 1:
            self.many, self.ones[i] = copy.deepcopy(self.many), copy.deepcopy(self.ones[i])

    def step(self, actions):
        shown, rewards, terminated, truncated, info = self.many.step(actions)
        for i in range(LANES):
            if self.over[i] and self.mode == "NextStep":
                self.waited(i, shown, info)
                assert rewards[i] == 0.0 and not (terminated | truncated)[i]
                continue
            own, reward, *ends, tells = self.ones[i].step(actions[i])
            assert (rewards[i], terminated[i], truncated[i]) == (reward, *ends)
            ended = any(ends)
            late = ends[1] or tells.get("failure_causes") == ("time-limit",)
            self.ends[0], self.ends[1] = self.ends[0] + ended, self.ends[1] + late
            if ended and self.mode == "SameStep":
                assert info["_final_obs"][i] and info["_final_info"][i]
                same(info["final_obs"], i, own)
                check(info["final_info"], i, tells, masks=False)
                check(info, i, tells, ("reward_terms", "cost", "time_scale_refused", "safe"))
                own, tells = self.ones[i].reset(options=self.told[i])
                check(info, i, tells, BEGUN)
            else:
                check(info, i, tells)
                assert not info.get("_final_obs", np.zeros(LANES, bool))[i]
                self.over[i] = ended
            same(shown, i, own)

    def waited(self, i, shown, info):
        """A step that a lane spends on its reset moves nothing, and tells nothing of actions."""
        own, tells = self.ones[i].reset(options=self.told[i])
        same(shown, i, own)
        check(info, i, tells, BEGUN)
        assert not any(term[i] for term in info["reward_terms"].values())
        assert info["cost"][i] == 0.0 and not info["_reward_terms"][i] and not info["_cost"][i]
        if "time_scale_refused" in info:
            assert not info["time_scale_refused"][i] and not info["_time_scale_refused"][i]
        self.over[i] = False


def flown(pair, options, act, steps):
    for _ in range(steps):
        if pair.rng.random() < 0.12 or (pair.mode == "Disabled" and any(pair.over)):
            pair.some_reset(options)
        pair.some_copies()
        pair.step(act(pair.rng))
    return pair.ends


@pytest.mark.parametrize("mode", MODES)
def test_lanes_that_choose_sites_are_as_many_environments(mode):
    def act(rng):
        sites = rng.integers(0, 21, LANES) * (rng.random(LANES) < 0.5)
        return np.column_stack((sites, rng.integers(0, 5, LANES)))

    many, ones = RetargetVectorEnv(LANES, mode, **SITE), [RetargetEnv(**SITE) for _ in range(LANES)]
    pair = Pair(many, ones, mode, np.random.default_rng(1))
    ended, late = flown(pair, SITE_OPTIONS, act, 120)
    assert ended - late > 3 and late > 3


@pytest.mark.parametrize("mode", MODES)
def test_lanes_that_fly_are_as_many_environments(mode):
    def act(rng):
        return rng.uniform([-0.1, -0.1, -0.9], [0.1, 0.1, 0.0], (LANES, 3)).astype(np.float32)

    many = GuidanceVectorEnv(LANES, mode, **DESCENT)
    ones = [GuidanceEnv(**DESCENT) for _ in range(LANES)]
    pair = Pair(many, ones, mode, np.random.default_rng(2))
    ended, late = flown(pair, DESCENT_OPTIONS, act, 200)
    assert ended - late > 3 and late > 3


LIMITED = {
    "Retarget-v1": (SITE, (2,), 4),
    "Guidance-v1": (DESCENT | {"covers": [], "worlds": 1}, (3,), 9),
    "Control-v1": (DESCENT | {"covers": [], "worlds": 1}, (4,), 9),
}


def test_all_batches_are_tried_with_a_step_limit():
    registered = {
        spec.name + f"-v{spec.version}"
        for spec in gymnasium.registry.values()
        if spec.namespace == "lunarsim" and spec.vector_entry_point is not None
    }
    assert registered == set(LIMITED)


@pytest.mark.parametrize(
    ("name", "mode"),
    [*product(("Retarget-v1", "Guidance-v1"), MODES), ("Control-v1", "SameStep")],
)
def test_lanes_with_a_step_limit_are_environments_within_gymnasiums_time_limit(name, mode):
    """In Guidance-v1, flights from low starts end before the limit, and others at the limit."""
    settings, shape, limit = LIMITED[name]

    def act(rng):
        if name == "Retarget-v1":
            return rng.integers(0, 3, (LANES, *shape))
        return rng.uniform(-0.1, 0.0, (LANES, *shape)).astype(np.float32)

    many = gymnasium.make_vec(
        f"lunarsim/{name}", num_envs=LANES, vectorization_mode="vector_entry_point",
        max_episode_steps=limit, autoreset_mode=mode, **settings,
    )  # fmt: skip
    ones = [gymnasium.make(f"lunarsim/{name}", max_episode_steps=limit, disable_env_checker=True,
                           **settings) for _ in range(LANES)]  # fmt: skip
    low = {"position_m": [0.0, 0.0, 20.0], "velocity_m_s": [0.0, 0.0, -30.0],
           "position_sigma_m": 0.0}  # fmt: skip
    ended, late = flown(Pair(many, ones, mode, np.random.default_rng(3)), [low, {}], act, 60)
    assert late > 5 and (name != "Guidance-v1" or ended - late > 5)


@pytest.mark.parametrize("wrong", [0, -2, 1.5, True, "7"])
def test_a_step_limit_that_is_none_is_refused(wrong):
    with pytest.raises(InputError, match="max_episode_steps"):
        StepLimit(wrong, 2)


@pytest.mark.parametrize("none", [None, -1])
def test_without_a_step_limit_no_lane_reaches_one(none):
    limit = StepLimit(none, 2)
    assert not any(limit.reached(np.ones(2, bool)).any() for _ in range(1000))
