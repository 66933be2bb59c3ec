"""`Guidance-v1` and `Control-v1`, one at a time and in batches."""

from __future__ import annotations

import copy
import pickle
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from lunarsim.errors import InputError
from lunarsim_envs.descent.baseline import PolynomialGuidance
from lunarsim_envs.descent.batch import LANDED
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.descent.observations import DEFAULT, PARTS, ObservationComponent, register
from lunarsim_envs.descent.rewards import MAX_MISS_M, DescentWeights, Rewards
from tests.low_descents import IDS, LOW, batch


def descent(observation, actions):
    """Return actions of a plain law that comes down at 1.8 m/s over the target."""
    p, v = observation[:, :3].astype(float), observation[:, 3:6].astype(float)
    high = np.maximum(p[:, 2] - 1.6, 0.0)
    near = np.clip(1.0 - high / 4.0, 0.0, 0.9)[:, None]
    side = np.clip((-0.15 * p[:, :2] - 0.8 * v[:, :2]) * (1.0 - near), -0.8, 0.8)
    up = 1.622 - 1.2 * (v[:, 2] + np.clip(0.25 * high, 1.6, 6.0))
    return actions.action(np.column_stack((side, up)))


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_has_nothing_to_say_of_it(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(f"lunarsim_envs:{name}", changes=LOW)
        check_env(env.unwrapped)


@pytest.mark.parametrize("name", IDS)
def test_random_episodes_stay_in_their_space_and_end(name):
    vector = batch(name, 128)
    vector.action_space.seed(1)
    observation, _ = vector.reset(seed=5)
    ended = 0
    for _ in range(100 if "Guidance" in name else 1100):
        observation, reward, terminated, truncated, info = vector.step(vector.action_space.sample())
        assert vector.observation_space.contains(observation)
        assert np.isfinite(reward).all()
        assert not (terminated & truncated).any()
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        ended += int((terminated | truncated).sum())
    assert ended > 100


@pytest.mark.parametrize("name", IDS)
def test_a_lane_is_one_environment_bit_for_bit(name):
    vector = batch(name, 4)
    lanes, _ = vector.reset(seed=30)
    one = gymnasium.make(f"lunarsim_envs:{name}", changes=LOW)
    alone, _ = one.reset(seed=32)
    assert np.array_equal(alone, lanes[2])
    actions = np.random.default_rng(1).uniform(-0.2, 0.4, (2000, *vector.action_space.shape))
    flights = 0
    for action in actions.astype(np.float32):
        lanes, rewards, terminated, truncated, _ = vector.step(action)
        alone, reward, over, late, _ = one.step(action[2])
        assert np.array_equal(alone, lanes[2])
        assert (reward, over, late) == (rewards[2], terminated[2], truncated[2])
        if over or late:
            flights += 1
            lanes, rewards, terminated, truncated, info = vector.step(action)  # begins anew
            alone, _ = one.reset()
            assert np.array_equal(alone, lanes[2])
            assert rewards[2] == 0.0 and not (terminated | truncated)[2]
            assert not info["_reward_terms"][2]
            if flights == 2:
                return
    raise AssertionError("no flight ended")


def flown(mode, steps=150):
    vector = batch(IDS[0], 6, autoreset_mode=mode, scaled=False)
    assert vector.metadata["autoreset_mode"] is AutoresetMode(mode)
    actions = vector.unwrapped.descents.actions
    observation, _ = vector.reset(seed=7)
    ends = [[] for _ in range(6)]
    for _ in range(steps):
        observation, reward, terminated, truncated, info = vector.step(
            descent(observation, actions)
        )
        over = terminated | truncated
        for i in np.flatnonzero(over):
            last = info["final_obs"][i] if mode == "SameStep" else observation[i]
            ends[i].append((last.copy(), reward[i], bool(info["safe"][i])))
            assert info["_safe"][i]
            if mode == "SameStep":
                assert info["final_info"]["reward_terms"]["touchdown"][i] in (10.0, 0.0, -15.0)
                assert observation[i, 2] > 15.0  # the next flight's first
        if mode == "Disabled" and over.any():
            with pytest.raises(gymnasium.error.ResetNeeded):
                vector.step(descent(observation, actions))
            before = observation.copy()
            observation, _ = vector.reset(options={"reset_mask": over})
            assert np.array_equal(observation[~over], before[~over])
            assert (observation[over, 2] > 15.0).all()
    return ends


def test_all_ways_to_reset_fly_the_same_flights():
    next_step, same_step, disabled = (flown(m) for m in ("NextStep", "SameStep", "Disabled"))
    for a, b, c in zip(next_step, same_step, disabled, strict=True):
        assert len(a) >= 2
        for (x, p, s), (y, q, t), (z, r, u) in zip(a, b, c, strict=False):
            assert np.array_equal(x, y) and np.array_equal(x, z)
            assert p == q == r and s == t == u
    assert any(safe for end in next_step for _, _, safe in end)


def test_a_plain_law_lands_safe_from_the_default_start():
    vector = gymnasium.make_vec(
        "lunarsim_envs:lunarsim/Guidance-v1", num_envs=64, vectorization_mode="vector_entry_point"
    )
    descents = vector.unwrapped.descents
    agent = PolynomialGuidance(descents)
    observation, _ = vector.reset(seed=1)
    safe, miss, waiting = np.zeros(64, bool), np.zeros(64), np.ones(64, bool)
    while waiting.any():
        observation, _, terminated, truncated, info = vector.step(agent(observation))
        over = (terminated | truncated) & waiting
        if over.any():
            safe[over] = info["safe"][over]
            miss[over] = np.hypot(*descents.physical(observation[over])[:, :2].T)
            waiting &= ~over
    assert safe.mean() > 0.95
    assert np.median(miss) < 0.5
    assert np.array_equal(agent(observation[3]), agent(observation)[3])
    # What does nothing, or anything, lands nowhere.
    for law in (lambda shape, rng: np.zeros(shape), lambda shape, rng: rng.uniform(-1, 1, shape)):
        rng = np.random.default_rng(0)
        vector.reset(seed=1)
        landed = 0
        for _ in range(300):
            *_, info = vector.step(law((64, 3), rng).astype(np.float32))
            landed += int(info["safe"].sum()) if "safe" in info else 0
        assert landed == 0


def test_an_agent_for_other_actions_or_observations_is_refused():
    with pytest.raises(InputError, match="Guidance-v1"):
        PolynomialGuidance(ControlEnv(changes=LOW).descents)
    with pytest.raises(InputError, match="begin with 'position' and 'velocity'"):
        PolynomialGuidance(GuidanceEnv(changes=LOW, observation=["rate", "position"]).descents)


def test_shaping_reports_the_same_of_every_flight_from_one_start():
    """Its sum is minus the potential of the start, whatever was done and however it ended."""
    vector = batch(IDS[0], 8, scaled=False)
    descents = vector.unwrapped.descents
    rng, causes = np.random.default_rng(2), set()
    laws = {
        "down": lambda seen: descent(seen, descents.actions),
        "random": lambda seen: rng.uniform(-0.3, 0.3, (8, 3)).astype(np.float32),
        "away": lambda seen: np.tile(np.float32([0.0, 0.0, 1.0]), (8, 1)),
        "wait": lambda seen: descents.actions.action([0.0, 0.0, 1.622] - 0.5 * seen[:, 3:6]),
    }
    for law in laws.values():
        observation, _ = vector.reset(seed=3)
        wanted = -descents.rewards.potential()
        total, waiting = np.zeros(8), np.ones(8, bool)
        while waiting.any():
            observation, _, terminated, truncated, info = vector.step(law(observation))
            assert not truncated.any()
            total += np.where(waiting, info["reward_terms"]["shaping"], 0.0)
            ended = np.flatnonzero(terminated & waiting)
            causes |= {descents.lanes.failure_causes(i) for i in ended}
            waiting &= ~terminated
        assert total == pytest.approx(wanted, rel=1e-9)
    assert {(), ("time-limit",), ("flown-away",)} <= causes


@pytest.mark.parametrize("seed", range(40))
def test_scores_rank_landings_over_crashes_over_the_rest(seed):
    """For all weights that are allowed; those that do not are refused."""
    rng = np.random.default_rng(seed)
    weights = DescentWeights(
        safe=rng.normal(2.0, 2.0), crash=rng.normal(0.0, 2.0), no_landing=rng.normal(-5.0, 5.0),
        propellant=rng.exponential(0.003), miss=rng.exponential(0.02),
        severity=rng.exponential(1.0), excess=rng.exponential(0.1),
        shaping=rng.exponential(1.0),
    )  # fmt: skip
    tanks = 400.0 * weights.propellant
    worst_landing = weights.safe - tanks - weights.miss * MAX_MISS_M
    # Speeds, tilt and rate have a limit each; the logarithm of each excess is at most 3.
    worst_crash = weights.crash - tanks - weights.severity - 4 * 3.0 * weights.excess
    if worst_landing <= max(weights.crash, weights.no_landing):
        with pytest.raises(InputError, match=r"weights\.safe: must be above"):
            weights.check(400.0)
    elif worst_crash < weights.no_landing:
        with pytest.raises(InputError, match=r"weights\.no_landing: must be at most"):
            weights.check(400.0)
    else:
        weights.check(400.0)


def test_terms_are_what_they_say():
    weights = DescentWeights(propellant=0.003, miss=0.02)
    env = GuidanceEnv(changes=LOW, weights=weights, scaled=False)
    observation, _ = env.reset(seed=4)
    lanes = env.descents.lanes
    total = dict.fromkeys(Rewards.names, 0.0)
    over = False
    while not over:
        action = descent(observation[None], env.descents.actions)[0]
        observation, reward, over, late, info = env.step(action)
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        total = {name: total[name] + term for name, term in info["reward_terms"].items()}
        assert not late
    assert info["safe"] and info["failure_causes"] == ()
    off = float(np.hypot(*(lanes.y[0, :2] - lanes.target[0, :2])))
    assert total["touchdown"] == 10.0
    assert total["miss"] == pytest.approx(-0.02 * off)
    assert total["propellant"] == pytest.approx(-0.003 * (1500.0 - lanes.y[0, 13]))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)


@pytest.mark.parametrize("weights", [
    {"propellant": -1.0}, {"miss": np.nan}, {"no_landing": np.nan}, {"severity": -1.0},
    {"shaping": -1.0}, {"crash": 5.0}, {"no_landing": -9.0}, {"no_landing": 5.0},
])  # fmt: skip
def test_weights_that_will_not_do_are_refused(weights):
    with pytest.raises(InputError, match="weights"):
        GuidanceEnv(changes=LOW, weights=replace(DescentWeights(), **weights))


ACTIONS = [
    (np.full(3, np.nan), r"action\[0\].*got nan"),
    (np.array([0.0, 0.0, 1.1]), r"action\[2\]: .*got 1\.1"),
    (np.zeros(4), "shape"), (np.zeros((1, 3)), "shape"), (np.array(["0", "0", "0"]), "type"),
    (np.array([True, False, True]), "type"), (np.zeros(3, complex), "type"), (0.0, "shape"),
    (None, "type"),
]  # fmt: skip


@pytest.mark.parametrize(("action", "says"), ACTIONS, ids=str)
def test_an_action_that_is_none_is_refused_and_changes_nothing(action, says):
    env = GuidanceEnv(changes=LOW)
    env.reset(seed=1)
    before = env.descents.lanes.y.copy()
    with pytest.raises(ValueError, match=says):
        env.step(action)
    assert np.array_equal(env.descents.lanes.y, before)


def test_a_batch_of_one_says_which_shape_it_wants():
    vector = GuidanceVectorEnv(1, changes=LOW)
    vector.reset(seed=1)
    with pytest.raises(ValueError, match=r"must be numbers between -1 and 1 of shape \(1, 3\)"):
        vector.step(np.zeros(3, np.float32))


def test_where_flights_start_can_be_reported():
    env = GuidanceEnv(changes=LOW, scaled=False)
    told = {"position_m": [0.0, 0.0, 40.0], "velocity_m_s": [0.0, 0.0, -1.0],
            "position_sigma_m": 0.0, "velocity_sigma_m_s": 0.0}  # fmt: skip
    observation, _ = env.reset(seed=1, options=told)
    assert observation[:6] == pytest.approx([0.0, 0.0, 40.0, 0.0, 0.0, -1.0])
    observation, _ = env.reset(seed=1)
    assert observation[2] == pytest.approx(25.0, abs=10.0)
    vector = GuidanceVectorEnv(3, changes=LOW, scaled=False)
    vector.reset(seed=1)
    some = np.array([False, True, False])
    observation, _ = vector.reset(options=told | {"reset_mask": some})
    assert observation[1, 2] == pytest.approx(40.0)
    assert (observation[[0, 2], 2] < 36.0).all()
    # The others' next flights start where theirs did.
    assert (vector.descents.lanes.starts[[0, 2], 2] == 25.0).all()
    assert vector.descents.lanes.starts[1, 2] == 40.0


def test_a_lane_of_a_mask_is_seeded_by_its_place_in_the_batch():
    vector = GuidanceVectorEnv(3, changes=LOW)
    vector.reset(seed=1)
    some = np.array([False, False, True])
    observation, _ = vector.reset(seed=70, options={"reset_mask": some})
    alone, _ = GuidanceEnv(changes=LOW).reset(seed=72)
    assert np.array_equal(observation[2], alone)


def test_running_out_of_time_ends_as_a_failure():
    env = GuidanceEnv(changes=LOW | {"simulation.max_time_s": 1.0})
    env.reset(seed=1)
    for step in range(5):
        _, _, terminated, truncated, info = env.step(np.zeros(3, np.float32))
        assert not truncated and terminated == (step == 4)
        assert info["cost"] == float(terminated)
    assert not info["safe"] and info["failure_causes"] == ("time-limit",)
    assert info["time_s"] == pytest.approx(1.0)
    assert info["reward_terms"]["touchdown"] == -15.0
    assert info["reward_terms"]["severity"] == info["reward_terms"]["excess"] == 0.0
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(3, np.float32))


BAD_OPTIONS = [
    ({"postion_m": [0, 0, 50]}, "Did you mean 'position_m'"), ({"position_m": [0, 0]}, "3 numbers"),
    ({"position_m": [0, 0, np.nan]}, r"position_m\[2\]: must be finite"),
    ({"position_m": "up"}, "must be 3 numbers"),
    ({"position_sigma_m": -1.0}, "between 0 and 5000"),
    ({"position_m": [0, 0, 1.0]}, r"options\.position_m\[2\]: .*above the highest terrain"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "says"), BAD_OPTIONS, ids=str)
def test_options_that_are_none_are_refused(options, says):
    with pytest.raises(InputError, match=says):
        GuidanceEnv(changes=LOW).reset(seed=1, options=options)


@pytest.mark.parametrize("mask", [np.ones(3), np.zeros(3, bool), np.ones(2, bool), "all"])
def test_a_mask_that_is_none_is_refused(mask):
    vector = GuidanceVectorEnv(3, changes=LOW)
    vector.reset(seed=1)
    with pytest.raises(ValueError, match="reset_mask"):
        vector.reset(options={"reset_mask": mask})


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"observation": []}, "list of one or more names"),
        ({"observation": "position"}, "one or more names"),
        ({"observation": ["postion"]}, "Did you mean 'position'"),
        ({"observation": ["rate", "rate"]}, "only once"), ({"rate_hz": 3.0}, "multiple of"),
        ({"worlds": 0}, "1 or more"), ({"worlds": 2.0}, "worlds"),
        ({"world_seed": -1}, "0 or more"),
        ({"rate_hz": 0}, "positive"), ({"rate_hz": "5"}, "positive"),
        ({"weights": {}}, "DescentWeights"),
        ({"scenario": "hirisee"}, "Did you mean 'hirise'"),
        ({"changes": {"rocks.covr": 0.1}}, "cover"),
        ({"changes": {"start.position_m": [0.0, 0.0, 1.0]}}, r"position_m\[2\]: must be above"),
    ],
    ids=str,
)  # fmt: skip
def test_arguments_that_will_not_do_are_refused(arguments, says):
    with pytest.raises(InputError, match=says):
        GuidanceEnv(**arguments)


@pytest.mark.parametrize("count", [0, -1, 2.0, True, "3"])
def test_a_number_of_lanes_that_is_none_is_refused(count):
    with pytest.raises(InputError, match="num_envs"):
        GuidanceVectorEnv(count, changes=LOW)


def test_parts_of_an_observation_are_chosen_and_added():
    own = ObservationComponent(
        "height", 1, "m", -100.0, 5000.0, "height of the centre of mass over the target",
        lambda lanes: lanes.y[:, 2:3] - lanes.target[:, 2:3])  # fmt: skip
    register(own)
    try:
        with pytest.raises(InputError, match="name of a registered component"):
            register(own)
        env = ControlEnv(changes=LOW, observation=["height", "time_left"], scaled=False)
        observation, _ = env.reset(seed=1)
        assert observation.shape == (2,) == env.observation_space.shape
        assert observation[1] == 20.0
        whole, _ = ControlEnv(changes=LOW, scaled=False).reset(seed=1)
        assert whole.shape == (sum(PARTS[name].size for name in DEFAULT),)
        assert whole[2] == observation[0]
    finally:
        del PARTS["height"]


def test_a_scenario_with_rocks_is_flown_over_its_pool():
    env = GuidanceEnv(scenario="hirise", worlds=2, changes={"target.scatter_m": [5.0, 5.0]})
    seen = set()
    for seed in range(8):
        env.reset(seed=seed)
        seen.add(int(env.descents.lanes.world[0]))
    assert seen == {0, 1}


def test_a_copy_and_a_pickle_fly_on_alike():
    env = GuidanceEnv(changes=LOW)
    env.reset(seed=1)
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        first = env.descents.lanes.y.copy()
        told = other.step(np.zeros(3, np.float32))
        assert np.array_equal(env.descents.lanes.y, first)
        kept = copy.deepcopy(env)
        assert np.array_equal(told[0], kept.step(np.zeros(3, np.float32))[0])


def test_an_image_shows_where_the_lander_is_and_how_it_ended():
    env = GuidanceEnv(changes=LOW, render_mode="rgb_array", rate_hz=10.0, scaled=False)
    assert env.metadata["render_fps"] == 10
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.render()
    observation, _ = env.reset(seed=4)
    # The view is the plane of start and target, the start to the right.
    along = observation[:2] / np.hypot(*observation[:2])

    def body(picture):
        """Middle of the lander's body: columns, and rows from above."""
        rows, cols = np.nonzero((picture[:, :440] == (222, 222, 226)).all(axis=2))
        return cols.mean(), rows.mean()

    first = env.render()
    assert first.shape == (440, 640, 3) and first.dtype == np.uint8
    ended = False
    while not ended:
        action = descent(observation[None], env.descents.actions)[0]
        observation, _, ended, _, info = env.step(action)
    last = env.render()
    assert info["safe"] and info["cost"] == 0.0
    # It ends on the ground in the middle of the view, the target's mark under it.
    col, row = body(last)
    off = observation[:2] @ along
    assert col == pytest.approx(220.0 + 0.5 * off * 440.0 / 24.0, abs=4.0)
    assert row > body(first)[1] + 100
    green = (last[380:, 440:] == (0, 200, 130)).all(axis=2)
    assert green.any() and not (first[380:, 440:] == (0, 200, 130)).all(axis=2).any()
    flame = (255, 170, 60)
    assert (first == flame).all(axis=2).sum() > 20 and not (last == flame).all(axis=2).any()
    assert GuidanceEnv(changes=LOW).render() is None
    with pytest.raises(ValueError, match="must be 'rgb_array', 'human' or None"):
        GuidanceEnv(changes=LOW, render_mode="ansi")


def test_a_crash_costs_and_the_end_is_reported():
    vector = batch(IDS[0], 16, autoreset_mode="SameStep", scaled=False)
    vector.reset(seed=3)
    lanes = vector.unwrapped.descents.lanes
    seen = 0
    for _ in range(100):
        burnt, time = lanes.propellant_used.copy(), lanes.time.copy()
        _, _, ended, late, info = vector.step(np.tile(np.float32([0.6, 0.0, -0.67]), (16, 1)))
        assert np.array_equal(info["cost"], np.where(ended & ~info.get("safe", ended), 1.0, 0.0))
        for lane in np.flatnonzero(ended | late):
            seen += 1
            assert 0.0 < info["propellant_kg"][lane] - burnt[lane] < 1.0
            assert 0.0 < info["time_s"][lane] - time[lane] < 0.2 + 1e-9
            off = np.hypot(*info["final_obs"][lane, :2])
            assert info["miss_m"][lane] == pytest.approx(off, rel=1e-5)
            assert info["final_info"]["miss_m"][lane] == info["miss_m"][lane]
    assert seen > 10


def test_a_crash_is_reported_by_how_bad_it_is():
    """By distance, and by speeds, tilt and rate over their limits, number by number."""
    weights = DescentWeights(severity=2.0, excess=0.5)
    vector = batch(IDS[0], 32, weights=weights, autoreset_mode="Disabled")
    vector.reset(seed=3)
    lanes = vector.unwrapped.descents.lanes
    far = np.linalg.norm(LOW["start.position_m"])
    rng, seen, lost = np.random.default_rng(1), 0, 0
    for _ in range(200):
        drawn = rng.uniform(-0.2, 0.2, (32, 3)) + np.array([0.0, 0.0, -0.3])
        drawn[:4] = [1.0, 0.0, 0.8]  # away
        *_, ended, late, info = vector.step(drawn.astype(np.float32))
        for i in np.flatnonzero(ended):
            if lanes.safe[i] or lanes.ended[i] != LANDED:
                assert info["reward_terms"]["severity"][i] == 0.0
                assert info["reward_terms"]["excess"][i] == 0.0
                assert info["reward_terms"]["touchdown"][i] == (10.0 if lanes.safe[i] else -15.0)
                lost += not lanes.safe[i]
                continue
            y = lanes.y[i]
            off = np.linalg.norm(y[:3] - lanes.target[i]) / far
            assert info["reward_terms"]["severity"][i] == pytest.approx(-2.0 * min(off, 1.0))
            down, side = abs(y[5]), np.hypot(y[3], y[4])
            up = 1.0 - 2.0 * (y[6] ** 2 + y[7] ** 2)
            values = [down / 3.0, side / 1.0, np.degrees(np.arccos(up)) / 6.0,
                      np.degrees(np.linalg.norm(y[10:13])) / 6.0]  # fmt: skip
            folds = sum(min(max(np.log(v), 0.0), 3.0) for v in values)
            seen += 1
            assert info["reward_terms"]["excess"][i] == pytest.approx(-0.5 * folds, abs=1e-6)
            assert info["reward_terms"]["touchdown"][i] == 0.0
        if (ended | late).any():
            vector.reset(options={"reset_mask": ended | late})
    assert seen > 10 and lost > 3


def test_a_seed_for_each_lane():
    vector = GuidanceVectorEnv(3, changes=LOW)
    first, _ = vector.reset(seed=[5, None, 9])
    again, _ = vector.reset(seed=[5, 4, 9])
    assert np.array_equal(first[[0, 2]], again[[0, 2]])
    assert not np.array_equal(first[1], again[1])
    arrayed, _ = vector.reset(seed=np.array([5, 4, 9]))
    assert np.array_equal(arrayed, again)
    with pytest.raises(ValueError, match="must have 3 values, one per environment"):
        vector.reset(seed=[1, 2])
