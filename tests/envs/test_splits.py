"""Splits of worlds: no world of one split is a world of another."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.rng import SPLITS
from lunarsim.scenario import Scenario
from lunarsim_envs.descent.env import GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.evaluation.request import evaluation_study
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from tests.envs.site_scene import SMALL, made_up
from tests.low_descents import LOW
from tests.worlds import TINY_FLIGHT

ROCKY = LOW | {"rocks.cover": 0.1, "target.scatter_m": [1.0, 1.0]}
SITES = {"scenario": SMALL, "worlds": 2, "surrogate": made_up(), "observation": ["to_go"]}


def rasters(env):
    """Return the terrain rasters of the pool of an environment, as bytes."""
    core = env.descents.lanes if hasattr(env, "descents") else env.lanes
    return {terrain.tobytes() for terrain in core.worlds.terrains}


def test_no_world_of_descents_is_in_two_splits():
    pools = {
        (split, seed): rasters(
            GuidanceEnv(changes=ROCKY, worlds=3, world_seed=seed, split=split)
        )
        for split in SPLITS for seed in (0, 1)
    }  # fmt: skip
    assert all(len(pool) == 3 for pool in pools.values())
    for one, other in combinations(pools.values(), 2):
        assert not one & other
    # The default is the split for training, and a batch has the same worlds.
    assert rasters(GuidanceEnv(changes=ROCKY, worlds=3)) == pools["train", 0]
    batch = GuidanceVectorEnv(2, changes=ROCKY, worlds=3, split="test")
    assert rasters(batch) == pools["test", 0]


def test_no_world_of_site_choices_is_in_two_splits():
    pools = [rasters(RetargetVectorEnv(2, split=split, **SITES)) for split in SPLITS]
    assert all(len(pool) == 2 for pool in pools)
    for one, other in combinations(pools, 2):
        assert not one & other
    assert rasters(RetargetVectorEnv(2, **SITES)) == pools[0]
    alone = RetargetEnv(perception="surrogate", split="test", **SITES)
    assert {one.tobytes() for one in alone.flight.lanes.worlds.terrains} == pools[2]


def test_full_simulations_of_one_seed_fly_other_worlds_in_each_split():
    rocks = []
    for split in SPLITS:
        tiny = Scenario.from_dict(TINY_FLIGHT)
        env = RetargetEnv(tiny, perception="onboard", split=split)
        env.reset(seed=4)
        grid = Grid(-20.0, -20.0, 0.5, 81, 81)
        rocks.append(env.simulation.world.terrain.raster(grid).tobytes())
        env.close()
    assert len(set(rocks)) == 3


def test_evaluations_fly_the_test_split_unless_they_are_asked_to():
    study = evaluation_study("lunarsim_envs:Retarget-v1", None, [], 1)
    assert study.arguments["split"] == "test" and study.arguments["worlds"] == 16
    given = {"split": "train", "worlds": 3, "world_seed": 7}
    asked = evaluation_study("lunarsim_envs:Guidance-v1", None, [], 1, **given)
    assert asked.arguments == given
    plain = evaluation_study("lunarsim_envs:Guidance-v1", None, [], 1)
    sets = [f"{key}={value}" for key, value in ROCKY.items()]
    flown = evaluation_study("lunarsim_envs:Guidance-v1", None, sets, 1).make()
    assert plain.arguments["split"] == "test"
    trained_on = GuidanceEnv(changes=ROCKY)
    assert not rasters(flown.unwrapped) & rasters(trained_on)


@pytest.mark.parametrize("split", ["tests", 1, None, np.array(["test"])])
def test_an_unknown_split_is_refused(split):
    for env, more in ((GuidanceEnv, {"changes": LOW}), (RetargetVectorEnv, SITES)):
        with pytest.raises(InputError, match="split: must be one of train, validation, test"):
            env(split=split, **more)
