"""Recorded episodes: read by Minari and replayed."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest
from click.testing import CliRunner

import lunarsim_envs
from lunarsim.scenario import Scenario
from tests.worlds import SMALL_FLIGHT

assert lunarsim_envs.__name__


def recorded(script, *given):
    return CliRunner().invoke(script("learning", "record_episodes").main, list(map(str, given)))


def same(first, second):
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for name in first:
            same(first[name], second[name])
    else:
        assert np.array_equal(first, second)


@pytest.mark.parametrize(
    ("env", "agent", "more", "settings"),
    [
        ("Guidance-v1", "apollo", (), {}),
        (
            "Retarget-v1", "random", ("--perception", "truth", "--scenario", "small.toml"),
            {"perception": "truth", "scenario": "small.toml", "worlds": 16},
        ),
        (
            "Guidance-v1", "random", ("--observation", "position", "--observation", "time_left"),
            {"observation": ("position", "time_left")},
        ),
        (
            "Retarget-v1", "random",
            ("--perception", "truth", "--scenario", "small.toml", "--action", "time_scale",
             "--action", "site"),
            {"perception": "truth", "scenario": "small.toml", "action": ("time_scale", "site"),
             "worlds": 16},
        ),
    ],
)  # fmt: skip
def test_recorded_episodes_can_be_replayed(
    script, tmp_path, monkeypatch, env, agent, more, settings
):
    # With a relative path, as in the documentation.
    monkeypatch.chdir(tmp_path)
    Scenario.from_dict(SMALL_FLIGHT).save("small.toml")
    out = Path("new/some")
    done = recorded(script, env, "--agent", agent, "--episodes", 2, "--out", out, *more)
    assert done.exit_code == 0, done.output
    data = minari.MinariDataset(out)
    assert data.total_episodes == 2
    again = gymnasium.make(f"lunarsim/{env}", **settings)
    for one, told in zip(data, data.storage.get_episode_metadata([0, 1]), strict=True):
        shown, _ = again.reset(seed=int(told["seed"]))
        steps = [shown]
        for k, action in enumerate(one.actions):
            shown, reward, over, late, info = again.step(action)
            steps.append(shown)
            assert reward == one.rewards[k]
            assert (over, late) == (one.terminations[k], one.truncations[k])
            assert info["cost"] == one.infos["cost"][k + 1]
            terms = one.infos["reward_terms"]
            assert info["reward_terms"] == {name: terms[name][k + 1] for name in terms}
        assert over or late
        assert told["safe"] == (info["reward_terms"]["touchdown"] > 0.0)
        assert told["steps"] == len(one.actions)
        if isinstance(shown, dict):
            same(one.observations, {n: np.stack([s[n] for s in steps]) for n in shown})
        else:
            same(one.observations, np.stack(steps))


@pytest.mark.parametrize(
    ("given", "word"),
    [
        (("Guidance-v1", "--agent", "appollo"), "--agent"),
        (("Guidance-v1", "--perception", "truth"), "--perception"),
        (("Retarget-v1", "--perception", "trooth"), "perception"),
        (("Guidance-v1", "--agent", "safest"), "--agent"),
        (("Guidance-v1", "--action", "time_scale"), "--action"),
        (("Retarget-v1", "--action", "time_scal"), "Did you mean 'time_scale'"),
        (("Retarget-v1", "--set", "rocks.cover=2"), "rocks.cover"),
        (("Guidance-v1", "--episodes", "0"), "--episodes"),
    ],
)
def test_invalid_requests_are_rejected_without_output(script, tmp_path, given, word):
    out = tmp_path / "some"
    done = recorded(script, *given, "--out", out)
    assert done.exit_code == 2, done.output
    assert word in done.output
    assert not out.exists()


def test_existing_folders_are_not_overwritten(script, tmp_path):
    done = recorded(script, "Guidance-v1", "--out", tmp_path)
    assert done.exit_code == 2 and "must be a new folder" in done.output


@pytest.mark.parametrize(
    ("env", "agent", "weights", "safe"),
    [
        (
            "Guidance-v1", "hover",
            ("safe=9", "crash=2", "no_landing=1", "severity=0", "excess=0", "propellant=0"), 0,
        ),
        ("Guidance-v1", "apollo", ("safe=-1", "crash=-8", "no_landing=-20"), 1),
    ],
)  # fmt: skip
def test_safe_flag_is_the_landing_outcome_for_any_reward(
    script, tmp_path, env, agent, weights, safe
):
    more = [word for one in weights for word in ("--set", f"descent_reward.{one}")]
    out = tmp_path / "some"
    done = recorded(script, env, "--agent", agent, "--episodes", 1, "--out", out, *more)
    assert done.exit_code == 0 and f"1 episodes, {safe} safe landings" in done.output
    (told,) = minari.MinariDataset(out).storage.get_episode_metadata([0])
    assert told["safe"] == safe


def test_invalid_actions_are_attributed_to_the_agent(script, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("agent_of_nans.py").write_text(
        "import numpy as np\ndef nans(shown):\n    return np.full(3, np.nan)\n"
    )
    done = recorded(script, "Guidance-v1", "--agent", "agent_of_nans:nans", "--out", "some")
    assert done.exit_code == 2 and "must return valid actions" in done.output
    assert not Path("some").exists()
