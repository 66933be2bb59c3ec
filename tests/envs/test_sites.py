"""Retarget-v1 flown by kernels: its spaces, seeds, batches, perceptions and agents."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lunarsim.errors import InputError
from lunarsim_envs.agents.registry import agent_of
from lunarsim_envs.agents.site_network import SiteNetwork
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.sites import observations
from lunarsim_envs.sites.perception import KERNELS
from lunarsim_envs.sites.site_features import site_features
from lunarsim_envs.training.sites import CemSettings, fly_networks, initial_network, train
from tests.envs.site_scene import SMALL, lanes, made_up

ID = "lunarsim_envs:lunarsim/Retarget-v1"
EVERY = tuple(observations.PARTS)


def made(perception="surrogate", **settings):
    given = {
        "scenario": SMALL, "perception": perception, "worlds": 2, "world_seed": 5,
        "surrogate": made_up(),
    } | settings  # fmt: skip
    return gymnasium.make(ID, **given)


def episode(env, seed, row=0):
    """Return all that an episode shows: rewards and observations."""
    observation, info = env.reset(seed=seed)
    out, ended = [{k: v.copy() for k, v in observation.items()}], False
    while not ended:
        good = np.flatnonzero(info["action_mask"])
        observation, reward, ended, truncated, info = env.step(good[min(row, len(good) - 1)])
        assert not truncated and reward == pytest.approx(sum(info["reward_terms"].values()))
        out.append({k: v.copy() for k, v in observation.items()} | {"reward": np.array(reward)})
    return out, info


def same(a, b):
    return len(a) == len(b) and all(
        all(np.array_equal(x[k], y[k]) for k in x) for x, y in zip(a, b, strict=True)
    )


@pytest.mark.parametrize("perception", KERNELS)
def test_check_env_without_a_warning(perception):
    env = made(perception, observation=EVERY)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)


@pytest.mark.parametrize("perception", KERNELS)
def test_same_seed_same_episode_in_any_order(perception):
    env = made(perception)
    first, info = episode(env, 4, row=2)
    episode(env, 9)
    again, _ = episode(env, 4, row=2)
    assert same(first, again)
    assert not same(first, episode(env, 5, row=2)[0])
    assert set(info) >= {"safe", "failure_causes", "propellant_kg", "cost", "time"}
    assert info["cost"] == float(not info["safe"])


def test_another_process_flies_the_same():
    words = (
        "import numpy as np\n"
        "from tests.envs.test_sites import episode, made\n"
        "out, info = episode(made(), 4, row=2)\n"
        "print(repr(float(info['propellant_kg'])), repr(float(out[3]['sites'].sum())))"
    )
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    out, info = episode(made(), 4, row=2)
    wanted = f"{float(info['propellant_kg'])!r} {float(out[3]['sites'].sum())!r}"
    assert done.stdout.strip() == wanted


@pytest.mark.parametrize("action", [("site",), ("site", "time_scale")])
def test_a_lane_flies_what_one_environment_flies(action):
    rng = np.random.default_rng(2)
    settings = {
        "scenario": SMALL, "worlds": 2, "world_seed": 5, "surrogate": made_up(),
        "observation": EVERY, "action": action,
    }  # fmt: skip
    batch = gymnasium.make_vec(
        ID, num_envs=3, vectorization_mode="vector_entry_point", autoreset_mode="SameStep",
        **settings,
    )  # fmt: skip
    assert isinstance(batch, RetargetVectorEnv)
    one = made(observation=EVERY, action=action)
    told, info = batch.reset(seed=20)
    assert batch.observation_space.contains(told)
    lane, flights, refused = 1, 0, []
    alone, _ = one.reset(seed=20 + lane)
    while flights < 2:
        assert all(np.array_equal(told[k][lane], alone[k]) for k in alone)
        actions = np.array([np.flatnonzero(mask[:21])[-1] for mask in info["action_mask"]])
        if len(action) > 1:
            actions = np.column_stack((actions, rng.integers(5, size=3)))
        told, rewards, ended, _, info = batch.step(actions)
        alone, reward, over, _, told_alone = one.step(actions[lane])
        assert rewards[lane] == pytest.approx(reward, rel=1e-12) and ended[lane] == over
        if len(action) > 1:
            refused.append(told_alone["time_scale_refused"])
            assert info["time_scale_refused"][lane] == refused[-1]
        if over:
            flights += 1
            assert info["final_info"]["safe"][lane] == told_alone["safe"]
            assert all(np.array_equal(info["final_obs"][k][lane], alone[k]) for k in alone)
            alone, _ = one.reset()
    assert len(set(refused)) == len(action) * (len(action) > 1)


def test_batches_restart_as_asked_and_refuse_the_rest():
    env = RetargetVectorEnv(
        2, "Disabled", SMALL, worlds=2, world_seed=5, surrogate=made_up(), observation=["to_go"]
    )
    env.reset(seed=[3, None])
    while not (env.lanes.ended != 0).all():
        try:
            env.step(np.zeros(2, int))
        except gymnasium.error.ResetNeeded:
            break
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2, int))
    first = env.lanes.y[1].copy()
    env.reset(options={"reset_mask": np.array([True, False])})
    assert env.lanes.ended[0] == 0 and np.array_equal(env.lanes.y[1], first)
    for wrong in (np.zeros(3, int), np.zeros(2), np.array([0, 21]), np.array([-1, 0])):
        with pytest.raises(ValueError, match="action"):
            env.step(wrong)
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": np.zeros(2, bool)})
    with pytest.raises(InputError, match="onboard"):
        RetargetVectorEnv(2, scenario=SMALL, perception="onboard")


def test_parts_say_what_they_are():
    env = made(observation=EVERY)
    observation, info = env.reset(seed=1)
    while not info["action_mask"][1:].any():
        observation, *_, info = env.step(0)
    s = env.unwrapped.flight.inputs
    sites, candidates = observation["sites"], observation["candidates"]
    n = int(s.count[0])
    assert n > 5 and not sites[n:].any() and not candidates[n:].any()
    assert np.array_equal(sites[:n, 5] == 1.0, info["action_mask"][1 : n + 1] == 1)
    k = int(np.flatnonzero(sites[:n, 5])[0])
    assert candidates[k, :3] == pytest.approx(sites[k, [0, 1, 3]])
    assert candidates[k, 3] == pytest.approx(sites[k, 4] - observation["site"][2], abs=1e-3)
    assert candidates[k, 4] == pytest.approx(np.hypot(*sites[k, :2]), rel=1e-5)
    features = observation["site_features"]
    p = np.clip([observation["site"][0], candidates[k, 2]], 1e-6, 0.999)
    assert features[[0, k + 1], 0] == pytest.approx(np.log(p / (1.0 - p)) / 5.0, rel=1e-4)
    assert features[k + 1, 1:5] == pytest.approx(
        [candidates[k, 3] / 2.0, candidates[k, 4] / 30.0, 0.0, 1.0], rel=1e-3, abs=1e-3
    )
    assert features[0, 1:4].tolist() == [0.0, 0.0, 1.0]
    assert features[:, 5] == pytest.approx(observation["to_go"][2] / 200.0, rel=1e-5)
    assert features[:, 6] == pytest.approx(observation["site"][3], rel=1e-5)
    allowed = features[info["action_mask"].astype(bool), 7]
    assert allowed.max() == 0.0 and (allowed <= 0.0).all()
    crop = observation["hazard_crop"]
    seen = env.unwrapped.seen
    for a, b in ((16, 16), (3, 30)):
        xy = seen.site[:2] + (b - 16.0, a - 16.0)
        assert crop[0, a, b] == pytest.approx(seen.hazard_map.p_safe_at(xy), abs=1e-6)
    assert 0.0 < crop[1].mean() <= 1.0
    small = observation["hazard_map"]
    assert small[1].mean() == pytest.approx(seen.hazard_map.observed.mean(), abs=0.03)
    assert small[0].mean() == pytest.approx(seen.hazard_map.p_safe.mean(), abs=0.03)
    for part in observations.PARTS.values():
        assert part.meaning and len(part.units) in (1, part.shape[-1])


def test_a_part_of_ones_own():
    name = "site_east"
    own = observations.SiteObservationComponent(
        name, (1,), ("m",), -9e3, 9e3, "east of the present site", lambda s: s.site[:, :1]
    )
    observations.register(own)
    try:
        env = made(observation=[name])
        observation, _ = env.reset(seed=1)
        assert observation[name] == pytest.approx(env.unwrapped.flight.inputs.site[0, :1])
        with pytest.raises(InputError, match="name of a registered component"):
            observations.register(own)
    finally:
        del observations.PARTS[name]


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"perception": "thruth"}, "truth"),
        ({"observation": ["site", "site"]}, "only once"),
        ({"observation": ["hazards"]}, "hazard"),
        ({"worlds": 0}, "worlds"),
        ({"changes": {"guidance.kind": "gravity-turn"}}, "guidance"),
        ({"changes": {"sensors.flash.half_fov_tangent": 0.2}}, "surrogate"),
        ({"changes": {"tasking.flash.altitudes_m": [170.0]}}, "surrogate"),
        ({"surrogate": "no/such.npz"}, "no/such.npz"),
    ],
)
def test_what_cannot_be_is_refused(settings, word):
    with pytest.raises(InputError, match=word):
        made(**settings)


def test_options_say_where_flights_start_and_others_are_refused():
    env = made()
    env.reset(seed=1, options={"position_m": [-150.0, 0.0, 150.0], "position_sigma_m": 0.0})
    place = env.unwrapped.flight.inputs
    assert place.position[0, 2] < 152.0
    with pytest.raises(InputError, match="position_m"):
        env.reset(options={"position": [1.0, 2.0, 3.0]})
    with pytest.raises(ValueError, match="action"):
        env.step(21)


def test_the_truth_is_reported_as_it_is():
    many = lanes(8, perception="truth")
    while (many.ended == 0).any():
        seen = np.isfinite(many.candidates.here[:, 0])
        sites = np.where(seen[:, None], np.nan, np.nan) * np.ones((8, 3))
        good = many.candidates.number > 0
        sites[good] = many.candidates.position[good, 0]
        many.decide(sites, np.ones(8, bool))
    assert many.safe.all() and (many.miss < 100.0).all()


_FORKED = """
import sys
import gymnasium, lunarsim_envs, numba
if __name__ == "__main__":
    from tests.envs.test_sites import SMALL
    @numba.njit(parallel=True)
    def sums(n):
        total = 0.0
        for k in numba.prange(n):
            total += k
        return total
    sums(100)
    env = gymnasium.make_vec(
        "lunarsim/Retarget-v1", num_envs=1, vectorization_mode="async", scenario=SMALL,
        perception="onboard", vector_kwargs={"context": sys.argv[1]},
    )
    env.reset(seed=1)
    env.step([0])
    env.close()
    print("flown")
"""


def test_a_forked_worker_that_would_die_says_what_to_type(tmp_path):
    """And a spawned one flies."""
    path = tmp_path / "forked.py"
    path.write_text(_FORKED)
    done = [
        subprocess.run(
            [sys.executable, str(path), context], capture_output=True, text=True, check=False,
            timeout=240, env=os.environ | {"PYTHONPATH": str(Path.cwd())},
        )
        for context in ("fork", "spawn")
    ]  # fmt: skip
    assert "flown" not in done[0].stdout and '"context": "spawn"' in done[0].stderr
    assert done[1].stdout.split() == ["flown"], done[1].stderr


# --- agents -----------------------------------------------------------------------------------


def test_a_network_of_sites_chooses_saves_and_flies(tmp_path):
    network = initial_network(3)
    network.save(tmp_path / "own.npz")
    again = SiteNetwork.load(tmp_path / "own.npz")
    assert np.array_equal(again.flat, network.flat)
    assert np.array_equal(SiteNetwork.of(network.flat, 3).inner, network.inner)
    env = made()
    agent = agent_of(str(tmp_path / "own.npz"), env)
    observation, info = env.reset(seed=3)
    ended, moved = False, 0
    while not ended:
        sights = env.unwrapped.flight.inputs
        x, good = site_features(sights)
        assert np.array_equal(good[0], info["action_mask"] == 1)
        action = agent.act(observation, info)
        worth = np.where(good[0], x[0] @ network.linear, -np.inf)
        assert action == worth.argmax()
        moved += action > 0
        observation, _, ended, _, info = env.step(action)
    assert moved > 0
    with pytest.raises(InputError, match="Retarget-v1"):
        agent_of(str(tmp_path / "own.npz"), gymnasium.make("lunarsim/Guidance-v1"))
    np.savez(tmp_path / "wrong.npz", format="lunarsim site network 1", linear=np.zeros(2))
    with pytest.raises(InputError, match="wrong"):
        SiteNetwork.load(tmp_path / "wrong.npz")


def test_training_keeps_the_networks_with_the_highest_worth():
    """In the first generation, the best network is worth more than the mean of all networks."""
    worth, weight = [], CemSettings.propellant_weight
    for elite in (1, 6):
        settings = CemSettings(
            hidden=2, population=6, elite=elite, flights=8, generations=1, spread=2.0
        )
        train(
            lanes(48), settings,
            lambda _, safe, burnt, sigma: worth.append(safe - weight * burnt),
        )  # fmt: skip
    assert worth[0] > worth[1] + 1e-6


def test_training_flies_every_lane_by_its_own_network_and_is_the_same_again():
    settings = CemSettings(hidden=2, population=3, elite=1, flights=2, generations=2)
    many = lanes(6)
    told = []
    first = train(many, settings, lambda *row: told.append(row))
    assert [row[0] for row in told] == [0, 1]
    second = train(lanes(6), settings, lambda *row: None)
    assert np.array_equal(first.flat, second.flat)
    keys = np.arange(1, 7, dtype=np.uint64)
    stay = initial_network(2)
    stay.linear[3] = 1e6
    weights = np.repeat(initial_network(2).flat[None], 6, axis=0)
    weights[:3] = stay.flat
    fly_networks(many, keys, weights, 2)
    kept = np.linalg.norm(many.guidance.site[:, :2] - many.target[:, :2], axis=1) < 1e-6
    assert kept[:3].all() and not kept[3:].all()
