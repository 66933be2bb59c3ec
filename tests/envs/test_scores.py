"""Scores of descents: what a return is beside them, how they rank flights, when flights end."""

from __future__ import annotations

from functools import cache

import gymnasium
import numpy as np
import pytest

from lunarsim_envs.agents.registry import agent_of
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.descent.rewards import DescentWeights
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.rewards import RewardWeights
from tests.envs.site_scene import SMALL, made_up
from tests.low_descents import LOW

MODES = ["NextStep", "SameStep", "Disabled"]
SITE = {"scenario": SMALL, "perception": "surrogate", "worlds": 1, "world_seed": 5,
        "surrogate": made_up()}  # fmt: skip
# Changes of the scenario, and action rates, Hz.
FLOWN = {
    "default": ({}, (2.0, 5.0, 10.0)),
    "rocks": ({"rocks.cover": 0.08}, (5.0,)),
    "randomized": (
        {
            "domain_randomization.payload_kg": 40.0, "domain_randomization.thrust_scale": 0.03,
            "domain_randomization.position_noise_m": 0.2,
            "domain_randomization.sensing_delay_s": 0.4,
        },
        (10.0,),
    ),
    "low": (
        {
            "start.position_m": [-40.0, 15.0, 50.0], "start.velocity_m_s": [4.0, -1.0, -4.0],
            "start.position_sigma_m": 2.0, "start.velocity_sigma_m_s": 0.5,
            "simulation.max_time_s": 40.0,
        },
        (2.0, 5.0, 10.0),
    ),
    # Lander of a third of the mass, three legs, another start and rougher terrain.
    "small": (
        {
            "vehicle.dry_mass_kg": 340.0, "vehicle.propellant_mass_kg": 160.0,
            "vehicle.thrust_min_n": 200.0, "vehicle.thrust_max_n": 2200.0,
            "vehicle.legs": 3, "vehicle.leg_radius_m": 1.3, "terrain.rms_slope_deg": 3.0,
            "start.position_m": [0.0, -250.0, 300.0], "start.velocity_m_s": [0.0, 12.0, -8.0],
        },
        (4.0, 20.0),
    ),
}  # fmt: skip


CONSTANT = {
    "nothing": [0, 0, 0], "away": [0, 0, 1], "falls": [0, 0, -1], "left": [0, 1, -0.3],
    "right": [0, -1, -0.3], "back": [-1, 0, -0.3], "on": [1, 0, -0.3],
}  # fmt: skip


class Law:
    """An agent that is a function of the observation, with the interface of the others."""

    def __init__(self, law, begin=lambda rng: None):
        self.law, self.begin = law, begin

    def act(self, seen, info):
        return self.law(seen)


def constant(action):
    """Return a function that gives one action for any observation."""
    given = np.float32(action)
    return lambda seen: given


def guidance_agents(env):
    """Return agents that land, crash near and far, fly away and wait, by name."""
    descents = env.unwrapped.descents
    start = np.linalg.norm(descents.scenario.start.position_m)
    agents = {name: agent_of(name, env) for name in ("apollo", "polynomial", "hover", "random")}
    if descents.period == 0.2:  # the slowest
        agents["optimal"] = agent_of("optimal", env)
    apollo = agent_of("apollo", env)

    def stalls(seen):
        """Follow apollo to 0.1 of the start distance, and then with the engine at its minimum."""
        action = apollo.act(seen, {})
        low = descents.physical(seen)[2] < 0.1 * start
        return np.float32([action[0], action[1], -1.0]) if low else action

    def waits(seen):
        return descents.actions.action([0.0, 0.0, 1.622] - 0.3 * descents.physical(seen)[3:6])

    agents |= {"stalls": Law(stalls, apollo.begin), "waits": Law(waits)}
    for name, action in CONSTANT.items():
        agents[name] = Law(constant(action))
    return agents


def control_agents(env):
    """Return agents of thrust and torques by name."""
    agents = {name: agent_of(name, env) for name in ("zero", "hover", "random")}
    for name, thrust in (("away", 1.0), ("falls", -1.0)):
        agents[name] = Law(constant([thrust, 0.0, 0.0, 0.0]))
    return agents


def flown(env, agent, seed):
    """Return outcome, relative distance from the target and score of a flight.

    Checks that the return is the score minus the potential of the start.
    """
    descents = env.unwrapped.descents
    agent.begin(np.random.default_rng(seed))
    seen, info = env.reset(seed=seed)
    first = float(descents.rewards.potential()[0])
    total, score, over = 0.0, 0.0, False
    while not over:
        seen, reward, over, truncated, info = env.step(agent.act(seen, info))
        assert not truncated and ("score" in info) == over
        total += reward
        score += reward - info["reward_terms"]["shaping"]
    assert total + first == pytest.approx(info["score"], abs=1e-9)
    assert score == pytest.approx(info["score"], abs=1e-9)
    assert info["cost"] == float(not info["safe"])
    lanes = descents.lanes
    start = np.linalg.norm(env.unwrapped.descents.scenario.start.position_m)
    away = np.linalg.norm(lanes.y[0, :3] - lanes.target[0]) / start
    lost = {"time-limit", "flown-away"} & set(info["failure_causes"])
    outcome = "safe" if info["safe"] else "no landing" if lost else "crash"
    return outcome, away, info["score"], total, info["failure_causes"]


@cache
def flights():
    """Return the flights of all agents in all scenarios at all rates."""
    found = {}
    for name, (changes, rates) in FLOWN.items():
        for rate in rates:
            env = GuidanceEnv(changes=changes, rate_hz=rate)
            for agent, made in guidance_agents(env).items():
                found["Guidance-v1", name, rate, agent] = flown(env, made, 3)
    for name, rate in (("low", 50.0), ("low", 10.0), ("randomized", 10.0)):
        env = ControlEnv(changes=FLOWN[name][0], rate_hz=rate)
        for agent, made in control_agents(env).items():
            found["Control-v1", name, rate, agent] = flown(env, made, 3)
    return found


def scores(outcome, least=0.0, most=np.inf):
    """Return the scores of flights with an outcome, from `least` to `most` times as far away."""
    return np.array([
        score for kind, away, score, *_ in flights().values()
        if kind == outcome and least <= away <= most
    ])  # fmt: skip


def test_scores_rank_landings_over_crashes_over_flights_without_touchdown():
    safe, crash, lost = (scores(outcome) for outcome in ("safe", "crash", "no landing"))
    assert min(len(safe), len(crash), len(lost)) > 10
    assert safe.min() > crash.max() and crash.min() > lost.max()
    causes = {cause for *_, told in flights().values() for cause in told}
    assert {"time-limit", "flown-away", "off-map"} < causes


def test_a_crash_near_the_target_has_a_higher_score_than_one_far_away():
    near, far = scores("crash", most=0.1), scores("crash", least=0.5)
    assert min(len(near), len(far)) > 6
    assert near.mean() > far.mean() + 1.0


def test_returns_from_one_start_differ_as_the_scores_do():
    starts = {}
    for (level, scenario, _, _), (_, _, score, total, _) in flights().items():
        starts.setdefault((level, scenario), []).append((score, total))
    assert len(starts) == len(FLOWN) + 2
    for pairs in starts.values():
        score, total = np.array(pairs).T
        assert np.ptp(score) > 5.0 and np.ptp(score - total) < 1e-9


# --- ends without touchdown ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "planned"),
    [({}, 781.025), ({"position_m": [-1500.0, 0.0, 1200.0]}, 1920.937),
     ({"position_m": [-100.0, 0.0, 100.0]}, 781.025)],
)  # fmt: skip
def test_a_flight_ends_farther_than_one_and_a_half_starts_away(options, planned):
    """Of the planned start, or of the start that a reset asks for, if that is farther."""
    env = GuidanceEnv(scaled=False, changes={"simulation.max_time_s": 600.0})
    seen, _ = env.reset(seed=1, options=options | {"position_sigma_m": 0.0})
    distances, over = [np.linalg.norm(seen[:3])], False
    while not over:
        seen, _, over, truncated, info = env.step(np.float32([-1.0, 0.0, 1.0]))
        distances.append(np.linalg.norm(seen[:3]))
    assert not truncated and not info["safe"] and info["failure_causes"] == ("flown-away",)
    assert info["cost"] == 1.0 and info["reward_terms"]["touchdown"] == -15.0
    assert max(distances[:-1]) <= 1.5 * planned < distances[-1] < 1.5 * planned + 40.0
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(3, np.float32))
    # The next start is the planned one again.
    env.reset(seed=1)
    assert not env.step(np.zeros(3, np.float32))[2]


def test_the_distance_is_that_from_the_target_of_the_flight():
    changes = {"target.scatter_m": [8.0, 8.0], "start.position_m": [0.0, 0.0, 10.0],
               "start.velocity_m_s": [0.0, 0.0, 0.0], "start.position_sigma_m": 0.0,
               "start.velocity_sigma_m_s": 0.0}  # fmt: skip
    vector = GuidanceVectorEnv(30, "Disabled", changes=changes, rate_hz=50.0, scaled=False)
    vector.reset(seed=1)
    lanes = vector.descents.lanes
    assert np.abs(lanes.target[:, :2]).max() > 6.0
    ended = np.zeros(30, bool)
    while not ended.all():
        seen, *_, info = vector.step(np.tile(np.float32([0.0, 0.0, 1.0]), (30, 1)))
        ended = info.get("_safe", ended)
    assert np.linalg.norm(seen[:, :3], axis=1) == pytest.approx(np.full(30, 15.0), abs=0.2)


@pytest.mark.parametrize("mode", MODES)
def test_time_runs_out_in_a_batch_as_in_one_environment(mode):
    vector = GuidanceVectorEnv(2, mode, changes=LOW | {"simulation.max_time_s": 0.6})
    vector.reset(seed=1, options={"velocity_m_s": [0.0, 0.0, 0.0]})
    for step in range(3):
        _, rewards, terminated, truncated, info = vector.step(np.zeros((2, 3), np.float32))
        assert not truncated.any() and (terminated == (step == 2)).all()
        assert (info["cost"] == float(step == 2)).all()
    assert (info["reward_terms"]["touchdown"] == -15.0).all() and (rewards < -10.0).all()
    assert not info["safe"].any() and info["_safe"].all()


def test_a_step_limit_is_no_end():
    """It truncates, and leaves no outcome and no score."""
    env = gymnasium.make("lunarsim/Guidance-v1", max_episode_steps=3, changes=LOW)
    vector = GuidanceVectorEnv(2, max_episode_steps=3, changes=LOW)
    for one, action in ((env, np.zeros(3, np.float32)), (vector, np.zeros((2, 3), np.float32))):
        one.reset(seed=1)
        for _ in range(3):
            _, _, terminated, truncated, info = one.step(action)
        assert np.all(truncated) and not np.any(terminated)
        assert "score" not in info and "safe" not in info and not np.any(info["cost"])
        assert not np.any(info["reward_terms"]["touchdown"])


# --- scores in batches ---------------------------------------------------------------------------


def act_down(rng, count):
    """Return actions that end flights of `LOW` soon, some of them safe."""
    return rng.uniform([-0.2, -0.2, -0.4], [0.2, 0.2, 0.4], (count, 3)).astype(np.float32)


def batch_of(kind, mode):
    """Return a vector environment, and actions drawn at random."""
    if kind == "Guidance-v1":
        return GuidanceVectorEnv(6, mode, changes=LOW), lambda rng: act_down(rng, 6)
    weights = RewardWeights(safe=3.0, speed=0.2, information=0.3, shaping=0.5)
    settings = {name: value for name, value in SITE.items() if name != "perception"}
    vector = RetargetVectorEnv(6, mode, weights=weights, **settings)
    return vector, lambda rng: rng.integers(0, 4, 6)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", ["Guidance-v1", "Retarget-v1"])
def test_scores_of_a_batch_are_the_sums_of_its_terms(kind, mode):
    vector, act = batch_of(kind, mode)
    vector.reset(seed=4)
    rng, sums, ends = np.random.default_rng(5), np.zeros(6), 0
    for _ in range(180 if kind == "Guidance-v1" else 60):
        _, rewards, terminated, truncated, info = vector.step(act(rng))
        sums += rewards - info["reward_terms"]["shaping"]
        assert ("score" in info) == terminated.any() and not truncated.any()
        if terminated.any():
            ends += terminated.sum()
            assert np.array_equal(info["_score"], terminated)
            assert info["score"] == pytest.approx(np.where(terminated, sums, 0.0), abs=1e-9)
            if mode == "SameStep":
                assert np.array_equal(info["final_info"]["score"], info["score"])
            sums[terminated] = 0.0
            if mode == "Disabled":
                vector.reset(options={"reset_mask": terminated})
    assert ends > 12


# --- presets -------------------------------------------------------------------------------------


def outcomes(env, actions, seeds):
    """Return the rewards of flights, with whether each landed safely."""
    found = []
    for seed in seeds:
        seen, _ = env.reset(seed=seed)
        rewards, over = [], False
        while not over:
            seen, reward, over, _, info = env.step(actions(seen))
            rewards.append(reward)
        found.append((rewards, info["safe"], info["score"]))
    return found


def test_the_sparse_reward_is_one_for_a_safe_landing_and_else_nothing():
    env = GuidanceEnv(weights="sparse", changes={"simulation.max_time_s": 100.0})
    law = agent_of("polynomial", env)
    found = outcomes(env, lambda seen: law.act(seen, {}), range(2))
    for action in ([0, 0, 0], [0, 0, 1], [0, 0, -1]):
        found += outcomes(env, constant(action), range(1))
    for changes in ({}, {"simulation.max_time_s": 12.0}):
        site = RetargetEnv(weights="sparse", changes=changes, **SITE)
        found += outcomes(site, lambda seen: 0, range(2))
    for rewards, safe, score in found:
        assert rewards == [0.0] * (len(rewards) - 1) + [float(safe)] and score == float(safe)
    assert [safe for _, safe, _ in found] == [True, True, *[False] * 3, True, True, False, False]


SPARSE_DESCENT = DescentWeights(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SPARSE_SITE = RewardWeights(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("many", [False, True])
def test_presets_stand_above_the_tables_of_the_scenario(many):
    own = SMALL.changed(
        site_reward={"propellant": 0.5}, descent_reward={"miss": 0.02}, rocks={"cover": 0.0}
    )
    site = {"scenario": own, "worlds": 1, "world_seed": 5, "surrogate": made_up()}
    for preset, descent, chosen in (
        ("dense", DescentWeights(), RewardWeights()),
        ("sparse", SPARSE_DESCENT, SPARSE_SITE),
        (None, DescentWeights(miss=0.02), RewardWeights(propellant=0.5)),
    ):
        env = GuidanceVectorEnv(2, scenario=own, weights=preset) if many else GuidanceEnv(
            scenario=own, weights=preset
        )  # fmt: skip
        assert env.descents.rewards.weights == descent
        env = RetargetVectorEnv(2, weights=preset, **site) if many else RetargetEnv(
            weights=preset, perception="surrogate", **site
        )  # fmt: skip
        assert env.weights == chosen


def test_unknown_presets_are_refused():
    for kind, more in ((GuidanceEnv, {"changes": LOW}), (RetargetEnv, {"scenario": SMALL})):
        with pytest.raises(ValueError, match=r"must be 'dense', 'sparse', a .*Weights or None"):
            kind(weights="spars", **more)


# --- time limit of Retarget-v1 -------------------------------------------------------------------


@pytest.mark.parametrize("perception", ["onboard", "truth", "surrogate"])
def test_a_choice_of_sites_that_runs_out_of_time_is_unsafe(perception):
    weights = RewardWeights(unsafe=-2.5, shaping=0.5)
    settings = SITE | {"perception": perception, "weights": weights}
    settings |= {"changes": {"simulation.max_time_s": 12.0}}
    env = RetargetEnv(**settings)
    env.reset(seed=3)
    total, score, over = 0.0, 0.0, False
    first = env.rewards.weights.shaping * np.nan_to_num(env.reward_inputs()[1][0])
    while not over:
        _, reward, over, truncated, info = env.step(0)
        total, score = total + reward, score + reward - info["reward_terms"]["shaping"]
    assert not truncated and info["failure_causes"] == ("time-limit",) and not info["safe"]
    assert info["reward_terms"]["touchdown"] == -2.5 and info["cost"] == 1.0
    assert info["score"] == pytest.approx(score, abs=1e-9)
    assert total + first == pytest.approx(score, abs=1e-9)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)


@pytest.mark.parametrize("mode", MODES)
def test_choices_of_sites_in_a_batch_run_out_of_time_too(mode):
    settings = {name: value for name, value in SITE.items() if name != "perception"}
    vector = RetargetVectorEnv(3, mode, changes={"simulation.max_time_s": 12.0}, **settings)
    vector.reset(seed=3)
    terminated = np.zeros(3, bool)
    while not terminated.any():
        _, _, terminated, truncated, info = vector.step(np.zeros(3, int))
        assert not truncated.any()
        assert np.array_equal(info["cost"], terminated.astype(float))
    assert (info["reward_terms"]["touchdown"][terminated] == -1.0).all()
    assert not info["safe"].any() and (info["score"][terminated] <= -1.0).all()
