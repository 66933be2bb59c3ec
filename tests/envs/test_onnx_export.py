"""Export of agents of Stable-Baselines3 to ONNX: needs the extra `rl`."""

from __future__ import annotations

import pickle

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim_envs.agents.registry import agent_of
from tests.envs.site_scene import SMALL

pytestmark = pytest.mark.slow
SETTINGS = {
    "Guidance-v1": {},
    "Retarget-v1": {
        "scenario": SMALL,
        "perception": "truth",
        "worlds": 1,
        "observation": ["candidates", "site"],
    },
}


def trained(name, folder):
    """Train for a few steps with normalised observations; return model, statistics, files."""
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from sb3_contrib import MaskablePPO
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    batch = gymnasium.make_vec(
        f"lunarsim_envs:lunarsim/{name}", num_envs=8, vectorization_mode="vector_entry_point",
        autoreset_mode="SameStep", **SETTINGS[name],
    )  # fmt: skip
    env = VecNormalize(Sb3VecEnv(batch), clip_obs=3.0)
    env.seed(1)
    kind, policy = (
        (PPO, "MlpPolicy") if name == "Guidance-v1" else (MaskablePPO, "MultiInputPolicy")
    )
    model = kind(policy, env, n_steps=16, batch_size=64, n_epochs=1, seed=1)
    model.learn(256)
    model.save(folder / "model.zip")
    env.save(folder / "normalize.pkl")
    return model, env


def export(folder, *more):
    arguments = ["agent", "export", str(folder / "model.zip"), "--out", str(folder / "a.onnx")]
    return CliRunner().invoke(main, [*arguments, "--trust-pickle", *more])


@pytest.mark.parametrize("name", SETTINGS)
def test_an_exported_agent_acts_as_the_trained_one(name, tmp_path):
    model, statistics = trained(name, tmp_path)
    done = export(tmp_path, "--vec-normalize", str(tmp_path / "normalize.pkl"))
    assert done.exit_code == 0, done.output
    env = gymnasium.make(f"lunarsim_envs:lunarsim/{name}", **SETTINGS[name])
    agent = agent_of(str(tmp_path / "a.onnx"), env)
    acted, over, plain = 0, True, 0
    for n in range(60):
        if over:
            observation, info = env.reset(seed=n)
        action = agent.act(observation, info)
        masks = {} if name == "Guidance-v1" else {"action_masks": info["action_mask"].astype(bool)}
        shown = statistics.normalize_obs(observation)
        expected, _ = model.predict(shown, deterministic=True, **masks)
        assert np.allclose(action, expected, atol=1e-5)
        plain += not np.allclose(action, model.predict(observation, deterministic=True, **masks)[0])
        acted += 1
        observation, _, over, _, info = env.step(action)
    assert acted == 60
    assert plain > 0  # the statistics change the actions


def test_statistics_that_the_training_did_not_use_change_nothing(tmp_path):
    model, statistics = trained("Guidance-v1", tmp_path)
    statistics.norm_obs = False
    statistics.save(tmp_path / "off.pkl")
    assert export(tmp_path, "--vec-normalize", str(tmp_path / "off.pkl")).exit_code == 0
    env = gymnasium.make("lunarsim_envs:lunarsim/Guidance-v1")
    observation, info = env.reset(seed=1)
    action = agent_of(str(tmp_path / "a.onnx"), env).act(observation, info)
    assert np.allclose(action, model.predict(observation, deterministic=True)[0], atol=1e-5)


def test_a_constant_component_is_scaled_by_epsilon(tmp_path):
    model, statistics = trained("Guidance-v1", tmp_path)
    statistics.obs_rms.var[:] = 0.0
    statistics.epsilon, statistics.clip_obs = 0.25, 1e9
    statistics.save(tmp_path / "flat.pkl")
    assert export(tmp_path, "--vec-normalize", str(tmp_path / "flat.pkl")).exit_code == 0
    env = gymnasium.make("lunarsim_envs:lunarsim/Guidance-v1")
    observation, info = env.reset(seed=1)
    action = agent_of(str(tmp_path / "a.onnx"), env).act(observation, info)
    shown = ((observation - statistics.obs_rms.mean) / 0.5).astype(np.float32)
    assert np.allclose(action, model.predict(shown, deterministic=True)[0], atol=1e-5)


def test_scores_of_a_dqn_are_exported(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from stable_baselines3 import DQN

    env = gymnasium.make("lunarsim_envs:lunarsim/Retarget-v1", **SETTINGS["Retarget-v1"])
    model = DQN("MultiInputPolicy", env, buffer_size=200, learning_starts=20, seed=1)
    model.learn(40)
    model.save(tmp_path / "model.zip")
    assert export(tmp_path).exit_code == 0
    agent = agent_of(str(tmp_path / "a.onnx"), env)
    observation, _ = env.reset(seed=1)
    for _ in range(8):
        expected, _ = model.predict(observation, deterministic=True)
        assert agent.act(observation, {"action_mask": np.ones(21)}) == expected
        observation, _, over, _, _ = env.step(0)
        if over:
            break


def test_agents_with_memory_are_refused(tmp_path):
    pytest.importorskip("sb3_contrib", reason="the extra `rl` is not installed")
    from sb3_contrib import RecurrentPPO

    env = gymnasium.make("lunarsim_envs:lunarsim/Guidance-v1")
    RecurrentPPO("MlpLstmPolicy", env, n_steps=8, seed=1).save(tmp_path / "model.zip")
    done = export(tmp_path)
    assert done.exit_code == 2 and "without memory" in done.stderr


def test_statistics_of_another_observation_are_refused(tmp_path):
    model, statistics = trained("Guidance-v1", tmp_path)
    statistics.obs_rms.mean = np.zeros(5)
    (tmp_path / "other.pkl").write_bytes(pickle.dumps(statistics))
    done = export(tmp_path, "--vec-normalize", str(tmp_path / "other.pkl"))
    assert done.exit_code == 2
    assert "must have statistics of the agent's observation" in done.stderr
    assert "observation (32,)" in done.stderr and "(5,)" in done.stderr
    assert not (tmp_path / "a.onnx").exists()
    (tmp_path / "none.pkl").write_bytes(pickle.dumps({"a": 1}))
    (tmp_path / "text.pkl").write_bytes(b"garbage")
    for wrong in ("none.pkl", "text.pkl", "model.zip", "gone.pkl"):
        done = export(tmp_path, "--vec-normalize", str(tmp_path / wrong))
        assert done.exit_code == 2 and "must be a file of VecNormalize.save" in done.stderr
    for name, value in (("clip_obs", 0.0), ("epsilon", -1e9), ("epsilon", np.nan)):
        _, statistics = trained("Guidance-v1", tmp_path)
        setattr(statistics, name, value)
        statistics.save(tmp_path / "strange.pkl")
        done = export(tmp_path, "--vec-normalize", str(tmp_path / "strange.pkl"))
        assert done.exit_code == 2 and "positive variances and a positive" in done.stderr
