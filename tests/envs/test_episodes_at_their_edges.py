"""Episodes that end before anything is decided, copies of environments, lanes that never began."""

from __future__ import annotations

import copy
import pickle

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.descent.env import GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.descent.observations import PARTS as DESCENT_PARTS
from lunarsim_envs.descent.observations import ObservationComponent as DescentPart
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.sites.observations import PARTS, SiteObservationComponent
from tests.envs.site_scene import SMALL
from tests.low_descents import LOW

SITE = {"scenario": SMALL, "perception": "truth", "worlds": 2, "world_seed": 5}
# Below the last decision: such a flight is down before anything is to be decided.
NEAR = {
    "position_m": (0.0, 0.0, 30.0), "velocity_m_s": (0.0, 0.0, -1.0), "position_sigma_m": 0.5,
}  # fmt: skip
PARTLY = {"reset_mask": np.array([True, False])}


def test_a_flight_that_is_down_before_its_first_decision_ends_with_the_first_step():
    env = gymnasium.make("lunarsim_envs:lunarsim/Retarget-v1", observation=list(PARTS), **SITE)
    first, _ = env.reset(seed=4, options=NEAR)
    assert env.observation_space.contains(first)
    env.reset(seed=3)
    env.step(0)
    seen, info = env.reset(seed=4, options=NEAR)
    # Nothing of the flight before is shown.
    assert all(np.array_equal(seen[name], first[name]) for name in seen)
    assert not seen["sites"].any() and info["action_mask"].sum() == 1
    down = info["time"]
    _, reward, terminated, truncated, info = env.step(0)
    assert terminated and not truncated and info["time"] == down
    assert info["cost"] == float(not info["safe"])
    assert info["reward_terms"]["touchdown"] == (1.0 if info["safe"] else -1.0) == reward
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)


def test_time_may_run_out_before_the_first_decision():
    """The whole computer: it starts above the height of the first decision."""
    env = RetargetEnv(
        SMALL,
        perception="onboard",
        changes={"simulation.max_time_s": 1.0, "decisions.first_altitude_m": 150.0},
    )
    env.reset(seed=1)
    *_, terminated, truncated, info = env.step(0)
    assert terminated and not truncated
    assert info["failure_causes"] == ("time-limit",) and info["cost"] == 1.0
    assert info["reward_terms"]["touchdown"] == -1.0


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_lanes_end_so_too_and_the_others_fly_on(mode):
    many = RetargetVectorEnv(2, mode, **SITE)
    many.reset(seed=3)
    many.reset(seed=3, options=NEAR | PARTLY)
    alone = RetargetEnv(**SITE)
    alone.reset(seed=3, options=NEAR)
    _, reward, over, _, info = many.step(np.zeros(2, int))
    _, own, ended, _, told = alone.step(0)
    assert over.tolist() == [True, False] and ended
    assert reward[0] == own and info["safe"][0] == told["safe"]
    for _ in range(3):
        if mode == "Disabled":
            with pytest.raises(gymnasium.error.ResetNeeded):
                many.step(np.zeros(2, int))
            many.reset(options=NEAR | PARTLY)
        _, reward, over, _, info = many.step(np.zeros(2, int))
    # Every second step begins a flight where the step after an end does.
    assert over.tolist() == [mode != "NextStep", False]


def test_the_last_info_of_a_lane_is_that_of_one_environment():
    many, alone = RetargetVectorEnv(1, "SameStep", **SITE), RetargetEnv(**SITE)
    many.reset(seed=3)
    alone.reset(seed=3)
    ended = False
    while not ended:
        *_, info = many.step(np.zeros(1, int))
        *_, ended, _, told = alone.step(0)
    assert info["final_info"]["time"][0] == told["time"] > info["time"][0]
    assert np.array_equal(info["final_info"]["action_mask"][0], told["action_mask"])
    assert info["final_info"]["propellant_kg"][0] == told["propellant_kg"] > 1.0


def test_a_lane_that_is_reset_by_hand_after_its_end_flies_on():
    """In next-step mode the end of the flight before is not still due."""
    many, alone = RetargetVectorEnv(1, **SITE), RetargetEnv(**SITE)
    many.reset(seed=3)
    while not many.step(np.zeros(1, int))[2][0]:
        pass
    seen, _ = many.reset(seed=3)
    own, _ = alone.reset(seed=3)
    for _ in range(2):
        # The same seed again is the same flight.
        assert all(np.array_equal(seen[name][0], own[name]) for name in own)
        seen, own = many.step(np.ones(1, int))[0], alone.step(1)[0]


def test_a_site_that_is_not_to_be_had_is_not_flown_to():
    wrong, stays = (RetargetVectorEnv(1, observation=list(PARTS), **SITE) for _ in range(2))
    for many in (wrong, stays):
        _, info = many.reset(seed=3)
    (none,) = np.flatnonzero(~info["action_mask"][0])[:1]
    seen, own = wrong.step(np.array([none]))[0], stays.step(np.zeros(1, int))[0]
    assert all(np.array_equal(seen[name], own[name]) for name in own)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_of_any_environment_goes_on_alike(copied):
    every = list(PARTS)
    for env, action in (
        (gymnasium.make("lunarsim_envs:lunarsim/Retarget-v1", observation=every, **SITE), 1),
        (RetargetVectorEnv(2, observation=every, **SITE), np.array([1, 0])),
        (GuidanceVectorEnv(2, changes=LOW), np.zeros((2, 3), np.float32)),
    ):
        env.reset(seed=5)
        env.step(action)
        other = copied(env)
        for _ in range(2):
            (seen, reward, *_), (own, earned, *_) = (one.step(action) for one in (env, other))
            assert np.array_equal(reward, earned)
            names = seen if isinstance(seen, dict) else [slice(None)]
            assert all(np.array_equal(seen[name], own[name]) for name in names)


def test_a_part_of_ones_own_is_copied_and_must_keep_to_its_shape(monkeypatch):
    """By name: a lambda cannot be pickled."""
    monkeypatch.setitem(
        PARTS,
        "two",
        SiteObservationComponent("two", (2,), ("",), 0.0, 9.0, "own", lambda s: s.here),
    )
    high = DescentPart("high", 1, "m", -9.0, 9.0, "own", lambda lanes: lanes.y[:, 2:3])
    flat = DescentPart("flat", 1, "m", -9.0, 9.0, "own", lambda lanes: lanes.y[:, 2])
    monkeypatch.setitem(DESCENT_PARTS, "high", high)
    monkeypatch.setitem(DESCENT_PARTS, "flat", flat)
    env = GuidanceEnv(changes=LOW, observation=["high"])
    env.reset(seed=1)
    other = pickle.loads(pickle.dumps(env))
    action = np.zeros(3, np.float32)
    assert np.array_equal(env.step(action)[0], other.step(action)[0])
    with pytest.raises(InputError, match=r"'two': must have shape \(1, 2\)"):
        RetargetEnv(observation=["two"], **SITE).reset(seed=1)
    with pytest.raises(InputError, match=r"'flat': must have shape \(1, 1\)"):
        GuidanceEnv(changes=LOW, observation=["flat"]).reset(seed=1)


@pytest.mark.parametrize("kind", [RetargetVectorEnv, GuidanceVectorEnv])
def test_the_first_reset_is_of_all_lanes(kind):
    env = kind(2, **(SITE if kind is RetargetVectorEnv else {"changes": LOW}))
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
        env.reset(seed=1, options=PARTLY)
    if kind is RetargetVectorEnv:
        with pytest.raises(gymnasium.error.ResetNeeded, match="action_masks"):
            env.action_masks()
    env.reset(seed=1)
    env.reset(seed=1, options=PARTLY)


def test_a_reset_that_is_refused_changes_nothing():
    env, other = (GuidanceVectorEnv(2, changes=LOW) for _ in range(2))
    for one in (env, other):
        one.reset(seed=1)
    with pytest.raises(ValueError, match="options"):
        env.reset(seed=9, options={"start": 1})
    assert np.array_equal(env.reset()[0], other.reset()[0])
    one, another = (GuidanceEnv(changes=LOW) for _ in range(2))
    for env in (one, another):
        env.reset(seed=1)
    with pytest.raises(ValueError, match="options"):
        one.reset(seed=9, options={"start": 1})
    assert np.array_equal(one.reset()[0], another.reset()[0])


def test_a_rate_may_be_any_kind_of_number():
    for rate in (10, 10.0, np.int64(10), np.float32(10.0)):
        assert GuidanceEnv(changes=LOW, rate_hz=rate).descents.period == pytest.approx(0.1)
