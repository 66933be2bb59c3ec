"""Retarget-v1 in which time, too, is decided on: actions of several parts."""

from __future__ import annotations

import copy
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.onboard.policies.contract import Decision
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim_envs.agents.registry import agent_of
from lunarsim_envs.evaluation.request import evaluation_study
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.sites import actions
from lunarsim_envs.sites.actions import TIME_SCALES, ActionComponent, SiteActions
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.field_of_view import fov_and_footprint
from lunarsim_envs.sites.pool import SiteWorldPool
from lunarsim_envs.sites.surrogate import exact_errors
from tests.envs.site_scene import SMALL

BOTH = ("site", "time_scale")
SITE = {"scenario": SMALL, "perception": "truth", "worlds": 2, "world_seed": 5}
# Level ground, an exact start and exact navigation: nothing is drawn that a flight hangs on.
EXACT = {
    "kind": "navigation-fix", "position_bias_m": 0.0, "position_drift_m": 0.0,
    "velocity_m_s": 0.0, "attitude_deg": 0.0,
}  # fmt: skip
LEVEL = Scenario.from_dict(SMALL.to_dict() | {
    "terrain": {"kind": "fractal", "size_m": 90.0, "rms_slope_deg": 0.0},
    "rocks": {"cover": 0.0}, "target": {"scatter_m": [0.0, 0.0]},
    "start": {
        "position_m": [-250.0, 40.0, 230.0], "velocity_m_s": [20.0, 0.0, -14.0],
        "position_sigma_m": 0.0, "velocity_sigma_m_s": 0.0,
    },
    "sensors": {
        "imu": {"kind": "imu"}, "fix": EXACT,
        "flash": {"kind": "flash-lidar", "rows": 96, "cols": 96},
    },
    "navigation": {"kind": "fixes"},
})  # fmt: skip


def made(**settings):
    return RetargetEnv(**(SITE | {"action": BOTH} | settings))


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in a)


# --- kernels against the whole simulation ----------------------------------------------------


def drawn(seed, count):
    """Return sites about the target, None keeps, and time_scales, None leaves."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        site = np.array([*rng.uniform(-30.0, 30.0, 2), 0.0]) if rng.random() < 0.5 else None
        made.append((site, rng.uniform(0.75, 1.6) if rng.random() < 0.6 else None))
    return made


def test_kernels_scale_times_as_the_complete_simulation_does():
    """Over drawn decisions: the same is refused, and flown a second on they arrive alike."""
    kernels = SiteDescentBatch(
        1, LEVEL, SiteWorldPool.of(LEVEL, 1, 3), errors=exact_errors(),
        view=fov_and_footprint(LEVEL), drift_sigma=np.zeros(2),
        reported_velocity_sigma=0.0, posting=0.4,
    )  # fmt: skip
    one, counts = np.ones(1, bool), [0, 0, 0]
    for seed in range(8):
        simulation = Simulation(LEVEL, seed, None)
        computer = simulation.computer
        kernels.seed(one, np.array([seed], np.uint64))
        kernels.begin(one)
        for site, time_scale in drawn(seed, 8):
            before = len(computer.telemetry)
            taken = simulation.apply(Decision(site, "drawn", time_scale=time_scale))
            names = [name for _, name, _ in computer.telemetry[before:]]
            goal = np.full((1, 3), np.nan) if site is None else site[None]
            kernels.decide(goal, one, np.array([np.nan if time_scale is None else time_scale]))
            refused = time_scale is not None and (not taken or "time-scale-refused" in names)
            assert (taken, refused) == (not kernels.refused[0], bool(kernels.time_scale_refused[0]))
            counts[0] += time_scale is not None and not refused
            counts[1] += refused
            counts[2] += site is not None and taken
            simulation.move()
            while not (simulation.done or simulation.decision_due):
                simulation.move()
            if simulation.done or kernels.ended[0]:
                break
            assert simulation.time == pytest.approx(float(kernels.time[0]), abs=1e-6)
            arrival = simulation.time + computer.time_to_go
            assert float(kernels.guidance.arrival[0]) == pytest.approx(arrival, abs=5e-3)
    assert min(counts) > 8


# --- the environment -------------------------------------------------------------------------


def test_sites_alone_are_what_they_were():
    env = RetargetEnv(**SITE)
    assert env.action_space == spaces.Discrete(21)
    env.reset(seed=1)
    assert env.action_masks().shape == (21,)
    assert "time_scale_refused" not in env.step(0)[-1]
    batch = RetargetVectorEnv(2, **SITE)
    assert batch.single_action_space == spaces.Discrete(21)


def test_actions_of_two_parts_and_their_masks():
    env = made()
    assert env.action_space == spaces.MultiDiscrete([21, 5])
    _, info = env.reset(seed=1)
    over, known = False, 0
    while not over:
        mask = info["action_mask"]
        assert mask.shape == (26,) and mask.dtype == np.int8 and mask[21:].all()
        assert np.array_equal(env.action_masks(), mask == 1) and env.action_masks().dtype == bool
        drawn = env.action_space.sample(mask=tuple(np.split(info["action_mask"], [21])))
        assert mask[drawn[0]] == 1
        known += mask[1:21].sum()
        _, _, over, _, info = env.step(drawn)
        assert info["reward_terms"]["invalid"] == 0.0
    assert known > 10
    turned = made(action=("time_scale", "site"))
    assert turned.action_space == spaces.MultiDiscrete([5, 21])
    assert made(action=("time_scale",)).action_space == spaces.Discrete(5)


@pytest.mark.parametrize("perception", ["truth", "onboard"])
def test_check_env_without_a_warning(perception):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        given = SITE | {"action": BOTH, "perception": perception}
        check_env(gymnasium.make("lunarsim_envs:lunarsim/Retarget-v1", **given).unwrapped)


@pytest.mark.parametrize("perception", ["truth", "onboard"])
def test_choices_are_of_the_cheapest_time(perception):
    """From one second decision on: 0 leaves it as it is, 1 and on are time_scales of one time."""
    begun = made(perception=perception)
    begun.reset(seed=3)
    begun.step(np.array([0, 0]))
    left, refused = [], []
    for choice in range(5):
        env = copy.deepcopy(begun) if perception == "truth" else made(perception=perception)
        if perception == "onboard":  # a flight that holds a renderer is not copied
            env.reset(seed=3)
            env.step(np.array([0, 0]))
        start = env.flight.time
        seen, *_, info = env.step([0, choice])
        left.append(float(seen["to_go"][0]) + env.flight.time - start)
        refused.append(info["time_scale_refused"])
    assert not refused[0] and not refused[1]
    cheapest = left[1]
    assert TIME_SCALES == (1.0, 1.07, 1.15, 1.3)
    for choice in range(1, 5):
        wanted = 1.0 if refused[choice] else TIME_SCALES[choice - 1]
        assert left[choice] == pytest.approx(wanted * cheapest, abs=0.02)
    assert (
        sum(refused) < 4 and len(set(np.round(left[1:], 2))) > 1 and abs(left[0] - cheapest) > 0.02
    )


def test_a_new_site_gets_the_cheapest_time_or_a_multiple_of_it():
    begun = made()
    _, info = begun.reset(seed=3)
    while not info["action_mask"][1:21].any():
        *_, info = begun.step([0, 0])
    row = int(np.flatnonzero(info["action_mask"][:21])[-1])
    goal = begun.flight.inputs.position_of[0, row - 1].copy()
    left = []
    for choice in (0, 1, 3):
        env = copy.deepcopy(begun)
        start = env.flight.time
        env.step([row, choice])
        assert np.allclose(env.flight.lanes.guidance.site[0, :2], goal[:2])
        left.append(env.flight.lanes.guidance.arrival[0] - start)
    assert left[0] == left[1] and left[2] == pytest.approx(1.15 * left[0])


def test_a_row_that_is_not_to_be_had_leaves_all_as_it_is():
    begun = made()
    _, info = begun.reset(seed=3)
    (none,) = np.flatnonzero(info["action_mask"] == 0)[:1]
    wrong, stays = (copy.deepcopy(begun) for _ in range(2))
    seen, *_, info = wrong.step([none, 3])
    own, *_, told = stays.step([0, 0])
    assert same(seen, own)
    assert info["time_scale_refused"] and not told["time_scale_refused"]
    assert info["reward_terms"]["invalid"] < 0.0
    # No time_scale was asked for, so none is refused.
    *_, plain = copy.deepcopy(begun).step([none, 0])
    assert plain["reward_terms"]["invalid"] < 0.0 and not plain["time_scale_refused"]
    batch = RetargetVectorEnv(2, action=BOTH, **SITE)
    batch.reset(seed=[3, 3])
    info = batch.step(np.array([[none, 3], [0, 3]]))[-1]
    assert info["time_scale_refused"].tolist() == [True, False]
    assert info["_time_scale_refused"].all()


def test_a_site_that_the_computer_refuses_has_its_time_scale_refused():
    env = made(perception="onboard")
    env.reset(seed=3)
    far = np.array([4000.0, 0.0, 0.0])
    env.flight.decide(far, lambda: None, 1.15)
    assert env.flight.time_scale_refused
    env.flight.decide(far, lambda: None)
    assert not env.flight.time_scale_refused


WRONG = [
    [0], [0, 5], [0, -1], [21, 0], [0.0, 1.0], [[0, 0]], None, "ab", [True, False], [0, None], 3,
    [[0], [0, 1]], [0, 2**70],
]  # fmt: skip


@pytest.mark.parametrize("action", WRONG, ids=str)
def test_actions_that_are_none_are_refused_and_change_nothing(action):
    env = made()
    env.reset(seed=1)
    before = env.flight.time
    with pytest.raises(ValueError, match=r"for site, time_scale, got|between 0 and"):
        env.step(action)
    assert env.flight.time == before
    batch = RetargetVectorEnv(2, action=BOTH, **SITE)
    batch.reset(seed=1)
    times = batch.lanes.time.copy()
    with pytest.raises(ValueError, match="actions"):
        batch.step([action, action])
    assert np.array_equal(batch.lanes.time, times)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (("sites",), "Did you mean 'site'"), ((), "one or more names"), ("site", "or more names"),
        (("site", "site"), "each name only once"), (3, "one or more names"),
    ],
    ids=str,
)  # fmt: skip
def test_parts_that_are_none_are_refused(given, says):
    for kind in (RetargetEnv, RetargetVectorEnv):
        with pytest.raises(InputError, match=says) as error:
            kind(action=given, **SITE)
        assert "action" in str(error.value)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_go_on_alike(copied):
    for env, action in ((made(), [1, 3]), (RetargetVectorEnv(2, action=BOTH, **SITE),
                                           np.array([[1, 3], [0, 4]]))):  # fmt: skip
        env.reset(seed=5)
        env.step(action)
        other = copied(env)
        (seen, reward, *_, info), (own, earned, *_, told) = (e.step(action) for e in (env, other))
        assert same(seen, own) and np.array_equal(reward, earned)
        assert np.array_equal(info["time_scale_refused"], told["time_scale_refused"])


def test_a_part_of_ones_own(monkeypatch):
    monkeypatch.setattr(actions, "PARTS", dict(actions.PARTS))
    slow = ActionComponent("slow", "time_scale", 2, "1 takes a fifth more time",
                      lambda sights, chosen: np.where(chosen == 1, 1.2, np.nan))  # fmt: skip
    actions.register(slow)
    env = pickle.loads(pickle.dumps(made(action=("site", "slow"))))
    assert env.action_space == spaces.MultiDiscrete([21, 2])
    env.reset(seed=3)
    left = float(env.flight.lanes.guidance.arrival[0] - env.flight.time)
    start = env.flight.time
    env.step([0, 1])
    assert env.flight.lanes.guidance.arrival[0] - start == pytest.approx(1.2 * left, rel=0.05)
    with pytest.raises(InputError, match="two components that set the time_scale"):
        SiteActions(("slow", "time_scale"))
    for part, says in (
        (slow, "name of a registered component"),
        (ActionComponent("a", "abort", 2, "", slow.of), "'site' or"),
        (ActionComponent("b", "time_scale", 1, "", slow.of), "2 or more"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            actions.register(part)
    for part, says in (
        (ActionComponent("c", "time_scale", 2, "", lambda s, c: s.site), "'c': must have shape"),
        (ActionComponent("d", "time_scale", 2, "", lambda s, c: -1.0 * c), "positive and finite"),
        (ActionComponent("e", "time_scale", 2, "", slow.of, lambda s: s.here > 0), "open"),
    ):  # fmt: skip
        actions.register(part)
        env = made(action=(part.name,))
        with pytest.raises(InputError, match=says):
            env.reset(seed=1)
            env.step(1)


# --- agents ----------------------------------------------------------------------------------


def flown(env, name, seed):
    """Return the rewards of one flight of an agent, and what it did."""
    agent = agent_of(name, env)
    agent.begin(np.random.default_rng(seed))
    seen, info = env.reset(seed=seed)
    rewards, did, over = [], [], False
    while not over:
        did.append(np.array(agent.act(seen, info)))
        seen, reward, over, _, info = env.step(did[-1])
        rewards.append(reward)
    return rewards, np.array(did)


@pytest.mark.parametrize("name", ["nearest-safe", "few-sites", "ppo-sites", "zero"])
def test_agents_of_sites_leave_the_time_as_it_comes(name):
    plainly, rows = flown(RetargetEnv(**SITE), name, 3)
    rewards, did = flown(made(), name, 3)
    assert rewards == plainly
    assert np.array_equal(did[:, 0], rows) and not did[:, 1].any()
    assert (rows > 0).any() or name == "zero"
    turned, _ = flown(made(action=("time_scale", "site")), name, 3)
    assert turned == plainly
    if name != "zero":
        with pytest.raises(InputError, match="needs Retarget-v1 with the action component 'site'"):
            agent_of(name, made(action=("time_scale",)))


def test_random_draws_all_that_can_be_had():
    agent = agent_of("random", made())
    agent.begin(np.random.default_rng(1))
    mask = np.zeros(26, np.int8)
    mask[[0, 3, 20, 21, 24]] = 1
    told = {tuple(map(int, agent.act(None, {"action_mask": mask}))) for _ in range(200)}
    assert told == {(site, time_scale) for site in (0, 3, 20) for time_scale in (0, 3)}
    free = np.array([agent.act(None, {}) for _ in range(400)])
    assert free.max(axis=0).tolist() == [20, 4] and free.min() == 0
    _, did = flown(made(), "random", 2)
    assert did.shape[1] == 2 and did.any()


def test_agents_are_evaluated_on_the_parts_that_are_asked_for():
    given = evaluation_study("lunarsim_envs:Retarget-v1", None, [], 1, action=list(BOTH), worlds=1)
    assert given.make().action_space == spaces.MultiDiscrete([21, 5])
    for name in ("lunarsim_envs:Guidance-v1", "CartPole-v1"):
        with pytest.raises(InputError, match="--action: applies only"):
            evaluation_study(name, None, [], 1, action=["time_scale"])
    words = ["evaluate", "Retarget-v1", "--episodes", "1", "--worlds", "1", "--jobs", "1"]
    done = CliRunner().invoke(main, [*words, "--action", "time_scale", "--agent", "nearest-safe"])
    assert done.exit_code == 2 and "with the action component 'site'" in done.output


def test_frames_say_by_which_time_scale():
    env = gymnasium.make(
        "lunarsim_envs:lunarsim/Retarget-v1",
        scenario=SMALL,
        action=BOTH,
        perception="onboard",
        render_mode="rgb_array",
    ).unwrapped
    env.reset(seed=3)
    env.step([0, 3])
    env.render()
    assert "keep the site,  time scale 1.15,  reward" in env.frames.title
    env.step([0, 0])
    env.render()
    assert "time_scale" not in env.frames.title
