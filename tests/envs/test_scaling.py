"""Scaled observations of descents, and actions about the weight."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.descent.observations import DEFAULT, PARTS, ObservationComponent, register
from tests.low_descents import IDS, LOW

# Scales of the page of the environment, SI: size, far and near of each component.
SCALES = {
    "position": (3, 600.0, 3.0), "velocity": (3, 40.0, 1.0), "attitude": (4, 1.0, 0.1),
    "rate": (3, 0.5, 0.1), "thrust": (1, 4.0, 1.0), "propellant": (1, 400.0, 400.0),
    "time_left": (1, 120.0, 10.0),
}  # fmt: skip
NOISY = LOW | {
    "domain_randomization.position_noise_m": 0.5, "domain_randomization.attitude_noise_deg": 2.0,
    "domain_randomization.sensing_delay_s": 0.4, "domain_randomization.payload_kg": 50.0,
}  # fmt: skip
GRAVITY, DRY, WET = 1.622, 1100.0, 1500.0
LARGEST = 6000.0 / DRY


def scaled(physical, names):
    """Return the scaled observation (2 size,) of one in SI units."""
    sizes, far, near = np.array([SCALES[name] for name in names]).T
    far, near = (np.repeat(scale, sizes.astype(int)) for scale in (far, near))
    return np.concatenate((physical / far, np.arcsinh(physical / near)))


@pytest.mark.parametrize("kind", [GuidanceEnv, ControlEnv])
@pytest.mark.parametrize("names", [DEFAULT, ("time_left", "velocity")])
@pytest.mark.parametrize("changes", [LOW, NOISY], ids=["exact", "noisy"])
def test_scaled_observations_are_those_in_si_units(kind, names, changes):
    env, plain = (kind(changes=changes, observation=names, scaled=one) for one in (True, False))
    size = sum(SCALES[name][0] for name in names)
    assert plain.observation_space.shape == (size,) and env.observation_space.shape == (2 * size,)
    assert kind(changes=changes, observation=names).observation_space == env.observation_space
    rng, over = np.random.default_rng(1), False
    seen, physical = (one.reset(seed=7)[0] for one in (env, plain))
    for _ in range(60):
        assert seen.dtype == physical.dtype == np.float32
        assert seen == pytest.approx(scaled(physical.astype(float), names), rel=1e-5, abs=1e-6)
        assert env.descents.physical(seen) == pytest.approx(physical, rel=1e-6, abs=1e-7)
        assert np.array_equal(plain.descents.physical(physical), physical)
        if over:
            break
        action = rng.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)
        (seen, earned, over, _, scaled_info), (physical, own, ended, _, info) = (
            one.step(action) for one in (env, plain)
        )
        # The flight is the same.
        assert (earned, over) == (own, ended) and scaled_info == info


def test_components_are_as_documented():
    assert tuple(SCALES) == DEFAULT
    assert {p.name: (p.size, p.far, p.near) for p in map(PARTS.get, DEFAULT)} == SCALES


def test_observations_of_a_batch_are_scaled_and_converted_row_by_row():
    vector, plain = (GuidanceVectorEnv(5, "SameStep", changes=LOW, scaled=s) for s in (True, False))
    assert vector.observation_space.shape == (5, 32) and plain.observation_space.shape == (5, 16)
    rows, physical = (one.reset(seed=2)[0] for one in (vector, plain))
    alone, _ = GuidanceEnv(changes=LOW).reset(seed=4)
    assert np.array_equal(rows[2], alone)
    assert vector.descents.physical(rows) == pytest.approx(physical, rel=1e-6, abs=1e-7)
    assert vector.descents.physical(rows[2].tolist()) == pytest.approx(physical[2], rel=1e-6)
    ended = np.zeros(5, bool)
    while not ended.any():
        *_, info = vector.step(np.tile(np.float32([0.0, 0.0, -0.5]), (5, 1)))
        *_, scaled_info = plain.step(np.tile(np.float32([0.0, 0.0, -0.5]), (5, 1)))
        ended = info.get("_final_obs", ended)
    last = vector.descents.physical(info["final_obs"])
    assert last == pytest.approx(scaled_info["final_obs"], rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("is_scaled", [True, False])
@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("changes", [LOW, NOISY], ids=["exact", "noisy"])
def test_spaces_contain_all_observations(name, changes, is_scaled):
    """Also of flights from so far that positions are clipped."""
    vector = gymnasium.make_vec(
        f"lunarsim_envs:{name}", num_envs=40, vectorization_mode="vector_entry_point",
        changes=changes, scaled=is_scaled, autoreset_mode="SameStep", rate_hz=5.0,
    )  # fmt: skip
    vector.reset(seed=1)
    far = {"position_m": [-4990.0, 4990.0, 4990.0], "velocity_m_s": [-60.0, 60.0, 60.0]}
    seen, _ = vector.reset(options=far | {"reset_mask": np.arange(40) < 8})
    rng, clipped = np.random.default_rng(1), False
    for _ in range(60):
        assert vector.observation_space.contains(seen)
        position = vector.unwrapped.descents.physical(seen)[:, :3]
        clipped |= bool((np.abs(position) > 4999.9).any())
        actions = rng.choice([-1.0, 1.0], vector.action_space.shape)
        seen, *_, info = vector.step(actions.astype(np.float32))
        if "final_obs" in info:
            assert vector.observation_space.contains(info["final_obs"])
    assert clipped


def test_a_component_of_ones_own_has_its_scales():
    def height(lanes):
        return lanes.y[:, 2:3] - lanes.target[:, 2:3]

    arguments = ("height", 1, "m", -np.inf, np.inf, "height above the target", height)
    register(ObservationComponent(*arguments, far=50.0, near=0.5))
    register(ObservationComponent("plain", *arguments[1:]))
    try:
        env = GuidanceEnv(changes=LOW, observation=["height", "velocity", "plain"])
        seen, _ = env.reset(seed=1)
        high = env.descents.lanes.y[0, 2] - env.descents.lanes.target[0, 2]
        assert seen.shape == (10,) and env.observation_space.contains(seen)
        assert seen[[0, 5]] == pytest.approx([high / 50.0, np.arcsinh(high / 0.5)], rel=1e-6)
        # Without scales of its own, a component has 1 and 1.
        assert seen[[4, 9]] == pytest.approx([high, np.arcsinh(high)], rel=1e-6)
        assert env.descents.physical(seen)[[0, 4]] == pytest.approx([high, high], rel=1e-6)
    finally:
        del PARTS["height"], PARTS["plain"]


@pytest.mark.parametrize("scale", ["far", "near"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_scales_that_will_not_do_are_refused(scale, value):
    part = ObservationComponent(
        "odd", 1, "m", 0.0, 1.0, "no component", lambda lanes: lanes.y[:, :1], **{scale: value}
    )
    with pytest.raises(InputError, match=rf"odd\.{scale}: must be positive and finite"):
        register(part)
    assert "odd" not in PARTS


@pytest.mark.parametrize("value", ["yes", 1, None])
def test_whether_to_scale_is_true_or_false(value):
    with pytest.raises(InputError, match="scaled"):
        GuidanceEnv(changes=LOW, scaled=value)


# --- actions -------------------------------------------------------------------------------------


STILL = LOW | {
    "start.position_m": [0.0, 0.0, 60.0], "start.velocity_m_s": [0.0, 0.0, 0.0],
    "start.position_sigma_m": 0.0, "start.velocity_sigma_m_s": 0.0,
}  # fmt: skip


def test_action_zero_hovers_in_guidance():
    env = GuidanceEnv(changes=STILL, scaled=False, observation=["velocity", "thrust", "position"])
    env.reset(seed=1)
    assert env.descents.actions.physical(np.zeros(3))[0] == pytest.approx([0.0, 0.0, GRAVITY])
    for _ in range(40):
        seen, *_ = env.step(np.zeros(3, np.float32))
        assert seen[3] == pytest.approx(GRAVITY, rel=1e-3)
    # It loses mass, and so needs less thrust than it had a moment ago.
    assert np.abs(seen[:3]).max() < 0.02 and seen[6] == pytest.approx(60.0, abs=0.1)


def test_action_zero_bears_the_dry_lander_in_control():
    env = ControlEnv(changes=STILL, scaled=False, observation=["velocity", "thrust", "propellant"])
    seen, _ = env.reset(seed=1)
    wanted = [DRY * GRAVITY, 0.0, 0.0, 0.0]
    assert env.descents.actions.physical(np.zeros(4))[0] == pytest.approx(wanted)
    for _ in range(100):
        seen, *_ = env.step(np.zeros(4, np.float32))
    assert seen[3] == pytest.approx(DRY * GRAVITY / (DRY + seen[4]), rel=1e-4)
    assert seen[2] == pytest.approx(-2.0 * GRAVITY * (1.0 - DRY / WET), rel=0.08)


def test_ends_of_the_range_are_the_limits():
    guided = GuidanceEnv(changes=STILL, scaled=False, observation=["thrust", "attitude"])
    actions, half = guided.descents.actions, 0.5 * LARGEST
    assert actions.physical(np.ones(3))[0] == pytest.approx([half, half, LARGEST])
    assert actions.physical(-np.ones(3))[0] == pytest.approx([-half, -half, 0.0])
    # Between them, commands grow with the square of the action.
    assert actions.physical([0.5, -0.5, 0.5])[0] == pytest.approx(
        [0.25 * half, -0.25 * half, 0.75 * GRAVITY + 0.25 * LARGEST]
    )
    assert actions.physical([0.0, 0.0, -0.5])[0, 2] == pytest.approx(0.75 * GRAVITY)
    direct = ControlEnv(changes=STILL, scaled=False, observation=["thrust", "propellant"])
    actions = direct.descents.actions
    assert actions.physical(np.ones(4))[0] == pytest.approx([6000.0, 600.0, 600.0, 300.0])
    assert actions.physical(-np.ones(4))[0] == pytest.approx([600.0, -600.0, -600.0, -300.0])
    # The engine gives them.
    for thrust, wanted in ((1.0, 6000.0), (-1.0, 600.0)):
        direct.reset(seed=1)
        for _ in range(100):
            seen, *_ = direct.step(np.float32([thrust, 0.0, 0.0, 0.0]))
        assert seen[0] * (DRY + seen[1]) == pytest.approx(wanted, rel=1e-3)
    guided.reset(seed=1)
    for _ in range(10):
        seen, *_ = guided.step(np.float32([0.0, 0.0, 1.0]))
    assert seen[0] == pytest.approx(6000.0 / WET, rel=0.02)


@pytest.mark.parametrize("kind", [GuidanceEnv, ControlEnv])
@pytest.mark.parametrize("least", [600.0, 1800.0], ids=["throttled", "strong"])
def test_actions_and_commands_are_inverse(kind, least):
    """Also with an engine whose minimum thrust is more than the weight without propellant."""
    env = kind(changes=LOW | {"vehicle.thrust_min_n": least})
    actions, rng = env.descents.actions, np.random.default_rng(3)
    given = rng.uniform(-1.0, 1.0, (200, *env.action_space.shape))
    physical = actions.physical(given, 200)
    assert ((physical >= actions.low) & (physical <= actions.high)).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = actions.action(physical)
        assert again.dtype == np.float32
        assert actions.physical(again, 200) == pytest.approx(physical, rel=1e-5, abs=1e-4)
        constant = actions.low == actions.middle
        assert constant.any() == (kind is ControlEnv and least == 1800.0)
        assert again[:, ~constant] == pytest.approx(given[:, ~constant], abs=1e-6)
        # Beyond the limits it is the closest action.
        assert (actions.action(2.0 * actions.high) == 1.0).all()
        assert (actions.action(actions.low - 1.0) == -1.0).all()
        assert not actions.action(actions.middle).any()
        assert np.array_equal(actions.action(physical[7]), again[7])
