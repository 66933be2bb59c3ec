"""Environments whose flights draw their landers: what is told, what is late, what is noise."""

from __future__ import annotations

import copy

import gymnasium
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.vehicle.domain_randomization import RANDOM_QUANTITIES
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv
from tests.low_descents import IDS, LOW

VARIED = LOW | {
    "domain_randomization.payload_kg": 50.0, "domain_randomization.thrust_scale": 0.03,
    "domain_randomization.thrust_offset_m": 0.002,
    "domain_randomization.position_noise_m": 0.5, "domain_randomization.attitude_noise_deg": 1.0,
    "domain_randomization.sensing_delay_s": 0.6, "domain_randomization.actuation_delay_s": 0.4,
}  # fmt: skip


def varied(count=4, mode="NextStep", **more):
    """Return so many lanes in one batch."""
    return gymnasium.make_vec(
        f"lunarsim_envs:{IDS[0]}", num_envs=count, vectorization_mode="vector_entry_point",
        autoreset_mode=mode, changes=VARIED | more, privileged=True,
    )  # fmt: skip


def only(**keys):
    """Return one environment that has these alone, with all kept back from no one."""
    changes = LOW | {f"domain_randomization.{key}": value for key, value in keys.items()}
    return GuidanceEnv(changes=changes, privileged=True, scaled=False)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_lane_is_one_environment_bit_for_bit(mode):
    vector = varied(mode=mode)
    seen, info = vector.reset(seed=3)
    ones = [GuidanceEnv(changes=VARIED, privileged=True) for _ in range(4)]
    first = [one.reset(seed=3 + i) for i, one in enumerate(ones)]
    assert np.array_equal(seen, [one[0] for one in first])
    rng, due, ended = np.random.default_rng(1), [False] * 4, 0
    for _ in range(90):
        actions = rng.uniform([-0.3, -0.3, -0.8], [0.3, 0.3, -0.2], (4, 3)).astype(np.float32)
        seen, reward, over, late, info = vector.step(actions)
        for i, one in enumerate(ones):
            if due[i]:
                own, told = one.reset()
                due[i] = False
            else:
                own, earned, *ends, told = one.step(actions[i])
                assert earned == reward[i] and ends == [over[i], late[i]]
                due[i] = any(ends)
                ended += due[i]
                if due[i] and mode == "SameStep":
                    assert np.array_equal(info["final_obs"][i], own)
                    assert (
                        info["final_info"]["randomized"]["payload_kg"][i]
                        == told["randomized"]["payload_kg"]
                    )
                    own, told = one.reset()
                    due[i] = False
            assert np.array_equal(seen[i], own)
            assert np.array_equal(info["privileged"][i], told["privileged"])
            assert {name: info["randomized"][name][i] for name in RANDOM_QUANTITIES} == told[
                "randomized"
            ]
    assert ended > 4


def test_what_is_shown_comes_as_late_as_was_drawn():
    """Without noise what is shown is the true state of some steps ago, exactly."""
    env = only(sensing_delay_s=1.0)
    counts = set()
    for seed in range(14):
        seen, info = env.reset(seed=seed)
        late = round(info["randomized"]["sensing_delay_s"] / 0.2)
        truth = [info["privileged"][:16]]
        for _ in range(8):
            assert np.array_equal(seen, truth[max(len(truth) - 1 - late, 0)])
            seen, *_, info = env.step(np.float32([0.1, 0.0, -0.2]))
            truth.append(info["privileged"][:16])
        counts.add(late)
    assert len(counts) > 3


def test_what_is_commanded_acts_as_late_as_was_drawn():
    """Until it does the lander bears its weight, as one does that is told to."""
    hover = np.zeros(3, np.float32)
    delayed = only(actuation_delay_s=1.0)
    seen = set()
    for seed in range(6):
        _, info = delayed.reset(seed=seed)
        late = round(info["randomized"]["actuation_delay_s"] / 0.2)
        plain = GuidanceEnv(changes=LOW, privileged=True)
        plain.reset(seed=seed)
        down = np.float32([0.3, 0.0, -0.9])
        for step in range(9):
            *_, mine = delayed.step(down)
            *_, own = plain.step(hover if step < late else down)
            assert mine["privileged"][:16] == pytest.approx(own["privileged"][:16], abs=1e-3)
        seen.add(late)
    assert len(seen) > 2


def test_noise_is_as_large_as_it_says_and_on_its_own_part_alone():
    env = only(
        position_noise_m=2.0, velocity_noise_m_s=0.3, attitude_noise_deg=2.0, rate_noise_deg_s=1.0
    )
    errors = []
    for seed in range(60):
        seen, info = env.reset(seed=seed)
        for _ in range(4):
            truth = info["privileged"][:16]
            turn = Rotation.from_quat(truth[6:10]).inv() * Rotation.from_quat(seen[6:10])
            off = seen - truth
            errors.append([*off[:6], *turn.as_rotvec(), *off[10:13]])
            assert np.array_equal(off[13:], [0.0, 0.0, 0.0])
            seen, *_, info = env.step(np.float32([0.0, 0.0, -0.4]))
    errors = np.array(errors)
    sigma = np.repeat([2.0, 0.3, np.radians(2.0), np.radians(1.0)], 3)
    assert errors.std(axis=0) == pytest.approx(sigma, rel=0.15)
    assert np.abs(errors.mean(axis=0) / sigma).max() < 0.25
    others = np.corrcoef(errors.T)[~np.eye(12, dtype=bool)]
    assert np.abs(others).max() < 0.25
    after = np.corrcoef(errors[1:, 0], errors[:-1, 0])[0, 1]
    assert abs(after) < 0.2


def test_a_weak_engine_and_a_load_are_felt():
    """Hovering as if nothing were: the heavier and the weaker sink."""
    hover = np.zeros(3, np.float32)
    for seed in range(4):
        speeds = {}
        for name, keys in {
            "payload_kg": {"payload_kg": 200.0}, "thrust_scale": {"thrust_scale": 0.2},
            "engine_effectiveness": {"engine_failure": 1.0, "min_remaining_fraction": 0.3,
            "latest_failure_s": 0.1},
            "none": {"payload_kg": 0.0},
        }.items():  # fmt: skip
            env = only(**keys)
            _, info = env.reset(seed=seed)
            for _ in range(10):
                *_, info = env.step(hover)
            speeds[name] = info["privileged"][5], info["randomized"].get(name)
        sinks = speeds["none"][0]
        assert (speeds["payload_kg"][0] < sinks) == (speeds["payload_kg"][1] > 0.0)
        assert (speeds["thrust_scale"][0] > sinks) == (speeds["thrust_scale"][1] > 0.0)
        assert speeds["engine_effectiveness"][0] < sinks and speeds["engine_effectiveness"][1] < 1.0


def test_a_copy_goes_on_like_the_one_it_is_of():
    env = GuidanceEnv(changes=VARIED)
    env.reset(seed=2)
    for _ in range(3):
        env.step(np.zeros(3, np.float32))
    other = copy.deepcopy(env)
    for _ in range(5):
        one, two = (each.step(np.float32([0.1, 0.0, -0.2])) for each in (env, other))
        assert np.array_equal(one[0], two[0]) and one[1] == two[1]


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"payload_kg": -1.0}, "payload_kg"), ({"payload_kg": 1100.0},
        r"domain_randomization\.payload.*less than vehicle\.dry_mass_kg \(1100\)"),
        ({"thrust_lag_s": 0.09}, r"thrust_lag.*less than vehicle\.thrust_lag_s minus 0\.02 s"),
        ({"min_remaining_fraction": 1.5}, "min_remaining_fraction"),
        ({"payloads_kg": 1.0}, "payload_kg"), ({"engine_failure": "often"}, "engine_failure"),
    ],
)  # fmt: skip
def test_ranges_that_will_not_do_are_refused(keys, says):
    with pytest.raises(InputError, match=says):
        only(**keys)


def test_nothing_is_drawn_or_reported_that_is_not_asked_for():
    env = ControlEnv(changes=LOW)
    _, info = env.reset(seed=1)
    assert info == {}
    *_, info = env.step(np.zeros(4, np.float32))
    assert set(info) == {"reward_terms", "cost"}
    _, info = ControlEnv(changes=VARIED).reset(seed=1)
    assert set(info) == {"randomized"} and set(info["randomized"]) == set(RANDOM_QUANTITIES)
    _, info = ControlEnv(changes=VARIED, privileged=True).reset(seed=1)
    assert info["privileged"].shape == (29,)  # in SI units
    assert info["privileged"][15] == LOW["simulation.max_time_s"]


def test_the_whole_simulation_refuses_the_table():
    scenario = Scenario.from_dict({"domain_randomization": {"payload_kg": 5.0}})
    with pytest.raises(InputError, match="only Guidance-v1 and Control-v1"):
        Simulation(scenario, 1)


def test_a_lander_that_differs_from_the_known_one_moves_differently():
    """Hovering as if nothing were: weak thrust sinks, a heavy lander sinks, as computed by hand."""
    hover = np.zeros(3, np.float32)
    speeds = {}
    for key, value in (("none", 1.0), ("thrust_scale", 0.9), ("dry_mass_scale", 1.2)):
        changes = {} if key == "none" else {f"truth.vehicle.{key}": value}
        env = GuidanceEnv(changes=LOW | changes, privileged=True)
        env.reset(seed=3)
        for _ in range(10):
            *_, info = env.step(hover)
        speeds[key] = info["privileged"][5]
    assert speeds["thrust_scale"] < speeds["none"] - 0.05
    assert speeds["dry_mass_scale"] < speeds["none"] - 0.05


def test_the_nominal_truth_changes_no_bit_of_a_random_flight():
    changes = {"truth.vehicle.thrust_scale": 1.0, "truth.vehicle.com_offset_m": [0.0, 0.0, 0.0]}
    envs = [GuidanceEnv(changes=VARIED | more, privileged=True) for more in ({}, changes)]
    seen = [env.reset(seed=5)[1]["privileged"] for env in envs]
    assert np.array_equal(*seen)
    for _ in range(5):
        seen = [env.step(np.float32([0.1, 0.0, -0.3]))[4]["privileged"] for env in envs]
        assert np.array_equal(*seen)


def test_weak_control_torque_turns_the_lander_half_as_fast():
    rates = []
    for scale in (1.0, 0.5):
        env = ControlEnv(changes=LOW | {"truth.vehicle.thruster_scale": scale}, privileged=True)
        env.reset(seed=3)
        *_, info = env.step(np.float32([0.0, 0.5, 0.0, 0.0]))
        rates.append(info["privileged"][10])
        assert "randomized" not in info or info["randomized"]["torque_effectiveness_x"] == 1.0
    assert rates[0] != 0.0
    assert rates[1] == pytest.approx(0.5 * rates[0], rel=1e-3)


def test_the_attitude_loop_does_not_know_the_true_inertia():
    """A lander of half the inertia turns twice as fast under the torques of the known one."""
    rates = []
    for scale in (1.0, 0.5):
        changes = LOW | {"truth.vehicle.inertia_scale": [scale, scale, scale]}
        env = GuidanceEnv(changes=changes, privileged=True)
        env.reset(seed=3)
        *_, info = env.step(np.float32([0.4, 0.0, -0.2]))
        rates.append(np.abs(info["privileged"][10:13]).max())
    assert abs(rates[1] - rates[0]) > 0.05 * rates[0]
