"""Retarget-v1 on maps of shadows, of a quadtree and of both, drawn on board."""

from __future__ import annotations

import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.fusion.mapper import FusedMapper
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper
from lunarsim.onboard.hazards.shadows.mapper import ShadowMapper
from lunarsim.scenario import Scenario
from lunarsim.scenario.shipped import found
from lunarsim_envs.retarget_vector import RetargetVectorEnv
from lunarsim_envs.sites.perception_scenarios import MAPPER_OF, with_perception

ID = "lunarsim_envs:lunarsim/Retarget-v1"
# A descent of some seconds with a small camera: one decision high up, one low down.
LOW = Scenario.from_dict({
    "name": "low",
    "terrain": {"kind": "fractal", "size_m": 300.0, "posting_m": 2.0, "rms_slope_deg": 0.0},
    "rocks": {"cover": 0.04, "min_diameter_m": 0.5},
    "target": {"scatter_m": [3.0, 3.0]},
    "sun": {"azimuth_deg": 45.0, "elevation_deg": 25.0},
    "start": {
        "position_m": [-50.0, -25.0, 80.0], "velocity_m_s": [8.0, 4.0, -10.0],
        "position_sigma_m": 1.0, "velocity_sigma_m_s": 0.1,
    },
    "sensors": {
        "imu": {"kind": "imu"},
        "altimeter": {"kind": "radar-altimeter"},
        "eye": {"kind": "camera", "width": 320, "height": 240, "field_of_view_deg": 35.0},
        "flash": {"kind": "flash-lidar", "rows": 128, "cols": 128},
    },
    "tasking": {
        "eye": {"kind": "periodic", "rate_hz": 5.0},
        "flash": {"kind": "at-altitudes", "altitudes_m": [74.0]},
    },
    "navigation": {"kind": "rocks"},
    "decisions": {"first_altitude_m": 70.0, "last_altitude_m": 40.0, "interval_s": 1.0},
    "mappers": {
        "dem": {"kind": "gaussian-dem", "size_m": 40.0, "posting_m": 0.5},
        "shade": {"kind": "shadow", "sensor": "eye", "size_m": 40.0, "posting_m": 0.5},
    },
})  # fmt: skip


def test_check_env_without_a_warning():
    """Fused maps are drawn from a camera and a LiDAR, so the other maps are in this check."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(ID, scenario=LOW, perception="fused").unwrapped)


@pytest.mark.parametrize(
    ("perception", "mapper"),
    [("shadows", ShadowMapper), ("quadtree", QuadtreeMapper), ("fused", FusedMapper)],
)
def test_flights_on_maps_drawn_on_board(perception, mapper):
    env = gymnasium.make(ID, scenario=LOW, perception=perception)
    _, info = env.reset(seed=2)
    computer = env.unwrapped.simulation.computer
    assert type(computer.mapper) is mapper
    shares = []
    for _ in range(2):
        action = int(np.flatnonzero(info["action_mask"])[-1])
        observation, reward, ended, _, info = env.step(action)
        assert not ended and env.observation_space.contains(observation)
        assert reward == pytest.approx(sum(info["reward_terms"].values()))
        shares.append(float(observation["hazard_map"][1].mean()))
    assert max(shares) > 0.02  # something was seen
    seen = env.unwrapped.seen.hazard_map
    assert np.array_equal(seen.p_safe, computer.mapper.hazard_map().p_safe)


def test_a_scenario_is_given_what_it_lacks():
    plain = Scenario.load(found(Path("few_sites")))
    (was,) = plain.mappers.values()
    for perception, kind in MAPPER_OF.items():
        given = with_perception(plain, perception)
        decides = given.mappers[given.decisions.map]
        assert decides.kind == kind
        if perception != "fused":
            assert list(given.mappers) == [given.decisions.map]  # in the place of the other
            assert (decides.size_m, decides.posting_m) == (was.size_m, was.posting_m)
        assert given.rocks == plain.rocks and given.start == plain.start
    fused = with_perception(plain, "fused")
    assert {part.kind for part in fused.mappers.values()} == {"gaussian-dem", "shadow", "fused"}
    assert tuple(fused.mappers["fused"].inputs) == ("dem", "rocks")
    assert fused.navigation.kind == with_perception(plain, "shadows").navigation.kind == "rocks"
    assert with_perception(plain, "quadtree").navigation.kind == "inertial"
    lander, zone = (
        plain.vehicle.make(),
        with_perception(plain, "quadtree").mappers["quadtree"].sites,
    )
    assert zone.zone_half_side_m > lander.leg_radius + 0.5 * lander.pad_diameter
    assert zone.roughness_limit_m == lander.roughness_limit


def test_a_scenario_keeps_what_it_has():
    eyes = Scenario.load(found(Path("camera_and_lidar")))
    assert with_perception(eyes, "onboard") is eyes
    assert with_perception(eyes, "fused").to_dict() == eyes.to_dict()
    assert with_perception(eyes, "shadows").to_dict() == eyes.changed(
        decisions={"map": "rocks"}
    ).to_dict()  # fmt: skip
    own = with_perception(LOW, "fused")
    assert set(own.mappers) == {"dem", "shade", "fused"} and set(own.sensors) == set(LOW.sensors)
    # The one that decides stays, where there are two of a kind.
    twice = LOW.changed(
        mappers={"far": {"kind": "gaussian-dem"}, "tree": {"kind": "quadtree"},
                 "wood": {"kind": "quadtree"}}, decisions={"map": "wood"},
    )  # fmt: skip
    assert with_perception(twice, "quadtree").decisions.map == "wood"


def test_what_does_not_go_together_is_refused():
    dark = Scenario.load(found(Path("shadow_nominal")))
    for perception, word in (("quadtree", "gaussian-dem"), ("fused", "gaussian-dem")):
        with pytest.raises(InputError, match=word):
            gymnasium.make(ID, scenario=dark, perception=perception)
    other = Scenario.from_dict({"navigation": {"kind": "ukf"}})
    with pytest.raises(InputError, match=r"navigation\.kind: .*got 'ukf'"):
        with_perception(other, "shadows")
    with pytest.raises(InputError, match="Use a single environment"):
        RetargetVectorEnv(2, scenario=LOW, perception="fused")
    with pytest.raises(InputError, match="fused"):
        gymnasium.make(ID, scenario=LOW, perception="fuse")
