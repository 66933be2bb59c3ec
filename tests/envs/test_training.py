"""Training of Guidance-v1: needs the extra `rl`, and is slow for PyTorch's sake."""

from __future__ import annotations

import subprocess
import sys
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.agents.network import Network
from lunarsim_envs.agents.registry import agent_of, packaged_agents
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.training.held_out import evaluate_held_out
from lunarsim_envs.training.settings import SETTINGS, PpoSettings
from tests.envs import site_scene
from tests.low_descents import IDS, LOW, batch
from tests.worlds import SCENARIOS

SMALL = replace(PpoSettings(), lanes=32, horizon=16, batch=64, steps=4 * 32 * 16)


def test_settings_that_will_not_do_are_refused():
    for name in ("steps", "lanes", "horizon", "batch"):
        with pytest.raises(InputError, match=f"{name}: must be 1 or more"):
            replace(PpoSettings(), **{name: 0})


def test_settings_change_starts_and_come_back_from_their_file(tmp_path):
    settings = PpoSettings(steps=100, lanes=16, horizon=2, position_sigma=4.0, velocity_sigma=0.0)
    env = GuidanceEnv(changes=settings.changes, scaled=False)
    planned = env.descents.scenario.start
    seen = np.array([env.reset(seed=seed)[0][:6] for seed in range(60)])
    assert np.allclose(seen[:, 3:], planned.velocity_m_s)
    assert (seen[:, :3] - planned.position_m).std() == pytest.approx(4.0, rel=0.2)
    assert settings.updates == 4  # the last one is not cut short
    settings.save(tmp_path / "settings.json")
    assert PpoSettings.load(tmp_path / "settings.json") == settings


def test_held_out_results_are_those_of_single_flights():
    """Eight descents with wide dispersions at once and each alone; some of them land."""
    network = Network.load(packaged_agents()["ppo"])
    wide = {"start.position_sigma_m": 80.0, "start.velocity_sigma_m_s": 20.0}
    together = evaluate_held_out(
        GuidanceVectorEnv(8, "SameStep", changes=wide, split="validation"),
        lambda seen, info: np.stack([network(one) for one in seen]), seed=7,
    )  # fmt: skip
    env, safe, near, burnt = GuidanceEnv(changes=wide, split="validation"), [], [], []
    for seed in range(7, 15):
        seen, _ = env.reset(seed=seed)
        over = False
        while not over:
            seen, _, ended, late, info = env.step(network(seen))
            over = ended or late
        safe.append(info["safe"])
        near.append(info["safe"] and info["miss_m"] <= 10.0)
        burnt.append(info["propellant_kg"])
    assert (together.safe, together.on_target) == (np.mean(safe), np.mean(near))
    assert 0.0 < together.safe < 1.0
    assert together.propellant == pytest.approx(np.mean(np.array(burnt)[safe]), rel=1e-12)


def test_held_out_results_without_a_safe_landing():
    falls = batch(IDS[1], 3, autoreset_mode="SameStep")
    result = evaluate_held_out(falls, lambda seen, info: np.full((3, 4), -1.0, np.float32))
    assert result.safe == result.on_target == 0.0 and np.isnan(result.propellant)
    sites = RetargetVectorEnv(
        3, "SameStep", scenario=site_scene.SMALL, perception="truth", worlds=2, world_seed=5
    )
    assert np.isnan(evaluate_held_out(sites, lambda seen, info: np.zeros(3, int)).on_target)


class Landings:
    """A batch whose flights land safely in their first step, at the limit of `on_target`."""

    num_envs = 4

    def reset(self, seed):
        return np.zeros((4, 1)), {}

    def step(self, actions):
        miss = np.array([0.0, 10.0, 10.01, 99.0])
        info = {"safe": np.ones(4, bool), "propellant_kg": np.full(4, 40.0), "miss_m": miss}
        return np.zeros((4, 1)), np.zeros(4), np.ones(4, bool), np.zeros(4, bool), info


def test_landings_within_ten_metres_are_on_target():
    result = evaluate_held_out(Landings(), lambda seen, info: None)
    assert (result.safe, result.on_target, result.propellant) == (1.0, 0.5, 40.0)


def test_a_discount_per_second_does_not_depend_on_the_action_rate():
    for rate in (5.0, 10.0, 50.0):
        settings = PpoSettings(rate=rate, discount_per_s=0.97)
        assert settings.discount**rate == pytest.approx(0.97, rel=1e-12)


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_a_truncated_flight_is_no_safe_landing(mode):
    network = Network.load(packaged_agents()["ppo"])
    flights = batch(IDS[0], 4, autoreset_mode=mode, max_episode_steps=5)
    result = evaluate_held_out(flights, lambda seen, info: network(seen))
    assert result.safe == 0.0 and np.isnan(result.propellant)


def test_settings_of_another_version_are_refused(tmp_path):
    for text in ('{"environment": "Guidance-v1", "foo": 1}', "{", "[]"):
        (tmp_path / "settings.json").write_text(text)
        with pytest.raises(InputError, match="settings: must be a file of this version"):
            PpoSettings.load(tmp_path / "settings.json")


@pytest.mark.slow
def test_an_agent_is_evaluated_in_the_split_that_is_named(tmp_path, monkeypatch):
    """And trained in the split "train"."""
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.descents import TrainingRun

    made, original = [], gymnasium.make_vec

    def spy(*arguments, **options):
        made.append(options["split"])
        return original(*arguments, **options)

    monkeypatch.setattr(gymnasium, "make_vec", spy)
    run = TrainingRun(SMALL, tmp_path)
    run.evaluate()
    run.fly("test", 2)
    assert made == ["train", "validation", "test"]


@pytest.mark.slow
def test_two_trainings_are_the_same_bits(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.descents import train

    runs = [train(SMALL, tmp_path / name, 2, lambda run, seen: None) for name in ("one", "other")]
    files = [(tmp_path / name / "agent.npz").read_bytes() for name in ("one", "other")]
    assert files[0] == files[1]
    first, second = ([row | {"seconds": 0.0} for row in run.curve] for run in runs)
    assert len(first) == 2 and np.array_equal(
        [list(row.values()) for row in first], [list(row.values()) for row in second],
        equal_nan=True,
    )  # fmt: skip
    # Another seed is another agent.
    other = train(replace(SMALL, seed=1), tmp_path / "seed", 4, lambda run, seen: None)
    assert (other.out / "agent.npz").read_bytes() != files[0]


@pytest.mark.slow
def test_a_training_goes_on_bit_for_bit(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.descents import TrainingRun

    whole = TrainingRun(SMALL, tmp_path / "whole")
    for _ in range(4):
        whole.advance()
    first = TrainingRun(SMALL, tmp_path / "parts")
    for _ in range(2):
        first.advance()
    first.checkpoint()
    second = TrainingRun(SMALL, tmp_path / "parts")
    assert second.done == 2
    for _ in range(2):
        second.advance()
    one, other = whole.network, second.network
    for a, b in zip(one.weights + one.biases, other.weights + other.biases, strict=True):
        assert np.array_equal(a, b)
    assert not np.array_equal(one.weights[0], first.network.weights[0])
    with pytest.raises(InputError, match="with the same settings"):
        TrainingRun(replace(SMALL, seed=1), tmp_path / "parts")
    # What NumPy flies, and what the file of Stable-Baselines3 does, is the agent that was trained.
    second.checkpoint()
    env = GuidanceEnv(changes=SMALL.changes)
    seen, _ = env.reset(seed=1)
    wanted = second.model.predict(seen, deterministic=True)[0]
    for name in ("agent.npz", "checkpoint/model.zip"):
        agent = agent_of(str(tmp_path / "parts" / name), env, trust_pickle=True)
        agent.begin(np.random.default_rng(0))
        assert agent.act(seen, {}) == pytest.approx(wanted, abs=1e-5)


@pytest.mark.slow
def test_the_script_of_the_guide_lands_after_three_million_steps(tmp_path):
    """With the defaults of Stable-Baselines3; one seed of 0.98 and another processor may differ."""
    stable = pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    script = SCENARIOS / "learning" / "minimal_ppo.py"
    subprocess.run([sys.executable, str(script)], cwd=tmp_path, check=True, capture_output=True)
    model = stable.PPO.load(tmp_path / "minimal_ppo.zip", device="cpu")
    flights = gymnasium.make_vec(
        "lunarsim_envs:lunarsim/Guidance-v1", num_envs=300, autoreset_mode="SameStep",
        vectorization_mode="vector_entry_point", split="test",
    )  # fmt: skip

    def agent(seen, info):
        return model.predict(seen, deterministic=True)[0]

    assert evaluate_held_out(flights, agent).safe > 0.9


@pytest.mark.slow
def test_a_network_of_control_flies_as_it_was_trained(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.descents import TrainingRun

    small = replace(SETTINGS["Control-v1"], lanes=32, horizon=16, batch=64, steps=512)
    run = TrainingRun(small, tmp_path)
    run.advance()
    run.checkpoint()
    assert run.model.gamma == pytest.approx(0.98**0.1)
    env = ControlEnv(changes=small.changes, rate_hz=10.0)
    seen, _ = env.reset(seed=1)
    wanted = run.model.predict(seen, deterministic=True)[0]
    agent = agent_of(str(tmp_path / "agent.npz"), env)
    agent.begin(np.random.default_rng(0))
    assert agent.act(seen, {}) == pytest.approx(wanted, abs=1e-5)


@pytest.mark.slow
def test_a_policy_that_scores_sites_becomes_a_site_network(tmp_path):
    """Its most likely action is the best allowed site of the network, after training too."""
    contrib = pytest.importorskip("sb3_contrib", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv
    from lunarsim_envs.training.site_policy import SitePolicy

    lanes = RetargetVectorEnv(
        8, "SameStep", observation=["site_features"], scenario=site_scene.SMALL,
        perception="truth", worlds=2, world_seed=5,
    )  # fmt: skip
    env = Sb3VecEnv(lanes)
    env.seed(1)
    model = contrib.MaskablePPO(
        SitePolicy, env, n_steps=16, batch_size=32, seed=1, policy_kwargs={"hidden": 5}
    )
    before = model.policy.site_network()
    model.learn(256)
    network = model.policy.site_network()
    assert network.inner.shape == (5, 8)
    for name in ("linear", "inner", "bias", "outer"):
        assert (getattr(network, name) != getattr(before, name)).any()
    model.save(tmp_path / "model.zip")
    other = contrib.MaskablePPO.load(tmp_path / "model.zip")
    seen, _ = lanes.reset(seed=3)
    for _ in range(6):
        masks = lanes.action_masks()
        chosen = other.predict(seen, action_masks=masks, deterministic=True)[0]
        assert np.array_equal(chosen, network.choose(lanes.inputs))
        seen, *_ = lanes.step(chosen)


@pytest.mark.slow
def test_a_batch_is_what_stable_baselines3_takes(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from stable_baselines3.common.env_checker import check_env

    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    near = {"position_m": [0.0, 0.0, 40.0], "position_sigma_m": 0.0}
    env = Sb3VecEnv(batch(IDS[0], 8, autoreset_mode="SameStep", scaled=False))
    env.seed(5)
    env.set_options([near] * 4 + [{}] * 4)
    first = env.reset()
    assert (first[:4, 2] == 40.0).all() and (first[4:, 2] < 36.0).all()
    env.seed(5)
    env.set_options([near] * 4 + [{}] * 4)
    assert np.array_equal(env.reset(), first)
    ends = 0
    for _ in range(120):
        env.step_async(np.tile(np.float32([0.2, 0.0, -0.33]), (8, 1)))
        seen, reward, over, told = env.step_wait()
        assert reward.dtype == np.float32 and len(told) == 8
        for lane in np.flatnonzero(over):
            ends += 1
            assert told[lane]["terminal_observation"][2] < seen[lane, 2]
            assert seen[lane, 2] == 40.0 if lane < 4 else seen[lane, 2] < 36.0
        assert not any(told[lane] for lane in np.flatnonzero(~over))
    assert ends > 8
    with pytest.raises(ValueError, match=r"must be AutoresetMode\.SAME_STEP"):
        Sb3VecEnv(batch(IDS[0], 8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in IDS:
            check_env(gymnasium.make(f"lunarsim_envs:{name}").unwrapped)


@pytest.mark.slow
@pytest.mark.parametrize("action", [("site",), ("site", "time_scale")])
def test_a_batch_that_chooses_sites_has_masks_and_is_learned_from(action):
    contrib = pytest.importorskip("sb3_contrib", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    settings = {"scenario": site_scene.SMALL, "perception": "truth", "worlds": 2, "world_seed": 5}
    env = Sb3VecEnv(RetargetVectorEnv(4, "SameStep", action=action, **settings))
    seen, ends = env.reset(), 0
    for _ in range(40):
        masks = np.array(env.env_method("action_masks"))
        assert np.array_equal(masks[:, 1:21], seen["sites"][..., 5] > 0.0) and masks[:, 0].all()
        rows = np.array([np.flatnonzero(mask[:21])[-1] for mask in masks])
        env.step_async(rows if len(action) == 1 else np.column_stack((rows, rows % 5)))
        seen, _, over, told = env.step_wait()
        for lane in np.flatnonzero(over):
            ends += 1
            last = told[lane]["terminal_observation"]
            assert set(last) == set(seen) and last["to_go"][2] < seen["to_go"][lane, 2]
    assert ends > 4
    with pytest.raises(InputError, match="env_method"):
        env.env_method("close")
    model = contrib.MaskablePPO("MultiInputPolicy", env, n_steps=16, batch_size=32, n_epochs=1)
    assert model.learn(64).num_timesteps == 64


@pytest.mark.slow
def test_options_of_stable_baselines3_are_those_of_a_reset():
    """For all lanes or each its own; of the next reset alone."""
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    near, exact = {"position_m": [0.0, 0.0, 40.0]}, {"position_sigma_m": 0.0}
    env = Sb3VecEnv(batch(IDS[0], 4, autoreset_mode="SameStep", scaled=False))
    env.reset()
    env.set_options(near | exact)
    assert (env.reset()[:, 2] == 40.0).all()
    assert (env.reset()[:, 2] < 36.0).all()
    own = [near | exact, {}, near | exact, {}]
    env.set_options(own)
    assert (env.reset()[:, 2] == 40.0).tolist() == [True, False, True, False]
    env.set_options({"positon_m": [0.0, 0.0, 40.0]})
    with pytest.raises(InputError, match="Did you mean 'position_m'"):
        env.reset()
    for wrong in ([near], [near, None, near, near]):
        env.set_options(wrong)
        with pytest.raises(InputError, match="set_options"):
            env.reset()


@pytest.mark.slow
def test_only_a_step_limit_is_reported_as_truncated():
    """Learners take the value of the last state for what such a flight would have returned.

    The time limit of the scenario ends a flight, with the reward of no landing.
    """
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    low = {"position_m": [0.0, 0.0, 40.0], "position_sigma_m": 0.0}
    falls = low | {"velocity_m_s": [0.0, 0.0, -30.0]}
    changes = LOW | {"simulation.max_time_s": 2.0}
    for limit, steps, late in ((None, 10, False), (9, 9, True)):
        batch_env = GuidanceVectorEnv(2, "SameStep", max_episode_steps=limit, changes=changes)
        env = Sb3VecEnv(batch_env)
        env.set_options([low, falls])
        env.reset()
        ends = {}
        for step in range(1, 11):
            _, reward, over, told = env.step(np.zeros((2, 3), np.float32))
            for lane in np.flatnonzero(over):
                ends.setdefault(int(lane), (step, told[lane]["TimeLimit.truncated"], reward[lane]))
        assert ends[0][:2] == (steps, late) and not ends[1][1]
        assert (ends[0][2] < -10.0) == (not late)
