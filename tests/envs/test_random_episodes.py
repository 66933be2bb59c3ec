"""A thousand episodes under random actions: nothing is raised, not a number or out of its space."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import lunarsim_envs

assert lunarsim_envs.__name__

EPISODES = 1000


def parts(shown):
    return shown if isinstance(shown, dict) else {"": shown}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "lanes", "settings"),
    [
        ("Guidance-v1", 500, {"changes": {"rocks.cover": 0.05}, "worlds": 4}),
        ("Guidance-v1", 500, {"changes": {"domain_randomization.engine_failure": 0.5}}),
        ("Control-v1", 500, {}),
        ("Retarget-v1", 50, {"perception": "truth", "worlds": 8}),
        (
            "Retarget-v1", 50,
            {"perception": "truth", "worlds": 8, "action": ("site", "time_scale")},
        ),
        ("Retarget-v1", 50, {"perception": "surrogate", "worlds": 8, "scenario": "few_sites"}),
    ],
)  # fmt: skip
def test_a_thousand_random_episodes(name, lanes, settings):
    vector = gymnasium.make_vec(
        f"lunarsim/{name}", num_envs=lanes, vectorization_mode="vector_entry_point", **settings
    )
    spaces = parts(
        vector.observation_space.spaces
        if isinstance(vector.observation_space, gymnasium.spaces.Dict)
        else vector.observation_space
    )
    shown, _ = vector.reset(seed=5)
    vector.action_space.seed(5)
    done, returns = 0, np.zeros(lanes)
    while done < EPISODES:
        shown, reward, terminated, truncated, info = vector.step(vector.action_space.sample())
        for part, value in parts(shown).items():
            assert value.dtype == np.float32
            assert (value >= spaces[part].low).all() and (value <= spaces[part].high).all(), part
        assert np.isfinite(reward).all()
        terms = info["reward_terms"]
        assert np.allclose(sum(terms.values()), reward, rtol=0.0, atol=1e-12)
        # Without shaping, whose sum depends on the start.
        returns += reward - terms["shaping"]
        over = terminated | truncated
        if over.any():
            low, high = (-3.0, 1.0) if name == "Retarget-v1" else (-15.8, 10.0)
            assert ((returns[over] > low) & (returns[over] <= high)).all()
            assert returns[over] == pytest.approx(info["score"][over], abs=1e-9)
        returns[over] = 0.0
        done += int(over.sum())
    vector.close()
