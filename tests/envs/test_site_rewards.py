"""Rewards of choosing sites: their terms, shaping, and crashes that return less than landings."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim_envs.descent.env import GuidanceEnv
from lunarsim_envs.descent.rewards import DescentWeights
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.rewards import RewardWeights, SiteRewards, map_information, sum_terms
from tests.envs.site_scene import SMALL, made_up
from tests.reference.site_reward import PlainReward
from tests.worlds import TINY_FLIGHT

EVERY = RewardWeights(
    safe=4.0, unsafe=-3.0, propellant=0.7, invalid=0.06, speed=0.5, tilt=0.3, hazard=0.4,
    information=0.9, shaping=0.8,
)  # fmt: skip
SETTINGS = {
    "scenario": SMALL, "worlds": 2, "world_seed": 5, "surrogate": made_up(),
    "observation": ["to_go"], "weights": EVERY,
}  # fmt: skip


def touch_of(env):
    """Return vertical and horizontal speed, tilt, slope and roughness of an ended flight."""
    if env.simulation is None:
        return env.flight.lanes.touchdown_values[0, [0, 1, 2, 4, 5]]
    t = env.simulation.outcome.touchdown
    return t.vertical_speed, t.horizontal_speed, t.tilt, t.slope, t.roughness


def stood(env):
    """Return mass, p_safe of the site and the map, as the environment's flight has them."""
    s = env.flight.inputs
    return env.flight.mass, float(s.here[0, 0]), s.p[0], s.seen[0]


@pytest.mark.parametrize("perception", ["onboard", "surrogate", "truth"])
def test_terms_are_those_of_the_plain_ones(perception):
    tiny = Scenario.from_dict(TINY_FLIGHT).changed(decisions={"interval_s": 3.0})
    given = SETTINGS | {"scenario": tiny} if perception == "onboard" else SETTINGS
    env = RetargetEnv(**given, perception=perception)
    ends, sums = set(), dict.fromkeys(SiteRewards.names, 0.0)
    for seed in range(1 if perception == "onboard" else 6):
        _, info = env.reset(seed=seed)
        plain = PlainReward(EVERY, env.scenario.vehicle.make(), *stood(env))
        ended, shaped, score = False, 0.0, 0.0
        first = -plain.hope
        while not ended:
            good = np.flatnonzero(info["action_mask"])
            bad = np.flatnonzero(info["action_mask"] == 0)
            action = int(bad[0] if seed % 3 == 0 and len(bad) else good[min(seed, len(good) - 1)])
            _, reward, ended, _, info = env.step(action)
            there = touch_of(env) if ended else None
            wanted = plain.step(action in bad, ended, info.get("safe"), there, *stood(env))
            assert info["reward_terms"] == pytest.approx(wanted, abs=1e-9)
            assert reward == pytest.approx(sum(wanted.values()), abs=1e-9)
            shaped += wanted["shaping"]
            score += reward - wanted["shaping"]
            sums = {name: sums[name] + abs(one) for name, one in wanted.items()}
        assert shaped == pytest.approx(first, abs=1e-9)  # whatever was chosen
        assert info["score"] == pytest.approx(score, abs=1e-9)
        ends.add(info["safe"])
    assert any(ends) and min(sums.values()) > 1e-3, sums


def test_a_lane_is_rewarded_as_one_environment_is():
    batch = RetargetVectorEnv(3, "NextStep", **SETTINGS)
    one = RetargetEnv(**SETTINGS, perception="surrogate")
    batch.reset(seed=20)
    _, told = one.reset(seed=21)
    flights, over, info = 0, False, {"action_mask": np.zeros((3, 21))}
    while flights < 2:
        good = np.flatnonzero(told["action_mask"])
        action = int(good[len(good) // 2])
        _, rewards, _, _, info = batch.step(np.full(3, action))
        if over:  # the lane spent this step on its reset
            _, told = one.reset()
            over, flights = False, flights + 1
            assert all(term[1] == 0.0 for term in info["reward_terms"].values())
            continue
        _, reward, over, _, told = one.step(action)
        assert rewards[1] == pytest.approx(reward, rel=1e-12, abs=1e-12)
        for name, term in told["reward_terms"].items():
            assert info["reward_terms"][name][1] == term


def _random_flight(rng, weights, safe, extreme):
    """Return what a flight of made-up states returns, shaping aside."""
    one, steps = np.ones(1, bool), (12 if safe else 1) if extreme else int(rng.integers(1, 16))
    rewards = SiteRewards(RewardWeights(), 400.0, 1)
    rewards.weights = weights  # also such as are refused
    every = np.ones((1, 4, 4), bool)
    burnt = (400.0 if safe else 0.0) if extreme else rng.uniform(0.0, 400.0)

    def map_of(sure):
        p = np.where(rng.random((1, 4, 4)) < 0.5, 0.0, 1.0) if sure else np.full((1, 4, 4), 0.5)
        return (p if extreme else rng.random(p.shape)).astype(np.float32), every

    rewards.begin(one, np.array([1500.0]), rng.random(1), *map_of(safe))
    total = 0.0
    for k in range(steps):
        over = one & (k == steps - 1)
        mass = np.array([1500.0 - burnt * (k + 1) / steps])
        wrong = one & (safe if extreme else bool(rng.random() < 0.5))
        touch = np.ones((1, 3)) if extreme else rng.uniform(0.0, 1.0, (1, 3))
        told = rewards.terms(
            one, wrong, over, one & safe, touch if safe else np.full((1, 3), np.nan), one, mass,
            rng.random(1), *map_of(not safe),
        )  # fmt: skip
        total += sum(float(term[0]) for name, term in told.items() if name != "shaping")
    return total


@pytest.mark.parametrize("seed", range(40))
def test_every_crash_returns_less_than_any_safe_landing(seed):
    """For all weights that are allowed; of those that are not some crash returns more."""
    rng = np.random.default_rng(seed)
    weights = RewardWeights(
        safe=rng.normal(2.0, 2.0), unsafe=rng.normal(-2.0, 2.0), propellant=rng.exponential(0.7),
        invalid=rng.exponential(0.05), speed=rng.exponential(0.4), tilt=rng.exponential(0.4),
        hazard=rng.exponential(0.4), information=rng.exponential(0.3),
        shaping=rng.exponential(1.0),
    )  # fmt: skip
    worst = min(
        [_random_flight(rng, weights, True, True)]
        + [_random_flight(rng, weights, True, False) for _ in range(20)]
    )
    best = max(
        [_random_flight(rng, weights, False, True)]
        + [_random_flight(rng, weights, False, False) for _ in range(20)]
    )
    try:
        weights.check()
    except InputError as error:
        assert error.field == "weights.safe"
        assert worst < best + 1e-9
    else:
        assert best < worst


def test_choices_that_are_not_available_cost_ten_times_at_most():
    env = RetargetEnv(**SETTINGS, perception="surrogate")
    env.reset(seed=1)
    one, none = np.ones(1, bool), np.zeros(1, bool)
    stand = env.reward_inputs()
    env.rewards.begin(one, *stand)
    touch = np.full((1, 3), np.nan)
    told = [
        env.rewards.terms(one, one, none, none, touch, one, *stand)["invalid"][0]
        for _ in range(13)
    ]  # fmt: skip
    assert told == [-EVERY.invalid] * 10 + [0.0] * 3
    env.rewards.begin(one, *stand)  # anew with every flight
    again = env.rewards.terms(one, one, none, none, touch, one, *stand)
    assert again["invalid"][0] == -EVERY.invalid


def test_choices_are_counted_for_each_flight_of_its_own():
    """One that begins lets those beside it go on with what they have spent."""
    rewards = SiteRewards(EVERY, 400.0, 2)
    both, none = np.ones(2, bool), np.zeros(2, bool)
    maps = np.zeros((2, 4, 4), np.float32), np.zeros((2, 4, 4), bool)
    stand, touch = (np.full(2, 1500.0), np.full(2, 0.5), *maps), np.full((2, 3), np.nan)
    rewards.begin(both, *stand)
    for _ in range(10):
        rewards.terms(both, both, none, none, touch, both, *stand)
    rewards.begin(np.array([False, True]), *stand)
    told = rewards.terms(both, both, none, none, touch, both, *stand)["invalid"]
    assert told.tolist() == [0.0, -EVERY.invalid]


def test_what_a_map_reports():
    seen = np.array([[True, True], [True, False]])
    p = np.array([[0.0, 1.0], [0.5, 1.0]], np.float32)
    assert map_information(p, seen) == 0.5
    assert map_information(p, ~seen) == 0.25


@pytest.mark.parametrize(
    "weights",
    [{"propellant": -0.1}, {"speed": np.nan}, {"safe": -1.0}, {"unsafe": 0.9}],
)
def test_weights_that_will_not_do_are_refused(weights):
    with pytest.raises(InputError, match="weights"):
        RetargetEnv(SMALL, replace(RewardWeights(), **weights), perception="truth", worlds=1)


def test_weights_stand_in_the_scenario():
    own = SMALL.changed(
        site_reward={"propellant": 0.5, "speed": 0.25, "information": 0.1, "shaping": 0.3},
        descent_reward={"miss": 0.02, "shaping": 0.0},
    )
    again = Scenario.from_dict(own.to_dict())
    assert again == own and again.site_reward.speed == 0.25
    made = gymnasium.make(
        "lunarsim_envs:lunarsim/Retarget-v1",
        scenario=own,
        changes={"site_reward.tilt": 0.4},
        perception="onboard",
    )
    wanted = RewardWeights(propellant=0.5, speed=0.25, tilt=0.4, information=0.1, shaping=0.3)
    assert made.unwrapped.weights == wanted
    given = RewardWeights(speed=0.125)
    batch = RetargetVectorEnv(
        2, "NextStep", own, given, worlds=2, world_seed=5, surrogate=made_up()
    )
    assert batch.weights == given
    flown = GuidanceEnv(scenario=own.changed(rocks={"cover": 0.0}))
    assert flown.descents.rewards.weights == DescentWeights(miss=0.02, shaping=0.0)
    with pytest.raises(InputError, match=r"site_reward\.hazard"):
        SMALL.changed(site_reward={"hazard": -1.0})
    with pytest.raises(InputError, match=r"weights\.safe"):
        GuidanceEnv(scenario=SMALL.changed(descent_reward={"crash": 5.0}))


def test_a_reward_is_the_same_sum_of_its_terms_in_any_company():
    """Added one after another: NumPy adds eight terms of one lane in another order than of two."""
    rng = np.random.default_rng(0)
    told = {name: rng.normal(0.0, 1.0, 64) for name in SiteRewards.names}
    wanted = np.zeros(64)
    for term in told.values():
        wanted = wanted + term
    assert np.array_equal(sum_terms(told), wanted)
    for i in range(64):
        assert sum_terms({name: term[i : i + 1] for name, term in told.items()})[0] == wanted[i]
        assert sum_terms({name: float(term[i]) for name, term in told.items()}) == wanted[i]
    single, pair = (RetargetVectorEnv(n, "SameStep", **SETTINGS) for n in (1, 2))
    alone = RetargetEnv(**SETTINGS, perception="surrogate")
    for env in (single, pair, alone):
        env.reset(seed=4)
    for _ in range(40):
        one, two, own = single.step(np.zeros(1, int)), pair.step(np.zeros(2, int)), alone.step(0)
        assert one[1][0] == two[1][0] == own[1]
        if own[2]:
            alone.reset()
