"""Costs for constrained reinforcement learning, beside values computed from the states."""

from __future__ import annotations

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim_envs.costs import COSTS, CostWrapper, StateCosts, VectorCostWrapper
from tests.envs.site_scene import SMALL

ID = "lunarsim_envs:lunarsim/"
PLAIN = Scenario.from_dict(
    {
        "name": "level",
        "approach": {"max_tilt_deg": 30.0, "glideslope_deg": 45.0, "reserve_kg": 20.0},
        "control": {"slew_limit_deg_s": 10.0},
        "vehicle": {"com_height_m": 2.0},
    }
)


def costs_of(offset=(0.0, 0.0, 100.0), tilt_deg=0.0, rate=(0.0, 0.0, 0.0), left=100.0, p=None):
    half = np.deg2rad(tilt_deg) / 2.0
    attitude = np.array([[0.6 * np.sin(half), 0.8 * np.sin(half), 0.0, np.cos(half)]])
    p_safe = None if p is None else np.array([p])
    found = StateCosts(PLAIN).of(
        np.array([offset]), attitude, np.deg2rad([rate]), np.array([left]), p_safe
    )
    return {name: float(value[0]) for name, value in found.items()}


@pytest.mark.parametrize(
    ("state", "name", "cost"),
    [
        ({"tilt_deg": 29.9}, "tilt", 0.0),
        ({"tilt_deg": 45.0}, "tilt", 0.5),
        ({"tilt_deg": 180.0}, "tilt", 5.0),
        ({"rate": (3.0, -9.9, 1.0)}, "rate", 0.0),
        ({"rate": (3.0, -12.0, 1.0)}, "rate", 0.2),
        ({"left": 20.0}, "reserve", 0.0),
        ({"left": 5.0}, "reserve", 0.75),
        ({"offset": (60.0, 0.0, 52.1)}, "glideslope", 0.0),
        ({"offset": (36.0, 48.0, 27.0)}, "glideslope", 0.5),
        ({"offset": (0.0, -60.0, -30.0)}, "glideslope", 1.0),
        ({"offset": (9.0, 0.0, 2.0)}, "glideslope", 0.0),
        ({"p": 0.9}, "hazard", 0.1),
        ({"p": np.nan}, "hazard", 1.0),
    ],
)
def test_a_state_costs_its_excess_over_a_limit(state, name, cost):
    found = costs_of(**state)
    assert found.pop(name) == pytest.approx(cost, abs=1e-9)
    assert not any(found.values())


def test_a_control_without_a_limit_of_the_rate_has_no_cost_of_the_rate():
    free = SimpleNamespace(make=SimpleNamespace)
    scenario = SimpleNamespace(approach=PLAIN.approach, vehicle=PLAIN.vehicle, control=free)
    assert StateCosts(scenario).max_rate == np.inf


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("Guidance-v1", {}),
        ("Control-v1", {"rate_hz": 10.0}),
        ("Retarget-v1", {"scenario": SMALL, "perception": "truth", "worlds": 1}),
    ],
)
def test_vector_costs_are_those_of_single_environments(name, settings):
    """Random actions; also at the end and in the step of an automatic reset."""
    chosen = ("tilt", "unsafe", "hazard")
    many = VectorCostWrapper(
        gymnasium.make_vec(
            ID + name, num_envs=3, vectorization_mode="vector_entry_point", **settings
        ),
        chosen,
    )
    ones = [CostWrapper(gymnasium.make(ID + name, **settings), chosen) for _ in range(3)]
    many.reset(seed=5)
    many.action_space.seed(1)
    for i, one in enumerate(ones):
        one.reset(seed=5 + i)
    over, ends, seen = np.zeros(3, bool), 0, dict.fromkeys(COSTS, 0.0)
    for _ in range(700):
        actions = many.action_space.sample()
        _, _, costs, terminated, truncated, info = many.step(actions)
        assert set(info["costs"]) == set(COSTS)
        for i, one in enumerate(ones):
            if over[i]:
                assert costs[i] == 0.0 and not info["_costs"][i]
                one.reset()
                over[i] = False
                continue
            _, _, cost, ended, _, own_info = one.step(actions[i])
            assert cost == costs[i]
            assert own_info["costs"] == {name: value[i] for name, value in info["costs"].items()}
            assert cost == sum(own_info["costs"][key] for key in chosen)
            assert own_info["costs"]["unsafe"] == float(ended and not own_info["safe"])
            seen = {key: max(seen[key], own_info["costs"][key]) for key in COSTS}
            over[i] = ended
            ends += ended
        assert np.array_equal(terminated | truncated, over)
        if ends >= 4:
            break
    assert ends >= 4
    if name == "Retarget-v1":
        assert 0.0 < seen["hazard"] <= 1.0
    else:
        assert seen["tilt" if name == "Control-v1" else "glideslope"] > 0.0
        assert seen["hazard"] == 0.0


def test_costs_of_a_descent_are_those_of_its_observation():
    """Thrust with a torque, and 10 kg above a reserve of 30 kg at the start."""
    changes = {
        "approach.reserve_kg": 30.0,
        "vehicle.propellant_mass_kg": 40.0,
        "approach.max_tilt_deg": 20.0,
        "control.slew_limit_deg_s": 5.0,
    }
    plain = gymnasium.make(ID + "Control-v1", scaled=False, changes=changes, rate_hz=10.0)
    env, limits = CostWrapper(plain), StateCosts(plain.unwrapped.descents.scenario)
    env.reset(seed=3)
    seen, over = dict.fromkeys(COSTS, 0.0), False
    while not over:
        shown, _, _, over, _, info = env.step([0.6, 0.2, 0.0, 0.0])
        found = limits.of(
            shown[None, :3], shown[None, 6:10], shown[None, 10:13], shown[None, 14], None
        )
        for name, value in found.items():
            assert info["costs"][name] == pytest.approx(value[0], abs=1e-4)
        seen = {name: max(seen[name], info["costs"][name]) for name in COSTS}
    assert all(seen[name] > 0.1 for name in COSTS if name != "hazard")


@pytest.mark.parametrize("perception", ["onboard", "truth"])
def test_costs_of_site_decisions_are_those_of_the_flight(perception):
    """With limits that every flight exceeds; after a divert about the new site."""
    settings = {"scenario": SMALL, "perception": perception, "worlds": 1}
    env = CostWrapper(gymnasium.make(ID + "Retarget-v1", **settings), ["hazard"])
    env.limits.max_tilt, env.limits.max_rate, env.limits.reserve = 1e-3, 1e-6, 1e4
    env.limits.slope = 50.0
    observation, info = env.reset(seed=1)
    flight, moved = env.unwrapped.flight, False
    for _ in range(6):
        free = np.flatnonzero(info["action_mask"][1:])
        action = 1 + int(free[-1]) if len(free) and not moved else 0
        moved = moved or action > 0
        observation, _, cost, over, _, info = env.step(action)
        if over:
            break
        if perception == "onboard":
            state, dry = env.unwrapped.simulation.state, env.unwrapped.simulation.lander.dry_mass
            attitude, rate, left = state.attitude, state.rate, state.mass - dry
        else:
            y = flight.lanes.y[0]
            attitude, rate, left = (
                y[6:10],
                y[10:13],
                y[13] - env.unwrapped.scenario.vehicle.make().dry_mass,
            )
        inputs, costs = flight.inputs, info["costs"]
        offset = (inputs.position - inputs.site)[0]
        cone = 50.0 * (np.hypot(*offset[:2]) - 10.0)
        height = offset[2] - env.limits.com_height
        here = flight.inputs.here[0, 0]
        assert cost == costs["hazard"] == (1.0 if np.isnan(here) else 1.0 - here)
        assert costs["glideslope"] == pytest.approx(1.0 - height / cone)
        tilt = np.arccos(1.0 - 2.0 * (attitude[0] ** 2 + attitude[1] ** 2))
        assert costs["tilt"] == pytest.approx(tilt / 1e-3 - 1.0)
        assert costs["rate"] == pytest.approx(np.abs(rate).max() / 1e-6 - 1.0)
        assert costs["reserve"] == pytest.approx(1.0 - left / 1e4)
    assert moved
    env.close()


def test_a_truncated_flight_is_unsafe():
    env = CostWrapper(gymnasium.make(ID + "Guidance-v1", max_episode_steps=2))
    env.reset(seed=1)
    assert [env.step([0.0, 0.0, 0.1])[2] for _ in range(2)] == [0.0, 1.0]
    many = gymnasium.make_vec(
        ID + "Guidance-v1", num_envs=2, vectorization_mode="vector_entry_point",
        max_episode_steps=2,
    )  # fmt: skip
    batch = VectorCostWrapper(many)
    batch.reset(seed=1)
    costs = [batch.step(np.full((2, 3), 0.1))[2].tolist() for _ in range(3)]
    assert costs == [[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]]


def test_the_step_of_an_automatic_reset_costs_nothing():
    inner = gymnasium.make(ID + "Guidance-v1", max_episode_steps=1)
    env = CostWrapper(gymnasium.wrappers.Autoreset(inner), COSTS)
    env.reset(seed=1)
    steps = [env.step([0.0, 0.0, 0.1]) for _ in range(2)]
    assert steps[0][2] == 1.0
    assert steps[1][5]["costs"] == dict.fromkeys(COSTS, 0.0)


def test_wrong_arguments_are_refused():
    env = gymnasium.make(ID + "Guidance-v1")
    with pytest.raises(InputError, match=r"costs.1.*tilts.*tilt"):
        CostWrapper(env, ["unsafe", "tilts"])
    with pytest.raises(InputError, match="one or more names"):
        CostWrapper(env, [])
    with pytest.raises(InputError, match="must be a list of names"):
        CostWrapper(env, 3)
    with pytest.raises(InputError, match="one or more names"):
        CostWrapper(env, ["tilt", "tilt"])
    with pytest.raises(InputError, match="must be an environment of lunarsim_envs"):
        CostWrapper(gymnasium.make("CartPole-v1"))
    with pytest.raises(InputError, match="NextStep"):
        VectorCostWrapper(
            gymnasium.make_vec(
                ID + "Guidance-v1", num_envs=2, vectorization_mode="vector_entry_point",
                autoreset_mode="SameStep",
            )
        )  # fmt: skip
    with pytest.raises(InputError, match="must be a vector environment of lunarsim_envs"):
        VectorCostWrapper(gymnasium.make_vec("CartPole-v1", num_envs=2))
