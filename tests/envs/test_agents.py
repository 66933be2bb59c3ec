"""Agents by name, file and callable: what each does, and what each refuses."""

from __future__ import annotations

import io
import json
import zipfile
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.simulation import Simulation
from lunarsim_envs.agents import registry, sb3_agents
from lunarsim_envs.agents.network import Network
from lunarsim_envs.agents.registry import agent_of, known_agents, label
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv
from lunarsim_envs.descent.observations import DEFAULT, ObservationLayout, ObservationScaling
from lunarsim_envs.retarget import RetargetEnv
from tests.low_descents import LOW

CALM = {"start.position_sigma_m": 5.0, "start.velocity_sigma_m_s": 0.5}


@pytest.fixture(scope="module")
def env():
    return GuidanceEnv(changes=LOW)


def flown(env, agent, seed):
    """Return the last info, the return and the number of actions of one flight."""
    agent.begin(np.random.default_rng(seed))
    observation, info = env.reset(seed=seed)
    over, total, steps = False, 0.0, 0
    while not over:
        observation, reward, ended, late, info = env.step(agent.act(observation, info))
        over, total, steps = ended or late, total + reward, steps + 1
    return info, total, steps


def test_every_name_says_what_it_is():
    known = known_agents()
    assert {"zero", "random", "hover", "polynomial", "apollo", "safest"} <= set(known)
    assert label("out/here.npz") == "here" and label("a.b:C") == "C" and label("zero") == "zero"


def test_zero_and_hover_are_the_actions_of_their_names(env):
    hover = agent_of("hover", env)
    wanted = env.descents.actions.physical(hover.act(None, {}))[0]
    assert wanted == pytest.approx([0.0, 0.0, 1.622], abs=1e-6)
    assert not agent_of("zero", env).act(None, {}).any()
    control = ControlEnv(changes=LOW)
    thrust = control.descents.actions.physical(agent_of("hover", control).act(None, {}))[0]
    assert thrust == pytest.approx([1500.0 * 1.622, 0.0, 0.0, 0.0], abs=1e-3)
    assert agent_of("zero", RetargetEnv(perception="onboard")).act(None, {}) == 0
    with pytest.raises(InputError, match="needs Guidance-v1 or Control-v1"):
        agent_of("hover", RetargetEnv(perception="onboard"))


def test_random_draws_from_the_flights_own_generator(env):
    agent = agent_of("random", env)
    told = []
    for seed in (1, 1, 2):
        agent.begin(np.random.default_rng(seed))
        told.append(np.array([agent.act(None, {}) for _ in range(200)]))
    assert np.array_equal(told[0], told[1]) and not np.array_equal(told[0], told[2])
    assert told[0].dtype == np.float32
    assert np.abs(told[0]).max() <= 1.0 and told[0].min() < -0.95 and told[0].max() > 0.95
    retarget = agent_of("random", RetargetEnv(perception="onboard"))
    mask = np.zeros(21, np.int8)
    mask[[0, 3, 20]] = 1
    assert {int(retarget.act(None, {"action_mask": mask})) for _ in range(60)} == {0, 3, 20}


@pytest.mark.parametrize(
    ("kind", "off"), [("apollo", 0.5), ("modified-apollo", 0.5), ("zem-zev", 10.0)]
)
def test_a_guidance_law_lands_on_its_target(kind, off):
    env = GuidanceEnv(changes=CALM)
    info, _, steps = flown(env, agent_of(kind, env), 3)
    assert info["safe"] and info["miss_m"] < off
    assert 30.0 < info["propellant_kg"] < 70.0
    assert info["time_s"] == pytest.approx(0.2 * steps, abs=0.2)


def test_a_law_is_asked_with_what_is_observed():
    """Against the law itself, from the true state about the target."""
    env = GuidanceEnv(changes=CALM)
    agent = agent_of("apollo", env)
    agent.begin(np.random.default_rng(0))
    observation, info = env.reset(seed=5)
    y, target = env.descents.lanes.y[0], env.descents.lanes.target[0]
    agent.act(observation, info)
    approach = env.descents.scenario.approach.make()
    lander = env.descents.scenario.vehicle.make()
    here = Estimate(0.0, y[:3] - target, y[3:6], y[6:10], y[10:13], y[13], np.zeros((9, 9)))
    end = approach.end(np.zeros(3), lander)
    cost = ApolloLaw().cost(here, approach.end(np.zeros((1, 3)), lander), lander, 1.622,
                            approach.limits)  # fmt: skip
    law = ApolloLaw().build(_Briefed(), env.descents.scenario.control.make().response_time + 0.1)
    wanted = law.command(here, end, 0.0, float(cost.time_to_go[0]))
    told = env.descents.actions.physical(agent_of("apollo", env).act(observation, info))[0]
    assert told == pytest.approx(wanted, abs=1e-4)


class _Briefed:
    surface_gravity, nonuniform_gravity = 1.622, None


def test_a_law_forgets_the_last_flight(env):
    agent = agent_of("apollo", env)
    first = flown(env, agent, 11)[1:]
    flown(env, agent, 12)
    assert flown(env, agent, 11)[1:] == first


def test_a_policy_decides_as_in_the_simulation(small_scenario):
    env = RetargetEnv(scenario=small_scenario, perception="onboard")
    agent = agent_of("nearest-safe", env)
    env.reset(seed=4)
    seed = int(gymnasium.utils.seeding.np_random(4)[0].integers(2**62))
    simulation = Simulation(small_scenario, seed, "nearest-safe")
    simulation.run()
    info, *_ = flown(env, agent, 4)
    assert np.array_equal(env.simulation.state.position, simulation.state.position)
    assert info["safe"] == simulation.outcome.safe
    wet = small_scenario.vehicle.make().wet_mass
    assert info["propellant_kg"] == pytest.approx(wet - simulation.state.mass)


def test_policies_that_need_the_truth_are_refused():
    with pytest.raises(InputError, match="true hazard map"):
        agent_of("truth-oracle", RetargetEnv(perception="onboard"))


# --- networks ------------------------------------------------------------------------------------


SCALES = ObservationScaling(ObservationLayout(DEFAULT))


def network(parts=DEFAULT, **changes):
    rng = np.random.default_rng(7)
    shapes = [(5, 32), (4, 5), (3, 4)]
    layers = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    biases = [rng.normal(size=shape[0]).astype(np.float32) for shape in shapes]
    held = {
        "far": SCALES.far, "near": SCALES.near,
        "weights": tuple(layers), "biases": tuple(biases), "level": "Guidance-v1",
        "parts": tuple(parts), "rate": 5.0,
    }  # fmt: skip
    return Network(**(held | changes))


def plainly(net, observation):
    """Return the action for a scaled observation, number by number."""
    values = [float(x) for x in observation]
    for depth, (weight, bias) in enumerate(zip(net.weights, net.biases, strict=True)):
        told = [sum(float(w) * v for w, v in zip(row, values, strict=True)) + float(b)
                for row, b in zip(weight, bias, strict=True)]  # fmt: skip
        values = told if depth == len(net.weights) - 1 else [np.tanh(v) for v in told]
    return [min(max(v, -1.0), 1.0) for v in values]


def test_a_network_is_its_layers_and_comes_back_from_its_file(env, tmp_path):
    net = network()
    seen = np.random.default_rng(1).normal(0.0, 2.0, (6, 32)).astype(np.float32)
    for row in seen:
        assert net(row) == pytest.approx(plainly(net, row), abs=1e-4)
    assert net(seen) == pytest.approx(np.array([net(row) for row in seen]), abs=1e-5)
    net.save(tmp_path / "a.npz")
    again = agent_of(str(tmp_path / "a.npz"), env)
    assert np.array_equal(again.act(seen[0], {}), net(seen[0]))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as held:  # not one pickled object
        assert all(held[name].dtype != object for name in held.files)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"level": "Control-v1"}, "needs Control-v1"), ({"rate": 10.0}, "10 actions per second"),
        ({"parts": ("position",)}, "observation components position"),
        ({"weights": network().weights[:2], "biases": network().biases[:2]}, "actions with 4"),
        ({"far": np.ones(14, np.float32)}, "scales are missing"),
        ({"far": 2.0 * SCALES.far}, "scaled as in its training"),
        ({"near": 0.5 * SCALES.near}, "scaled as in its training"),
        ({"rate": 0.0}, "the action rate is 0 Hz"), ({"rate": np.nan}, "the action rate is nan"),
        ({"rate": 1e-9}, "the action rate is"), ({"rate": -5.0}, "the action rate is -5 Hz"),
        ({"biases": tuple(b[:, None] for b in network().biases)}, "weights of shape"),
        ({"weights": tuple(w * np.nan for w in network().weights)}, "not finite"),
        ({"weights": network().weights[1:], "biases": network().biases[1:]}, "weights of shape"),
    ],
    ids=str,
)  # fmt: skip
def test_a_network_that_does_not_fit_is_refused(env, tmp_path, changes, says):
    network(**changes).save(tmp_path / "b.npz")
    with pytest.raises(InputError, match=says):
        agent_of(str(tmp_path / "b.npz"), env)


def test_a_network_is_not_flown_on_observations_in_si_units(tmp_path):
    network().save(tmp_path / "b.npz")
    with pytest.raises(InputError, match="scaled as in its training"):
        agent_of(str(tmp_path / "b.npz"), GuidanceEnv(changes=LOW, scaled=False))


def test_a_network_of_the_format_before_is_refused(env, tmp_path):
    """Its input was the observation in SI units."""
    network().save(tmp_path / "b.npz")
    with np.load(tmp_path / "b.npz", allow_pickle=False) as held:
        arrays = dict(held) | {"format": np.array("lunarsim network 1")}
    np.savez(tmp_path / "b.npz", **arrays)
    with pytest.raises(InputError, match="must be lunarsim network 2, not lunarsim network 1"):
        agent_of(str(tmp_path / "b.npz"), env)


def test_a_file_with_pickled_objects_is_refused(env, tmp_path):
    np.savez(tmp_path / "c.npz", format=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="a network trained with"):
        agent_of(str(tmp_path / "c.npz"), env)


# --- callables and files of others ---------------------------------------------------------------

OWN = """
import numpy as np

def still(observation):
    return np.zeros(3, np.float32)

def told(observation, info):
    return np.full(3, info["at"], np.float32)

class Counting:
    def __init__(self, env):
        self.actions, self.begun = env.unwrapped.descents.actions, 0
    def begin(self, rng):
        self.begun += 1
    def __call__(self, observation):
        return self.actions.action([0.0, 0.0, self.begun])

class Whole:
    def __init__(self, env): pass
    def begin(self, rng): self.draw = rng.random()
    def act(self, observation, info): return self.draw

ready = Whole(None)
number = 5


class Alone:
    def __init__(self):
        pass


def wants_more(observation, info, more):
    return None
"""


def test_a_callable_of_ones_own_flies(env, tmp_path, monkeypatch):
    (tmp_path / "own_agents_here.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)

    def named(name):
        return agent_of(f"own_agents_here:{name}", env)

    assert not named("still").act(None, {}).any()
    assert named("told").act(None, {"at": 0.5}).tolist() == [0.5, 0.5, 0.5]
    counting = named("Counting")
    counting.begin(np.random.default_rng(0))
    counting.begin(np.random.default_rng(0))
    assert env.descents.actions.physical(counting.act(None, {}))[0, 2] == pytest.approx(2.0)
    for name in ("Whole", "ready"):
        whole = named(name)
        whole.begin(np.random.default_rng(3))
        assert whole.act(None, {}) == np.random.default_rng(3).random()
    with pytest.raises(InputError, match="a function, a class or a callable"):
        named("number")
    with pytest.raises(InputError, match="the environment as its only argument"):
        named("Alone")
    with pytest.raises(InputError, match="must accept"):
        named("wants_more")


def test_a_stored_agent_of_other_spaces_is_refused(tmp_path, monkeypatch):
    """Also where the shapes of a Dict or of discrete actions tell nothing."""

    def box(size):
        return gymnasium.spaces.Box(-1.0, 1.0, (size,))

    def fly(mine, own):
        model = SimpleNamespace(observation_space=mine[0], action_space=mine[1])
        _saved(tmp_path / "m.zip", "any")
        algorithm = SimpleNamespace(load=lambda path, device: model, __name__="PPO")
        monkeypatch.setattr(sb3_agents, "_algorithm", lambda path: algorithm)
        env = SimpleNamespace(observation_space=own[0], action_space=own[1])
        return sb3_agents.Sb3Agent(env, tmp_path / "m.zip", trust_pickle=True)

    one, two = (gymnasium.spaces.Dict(a=box(2), **more) for more in ({}, {"b": box(1)}))
    many = gymnasium.spaces.MultiDiscrete
    five, six = gymnasium.spaces.Discrete(5), gymnasium.spaces.Discrete(6)
    fly((two, five), (two, five))
    for mine, own, says in (
        ((one, five), (two, five), r"'b': 'Box\(1,\)'"),
        (
            (box(2), five),
            (box(3), five),
            r"observation space of this environment, Box\(3,\), not Box\(2,\)",
        ),
        ((one, five), (one, six), r"action space of .* Discrete\(6\), not Discrete\(5\)"),
        ((one, box(1)), (one, five), "action space"),
        ((one, many([5, 2])), (one, many([2, 5])), r"MultiDiscrete\(\[2, 5\]\), not MultiDiscrete"),
        ((one, five), (one, many([5, 2])), r"MultiDiscrete\(\[5, 2\]\), not Discrete\(5\)"),
    ):
        with pytest.raises(InputError, match=says):
            fly(mine, own)


def _saved(path, module):
    data = {"policy_class": {"__module__": module}}
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("data", json.dumps(data))


def test_files_of_stable_baselines3_are_distinguished(tmp_path, monkeypatch):
    asked = []

    def imported(name):
        asked.append(name)
        raise ImportError(name)

    monkeypatch.setattr(sb3_agents.importlib, "import_module", imported)
    for module, package in (
        ("stable_baselines3.common.policies", "stable_baselines3"),
        ("stable_baselines3.sac.policies", "stable_baselines3"),
        ("sb3_contrib.common.maskable.policies", "sb3_contrib"),
    ):  # fmt: skip
        _saved(tmp_path / "m.zip", module)
        with pytest.raises(InputError, match=f"needs the package {package}.*extra `rl`"):
            agent_of(str(tmp_path / "m.zip"), GuidanceEnv(changes=LOW), trust_pickle=True)
        assert asked[-1] == package
    _saved(tmp_path / "m.zip", "somebody.else")
    with pytest.raises(InputError, match=r"its policy is from somebody\.else"):
        agent_of(str(tmp_path / "m.zip"), GuidanceEnv(changes=LOW), trust_pickle=True)
    with zipfile.ZipFile(tmp_path / "n.zip", "w") as file:
        file.writestr("data", io.BytesIO(b"[]").getvalue())
    with pytest.raises(InputError, match="saved by Stable-Baselines3"):
        registry.agent_of(str(tmp_path / "n.zip"), GuidanceEnv(changes=LOW), trust_pickle=True)
