"""Arguments, options and seeds that are none: each is refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim_envs.descent.env import GuidanceEnv, GuidanceVectorEnv
from lunarsim_envs.retarget import RetargetEnv
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from tests.envs.site_scene import SMALL

BOTH = [
    ({"scenario": 3}, "scenario: must"), ({"scenario": {"name": "x"}}, "a Scenario"),
    ({"changes": [("rocks.cover", 0.1)]}, "changes"), ({"changes": "rocks.cover=1"}, "changes"),
    ({"changes": {3: 1}}, "changes"), ({"changes": {"rocks.cover": "much"}}, "rocks.cover"),
    ({"changes": {"rocks.cover": np.nan}}, "rocks.cover"), ({"weights": 3}, "weights"),
    ({"weights": {"safe": 1.0}}, "weights"), ({"observation": 3}, "observation"),
    ({"observation": None}, "observation"), ({"observation": [3]}, "observation"),
    ({"observation": [["site"]]}, "observation"), ({"worlds": 1.5}, "worlds"),
    ({"worlds": "a"}, "worlds"), ({"worlds": True}, "worlds"), ({"world_seed": -1}, "world_seed"),
    ({"world_seed": 1.5}, "world_seed"), ({"world_seed": "a"}, "world_seed"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "says"), BOTH, ids=str)
@pytest.mark.parametrize(
    ("kind", "more"),
    [
        (RetargetEnv, {"perception": "truth"}), (RetargetVectorEnv, {"perception": "truth"}),
        (GuidanceEnv, {}), (GuidanceVectorEnv, {}),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)  # fmt: skip
def test_arguments_that_are_none_are_refused(kind, more, arguments, says):
    with pytest.raises(InputError, match=says):
        kind(**(more | arguments))


@pytest.mark.parametrize(
    ("kind", "arguments", "says"),
    [
        (RetargetEnv, {"perception": ["truth"]}, "perception"),
        (RetargetEnv, {"perception": None}, "perception"),
        (RetargetVectorEnv, {"perception": ["truth"]}, "perception"),
        (RetargetVectorEnv, {"perception": "onboard"}, "a single environment"),
        (RetargetEnv, {"perception": "surrogate", "surrogate": 3}, "surrogate"),
        (RetargetEnv, {"views": 1}, "views"),
        (GuidanceEnv, {"privileged": "no"}, "privileged"),
        (RetargetVectorEnv, {"render_mode": "rgb_array_list"}, "render_mode"),
        (GuidanceVectorEnv, {"render_mode": "human"}, "render_mode"),
        (GuidanceVectorEnv, {"num_envs": 2, "rendered": [0, 2]}, "below num_envs"),
        (GuidanceVectorEnv, {"num_envs": 2, "rendered": [0.5]}, "rendered"),
        (GuidanceVectorEnv, {"num_envs": 2, "rendered": 1}, "rendered"),
        (GuidanceVectorEnv, {"num_envs": 2, "rendered": []}, "one or more"),
        (RetargetVectorEnv, {"num_envs": 2, "rendered": [1, 1]}, "each given once"),
    ]
    + [(RetargetVectorEnv, {"num_envs": n}, "num_envs") for n in (0, -1, 1.5, "a", True)],
    ids=str,
)
def test_arguments_of_one_kind_are_refused(kind, arguments, says):
    with pytest.raises(InputError, match=says):
        kind(**arguments)


@pytest.fixture(scope="module")
def made():
    site = {"scenario": SMALL, "perception": "truth", "worlds": 2, "world_seed": 5}
    return {
        "one site": RetargetEnv(**site), "sites": RetargetVectorEnv(2, **site),
        "one descent": GuidanceEnv(), "descents": GuidanceVectorEnv(2),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["one site", "sites", "one descent", "descents"])
@pytest.mark.parametrize(
    "options",
    [
        3, [1], "x", {3: 1}, {"start": 1}, {"velocity_m_s": [1e9, 0.0, 0.0]},
        {"position_m": [-6000.0, 0.0, 500.0]}, {"velocity_sigma_m_s": np.inf},
    ],
    ids=str,
)  # fmt: skip
def test_options_that_are_none_are_refused(made, name, options):
    with pytest.raises(InputError, match="options"):
        made[name].reset(seed=1, options=options)


@pytest.mark.parametrize("name", ["sites", "descents"])
@pytest.mark.parametrize("seed", [1.5, "ab", {1: 2}, [1], [1.5, 2], ["a", 1]], ids=str)
def test_seeds_that_are_none_are_refused(made, name, seed):
    with pytest.raises(ValueError, match="seed"):
        made[name].reset(seed=seed)


@pytest.mark.parametrize(
    "actions",
    [[0], [0, 21], [0, -1], [0.0, 1.0], [[0], [0]], None, "ab", [True, False], [0, None]],
    ids=str,
)
def test_actions_that_are_none_are_refused_and_change_nothing(made, actions):
    sites = made["sites"]
    sites.reset(seed=1)
    before = sites.lanes.y.copy()
    with pytest.raises(ValueError, match="actions"):
        sites.step(actions)
    assert np.array_equal(sites.lanes.y, before)


@pytest.mark.parametrize(
    "action", [-1, 21, 1.0, np.nan, "1", None, [1], np.array([1]), 2**70], ids=str
)
def test_an_action_that_is_none_is_refused_and_changes_nothing(made, action):
    one = made["one site"]
    one.reset(seed=1)
    before = one.flight.time
    with pytest.raises(ValueError, match="action"):
        one.step(action)
    assert one.flight.time == before


@pytest.mark.parametrize("key", ["approach.time_to_go_s", "approach.jerk_m_s3"])
def test_kernels_name_the_key_that_fixes_the_time_to_go(key):
    changes = {key: 30.0 if key.endswith("_s") else 0.001}
    changes["approach.arrival_velocity_m_s"] = [1.0, -1.0]
    with pytest.raises(InputError, match=f"{key}: must be omitted for this perception"):
        RetargetEnv(perception="truth", changes=changes)
