"""Training of Guidance-v1: needs the extra `rl`, and is slow for PyTorch's sake."""

from __future__ import annotations

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.agents.registry import agent_of
from lunarsim_envs.descent.env import GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.training.settings import PpoSettings, scales
from tests.envs import site_scene
from tests.low_descents import IDS, LOW, batch

SMALL = replace(PpoSettings(), lanes=32, horizon=16, batch=64, epochs=2, steps=4 * 32 * 16)


def test_settings_that_will_not_do_are_refused():
    for changes, says in (
        ({"steps": 0}, "steps: must"), ({"discount": float("nan")}, "discount"),
        ({"lanes": 8}, "16 or more"), ({"nearest": 0.0}, "above 0"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            replace(PpoSettings(), **changes)
    PpoSettings().weights.check(400.0)
    # Shaping leaves the best policy alone at the learner's own discount alone.
    assert replace(PpoSettings(), discount=0.98).weights.discount == 0.98


def test_starts_go_from_near_the_target_to_the_whole_way():
    planned = np.array([-600.0, 0.0, 500.0, 28.0, 0.0, -18.0, 30.0, 10.0])
    starts = PpoSettings().starts(planned)
    heights = [start["position_m"][2] for start in starts]
    assert len(starts) == 16 and heights[0] == pytest.approx(20.0)
    assert heights[:12] == sorted(heights[:12]) and heights[11:] == [500.0] * 5
    assert starts[0]["velocity_m_s"][0] == pytest.approx(28.0 * 0.2)
    assert starts[0]["position_sigma_m"] == pytest.approx(1.2)
    assert starts[15]["velocity_sigma_m_s"] == 10.0


def test_every_number_of_an_observation_has_its_scales():
    far, near = scales(("velocity", "position"))
    assert far == [40.0] * 3 + [600.0] * 3 and near == [1.0] * 3 + [3.0] * 3
    assert [PpoSettings(steps=100, lanes=16, horizon=2).learning_rate(k) for k in (0, 3)] == (
        pytest.approx([PpoSettings.rate_first, PpoSettings.rate_last])
    )
    spreads = [PpoSettings(steps=100, lanes=16, horizon=2).max_log_std(k) for k in (0, 3, 9)]
    assert spreads == pytest.approx([-1.5, -3.5, -3.5])


@pytest.mark.slow
def test_two_trainings_are_the_same_bits_and_actions_scatter_less(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.guidance import train

    runs = [train(SMALL, tmp_path / name, 2, lambda run, seen: None) for name in ("one", "other")]
    files = [(tmp_path / name / "agent.npz").read_bytes() for name in ("one", "other")]
    assert files[0] == files[1]
    first, second = ([row | {"seconds": 0.0} for row in run.curve] for run in runs)
    assert len(first) == 2 and np.array_equal(
        [list(row.values()) for row in first], [list(row.values()) for row in second],
        equal_nan=True,
    )  # fmt: skip
    spread = runs[0].model.policy.log_std.detach().numpy()
    assert (spread < SMALL.final_log_std + 0.05).all()
    # Another seed is another agent.
    other = train(replace(SMALL, seed=1), tmp_path / "seed", 4, lambda run, seen: None)
    assert (other.out / "agent.npz").read_bytes() != files[0]


@pytest.mark.slow
def test_a_training_goes_on_bit_for_bit(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.guidance import TrainingRun, policy_network

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
    one, other = policy_network(whole.model), policy_network(second.model)
    for a, b in zip(one.weights + one.biases, other.weights + other.biases, strict=True):
        assert np.array_equal(a, b)
    assert not np.array_equal(one.weights[0], policy_network(first.model).weights[0])
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
def test_a_batch_is_what_stable_baselines3_takes(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from stable_baselines3.common.env_checker import check_env

    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    near = {"position_m": [0.0, 0.0, 40.0], "position_sigma_m": 0.0}
    env = Sb3VecEnv(batch(IDS[0], 8, autoreset_mode="SameStep"), [near, {}])
    env.seed(5)
    first = env.reset()
    assert (first[:4, 2] == 40.0).all() and (first[4:, 2] < 36.0).all()
    env.seed(5)
    assert np.array_equal(env.reset(), first)
    ends = 0
    for _ in range(120):
        env.step_async(np.tile(np.float32([0.1, 0.0, -0.6]), (8, 1)))
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
    """For all lanes or each its own, over `starts`; of the next reset alone."""
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    near, exact = {"position_m": [0.0, 0.0, 40.0]}, {"position_sigma_m": 0.0}
    env = Sb3VecEnv(batch(IDS[0], 4, autoreset_mode="SameStep"))
    env.reset()
    env.set_options(near | exact)
    assert (env.reset()[:, 2] == 40.0).all()
    assert (env.reset()[:, 2] < 36.0).all()
    own = [near | exact, {}, near | exact, {}]
    env.set_options(own)
    assert (env.reset()[:, 2] == 40.0).tolist() == [True, False, True, False]
    env = Sb3VecEnv(batch(IDS[0], 4, autoreset_mode="SameStep"), [near, {}])
    env.set_options(exact)
    seen = env.reset()
    assert (seen[:2, 2] == 40.0).all() and (seen[2:, 2] == 25.0).all()
    env.set_options({"positon_m": [0.0, 0.0, 40.0]})
    with pytest.raises(InputError, match="Did you mean 'position_m'"):
        env.reset()
    for wrong in ([near], [near, None, near, near]):
        env.set_options(wrong)
        with pytest.raises(InputError, match="set_options"):
            env.reset()


@pytest.mark.slow
def test_what_the_clock_cut_off_is_reported_as_truncated():
    """Learners take the value of the last state for what such a flight would have returned."""
    pytest.importorskip("stable_baselines3", reason="the extra `rl` is not installed")
    from lunarsim_envs.training.sb3_vec_env import Sb3VecEnv

    low = {"position_m": [0.0, 0.0, 40.0], "position_sigma_m": 0.0}
    falls = low | {"velocity_m_s": [0.0, 0.0, -30.0]}
    changes = LOW | {"simulation.max_time_s": 2.0}
    env = Sb3VecEnv(GuidanceVectorEnv(2, "SameStep", changes=changes), [low, falls])
    env.reset()
    ends = {}
    for _ in range(11):
        _, _, over, told = env.step(np.zeros((2, 3), np.float32))
        for lane in np.flatnonzero(over):
            ends.setdefault(int(lane), told[lane]["TimeLimit.truncated"])
    assert ends == {0: True, 1: False}
