"""A reset that is refused changes nothing: no seed, no start, no flight in the air."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.descent.env import GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from tests.envs.site_scene import SMALL

SITE = {"scenario": SMALL, "perception": "truth", "worlds": 2, "world_seed": 5}
TOLD = {
    RetargetVectorEnv: {"position_m": [-200.0, 0.0, 210.0], "target_scatter_m": [1.0, 1.0]},
    GuidanceVectorEnv: {"position_m": [-600.0, 0.0, 600.0]},
}


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in a) if isinstance(a, dict) else (
        np.array_equal(a, b)
    )  # fmt: skip


@pytest.mark.parametrize("seed", [-1, [7, -1], np.array([7, -1])], ids=str)
@pytest.mark.parametrize("kind", [RetargetVectorEnv, GuidanceVectorEnv])
def test_a_seed_that_is_none_changes_no_lane(kind, seed):
    settings = SITE if kind is RetargetVectorEnv else {}
    env, other = kind(2, **settings), kind(2, **settings)
    for one in (env, other):
        one.reset(seed=1)
    with pytest.raises(ValueError, match=r"seed.*: .*0 or more"):
        env.reset(seed=seed, options=TOLD[kind])
    lanes, others = (
        one.lanes if kind is RetargetVectorEnv else one.descents.lanes for one in (env, other)
    )
    # Flights that follow by themselves start where they did.
    assert np.array_equal(lanes.starts, others.starts) and np.array_equal(
        lanes.target_areas, others.target_areas
    )
    assert same(env.reset()[0], other.reset()[0])


@pytest.mark.parametrize("seed", [9, None])
@pytest.mark.parametrize(
    "options", [{"position_m": [-200.0, 0.0, 1.0]}, {"target_m": [500.0, 0.0]}], ids=str
)
def test_a_start_that_the_flight_itself_refuses_leaves_seed_flight_and_frame(options, seed):
    """The whole computer finds only as it begins that no path leads from there."""
    env, other = (
        gymnasium.make(
            "lunarsim_envs:lunarsim/Retarget-v1",
            scenario=SMALL,
            perception="onboard",
            render_mode="rgb_array",
        ).unwrapped
        for _ in range(2)
    )
    for one in (env, other):
        one.reset(seed=1)
    with pytest.raises(InputError, match="position_m"):
        env.reset(seed=seed, options=options)
    assert np.array_equal(env.render(), other.render())
    assert same(env.step(0)[0], other.step(0)[0])
    assert same(env.reset()[0], other.reset()[0])


WRONG = [
    {"position_m": ("-200", "0", "210")}, {"position_sigma_m": True}, {"cover": "0.1"},
    {"cover": [0.1]}, {"cover": None}, {"target_m": None}, {"velocity_m_s": [True, 0.0, 0.0]},
    {"position_m": [[-200.0, 0.0, 210.0]]}, {"target_scatter_m": "11"},
]  # fmt: skip


@pytest.mark.parametrize("options", WRONG, ids=str)
@pytest.mark.parametrize("perception", ["truth", "onboard"])
def test_what_is_no_number_is_refused_by_kernels_as_by_the_whole_computer(perception, options):
    env = RetargetEnv(**(SITE | {"perception": perception}))
    (name,) = options
    with pytest.raises(InputError, match=rf"options\.{name}"):
        env.reset(seed=1, options=options)


def test_a_cover_may_be_of_single_precision():
    env = GuidanceEnv(covers=[0.02])
    for cover in (0.02, np.float32(0.02), np.array(0.02, np.float32)):
        env.reset(seed=1, options={"cover": cover})
        assert env.descents.lanes.world[0] == 1
