"""The trained agents that come with the package."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from scipy.stats import binom

from lunarsim.errors import InputError
from lunarsim_envs.agents.network import Network
from lunarsim_envs.agents.registry import agent_of, known_agents, packaged_agents
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv
from lunarsim_envs.training.settings import PpoSettings
from tests.chance import CHANCE
from tests.low_descents import LOW

WIDE = PpoSettings().changes


def landed(agent, count, seed, env="Guidance-v1", **arguments):
    """Return the share of flights that end safe within 10 m, and what those burnt on average."""
    vector = gymnasium.make_vec(
        f"lunarsim_envs:lunarsim/{env}", num_envs=count, autoreset_mode="SameStep",
        vectorization_mode="vector_entry_point", **({"changes": WIDE} | arguments),
    )  # fmt: skip
    observation, _ = vector.reset(seed=seed)
    waiting, good, burnt = np.ones(count, bool), np.zeros(count, bool), np.zeros(count)
    while waiting.any():
        observation, _, ended, late, info = vector.step(agent(observation))
        over = (ended | late) & waiting
        if over.any():
            good[over] = info["safe"][over] & (info["miss_m"][over] <= 10.0)
            burnt[over] = info["propellant_kg"][over]
            waiting &= ~over
    return good.mean(), burnt[good].mean() if good.any() else np.nan


@pytest.fixture(scope="module")
def network():
    return Network.load(packaged_agents()["ppo"])


def test_it_lands_on_seeds_that_no_training_has(network):
    """0.880 of 1,000 flights do. Which flights depends on how a processor rounds."""
    share, burnt = landed(network, 500, 31)
    assert share >= binom.ppf(CHANCE, 500, 0.88) / 500
    assert 30.0 < burnt < 60.0


def test_the_agent_of_control_lands_in_worlds_that_no_training_has():
    """200 of 200 flights do (`lunarsim evaluate Control-v1 --agent ppo-control`)."""
    network = Network.load(packaged_agents()["ppo-control"])
    arguments = {"rate_hz": network.rate, "split": "test", "changes": {}}
    share, burnt = landed(network, 200, 31, "Control-v1", **arguments)
    assert network.rate == 10.0 and share >= binom.ppf(CHANCE, 200, 0.985) / 200
    assert 45.0 < burnt < 56.0
    blind = landed(lambda seen: network(np.zeros_like(seen)), 50, 31, "Control-v1", **arguments)
    assert blind[0] == 0.0


def test_it_is_what_lands_and_not_the_task(network):
    """The same network without its eyes, or with one layer undone, lands nowhere near as often."""
    blind = landed(lambda seen: network(np.zeros_like(seen)), 50, 31)[0]
    assert blind < 0.02
    last = network.weights[-1]
    other = Network(
        network.far, network.near, (*network.weights[:-1], -last), network.biases, network.level,
        network.parts, network.rate,
    )  # fmt: skip
    assert landed(other, 50, 31)[0] < 0.02


def test_it_is_small_and_flies_without_pytorch():
    assert known_agents()["ppo"] == "trained network"
    assert packaged_agents()["ppo"].stat().st_size < 1_000_000
    code = (
        "import sys\n"
        "from lunarsim_envs.agents.registry import agent_of\n"
        "from lunarsim_envs.descent.env import GuidanceEnv\n"
        f"env = GuidanceEnv(changes={LOW!r})\n"
        "seen, info = env.reset(seed=1)\n"
        "print(agent_of('ppo', env).act(seen, info).shape)\n"
        "print([name for name in ('torch', 'stable_baselines3') if name in sys.modules])\n"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert told.stdout == "(3,)\n[]\n"


def test_it_refuses_what_it_was_not_trained_for():
    for env, says in (
        (ControlEnv(changes=LOW), "needs Guidance-v1"),
        (GuidanceEnv(changes=LOW, rate_hz=12.5), "5 actions per second, or a multiple"),
        (GuidanceEnv(changes=LOW, rate_hz=2.5), "5 actions per second, or a multiple"),
        (GuidanceEnv(changes=LOW, observation=["position", "velocity"]), "observation components"),
    ):
        with pytest.raises(InputError, match=says):
            agent_of("ppo", env)


def test_a_faster_environment_holds_each_action(network):
    """At 10 Hz, every second observation is used; the next flight begins with its first one."""
    env = GuidanceEnv(changes=LOW, rate_hz=10.0)
    agent = agent_of("ppo", env)
    for seed, steps in ((1, 3), (2, 4)):
        agent.begin(np.random.default_rng(0))
        seen, info = env.reset(seed=seed)
        for step in range(steps):
            if step % 2 == 0:
                wanted = network(seen)
            action = agent.act(seen, info)
            assert np.array_equal(action, wanted)
            seen, *_, info = env.step(action)


def test_a_file_that_is_cut_short_is_refused(tmp_path):
    path = tmp_path / "cut.npz"
    path.write_bytes(packaged_agents()["ppo"].read_bytes()[:2000])
    with pytest.raises(InputError, match="a network trained with"):
        agent_of(str(path), GuidanceEnv(changes=LOW))
