"""Curricula: what `reset(options=...)` changes of starts, targets, rocks and Sun."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.descent.env import ControlEnv, GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.descent.worlds import WorldPool
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from tests.envs.site_scene import SMALL, made_up
from tests.reference import descent as plain

ID = "lunarsim_envs:lunarsim/Retarget-v1"
WIDE = {"target.scatter_m": [8.0, 8.0], "terrain.size_m": 90.0}
ROCKY = {"covers": [0.1], "worlds": 2, "changes": WIDE | {"terrain.kind": "fractal"}}
KERNELS = {
    "scenario": SMALL, "perception": "surrogate", "worlds": 1, "world_seed": 5, "covers": [0.02],
    "surrogate": made_up(),
}  # fmt: skip
TOLD = {"target_m": [4.0, -3.0], "target_scatter_m": [2.0, 1.0], "cover": 0.1}


@pytest.fixture(scope="module")
def batch():
    return GuidanceVectorEnv(40, **ROCKY)


def test_targets_and_worlds_are_those_drawn_plainly(batch):
    """Flight after flight, also those that follow a reset by themselves."""
    batch.reset(seed=1, options=TOLD)
    lanes = batch.descents.lanes
    aim = np.array([4.0, -3.0, 2.0, 1.0])
    for flight in range(3):
        for i in range(40):
            key = int(lanes.keys[i])
            world, target, *_ = plain.begun(key, flight, lanes.craft.start, aim, 2)
            assert lanes.world[i] == 2 + world
            assert lanes.target[i, :2] == pytest.approx(target, abs=1e-12)
        batch.descents.restart(np.ones(40, bool))
    assert len(set(lanes.world.tolist())) == 2


def test_without_options_flights_are_the_scenario_s_again(batch):
    first, _ = batch.reset(seed=1)
    assert set(batch.descents.lanes.world.tolist()) == {0, 1}
    batch.reset(seed=1, options=TOLD)
    again, _ = batch.reset(seed=1)
    assert np.array_equal(first, again)


def test_lanes_of_a_mask_alone_are_changed(batch):
    batch.reset(seed=1)
    some = np.arange(40) % 2 == 0
    before = batch.descents.lanes.target.copy()
    batch.reset(options=TOLD | {"reset_mask": some})
    lanes = batch.descents.lanes
    assert (lanes.world[some] >= 2).all() and (lanes.world[~some] < 2).all()
    assert np.array_equal(lanes.target[~some], before[~some])
    assert (np.abs(lanes.target[some, :2] - [4.0, -3.0]) <= [2.0, 1.0]).all()


def test_more_covers_leave_the_scenario_s_worlds_as_they_are():
    scenario = SMALL.changed(rocks={"cover": 0.0})
    alone, more = WorldPool.of(scenario, 2, 3), WorldPool.of(scenario, 2, 3, [0.05, 0.15])
    assert more.covers == (0.0, 0.05, 0.15)
    assert np.array_equal(more.terrains[:2], alone.terrains)
    for cover, first in ((None, 0), (0.0, 0), (0.05, 2), (0.15, 4)):
        assert more.span(cover) == (first, 2)
    # More ground stands above the relief where there are more rocks.
    bumps = [(more.terrains[k] - more.terrains[k % 2] > 0.05).mean() for k in range(6)]
    assert max(bumps[:2]) == 0.0 < max(bumps[2:4]) < min(bumps[4:])


def test_a_target_off_the_map_is_refused_and_the_next_flight_begins():
    env = gymnasium.make(ID, perception="onboard", scenario=SMALL).unwrapped
    with pytest.raises(InputError, match="is on the terrain"):
        env.reset(seed=1, options={"target_m": [500.0, 0.0]})
    env.reset(seed=1)
    env.step(0)


def test_a_lane_with_options_flies_what_one_flies():
    told = TOLD | {"cover": 0.02, "position_sigma_m": 0.0}
    many = RetargetVectorEnv(3, **KERNELS)
    alone = gymnasium.make(ID, **KERNELS).unwrapped
    seen, _ = many.reset(seed=7, options=told)
    one, info = alone.reset(seed=9, options=told)
    assert many.lanes.world.tolist() == [1, 1, 1]
    ended = False
    while not ended:
        assert all(np.array_equal(seen[name][2], one[name]) for name in one)
        one, reward, ended, _, info = alone.step(0)
        seen, rewards, *_ = many.step(np.zeros(3, int))
        assert rewards[2] == reward
    assert "safe" in info


def test_the_whole_computer_takes_all_of_them():
    env = gymnasium.make(ID, perception="onboard", scenario=SMALL).unwrapped
    told = {"position_m": [-150.0, 0.0, 150.0], "position_sigma_m": 0.0, "cover": np.float64(0.02),
            "target_m": np.array([4.0, -3.0]), "target_scatter_m": [0.0, 0.0],
            "sun_azimuth_deg": 200.0, "sun_elevation_deg": 12.0}  # fmt: skip
    env.reset(seed=3, options=told)
    flown = env.simulation.scenario
    assert flown.sun.elevation_deg == 12.0 and flown.sun.azimuth_deg == 200.0
    assert flown.rocks.cover == 0.02 and flown.start.position_sigma_m == 0.0
    assert env.simulation.briefing.target[:2] == pytest.approx([4.0, -3.0])
    env.reset(seed=3)
    assert env.simulation.scenario == SMALL


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"cover": 0.3}, r"options\.cover: .*got 0\.3"), ({"sun_elevation_deg": 200.0}, "sun_elev"),
        ({"sun": 5.0}, "Known names: cover"), ({"target_m": [0.0]}, r"options\.target_m"),
        ({"position_m": [0.0, 0.0]}, r"options\.position_m"),
    ],
)  # fmt: skip
def test_the_whole_computer_refuses_what_no_scenario_may_say(options, says):
    env, other = (
        gymnasium.make(ID, perception="onboard", scenario=SMALL).unwrapped for _ in range(2)
    )
    for one in (env, other):
        one.reset(seed=1)
    with pytest.raises(InputError, match=says):
        env.reset(seed=9, options=options)
    # What was refused has changed nothing.
    shown, another = env.reset()[0], other.reset()[0]
    assert all(np.array_equal(shown[name], another[name]) for name in shown)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"cover": 0.05}, "argument `covers`"), ({"cover": "many"}, "must be a number"),
        ({"target_m": [9.0, 0.0]}, r"target_m\[0\]: .*target area of the scenario, got 9"),
        ({"target_m": [2.0, 0.0]}, r"target_m\[0\]: must be 0, so that"),
        ({"target_m": [0.0]}, "must be 2 numbers"),
        ({"target_scatter_m": [9.0, 0.0]}, r"scatter_m\[0\]: must be at most target\.scatter_m"),
        ({"target_m": [0.0, 6.0], "target_scatter_m": [0.0, 3.0]}, r"_m\[1\]: .* -5 and 5"),
        ({"target_m": [0.0, -6.0], "target_scatter_m": [0.0, 3.0]}, r"_m\[1\]: .* -5 and 5"),
        ({"target_m": [-6.0, 0.0], "target_scatter_m": [3.0, 0.0]}, r"_m\[0\]: .* -5 and 5"),
        ({"target_scatter_m": [-1.0, 0.0]}, r"scatter_m\[0\]: must be between 0 and 5000"),
        ({"sun_elevation_deg": 5.0}, "simulate the Sun"),
        ({"covers": 0.05}, "Did you mean 'cover'"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", [GuidanceEnv, ControlEnv, RetargetVectorEnv])
def test_kernels_refuse_what_they_do_not_fly(kind, options, says):
    env = kind(**(KERNELS if kind is RetargetVectorEnv else ROCKY))
    with pytest.raises(InputError, match=says):
        env.reset(seed=1, options=options)


@pytest.mark.parametrize("covers", [[0.1], 0.1, "0.1", [0.02, 0.02], [0.5], [True], [None]])
def test_covers_that_cannot_be_are_refused(covers):
    for perception in ("truth", "onboard"):
        with pytest.raises(InputError, match="cover"):
            gymnasium.make(ID, scenario=SMALL, perception=perception, covers=covers)
