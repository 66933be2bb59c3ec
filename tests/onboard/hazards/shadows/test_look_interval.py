"""Of pictures that follow each other closely some alone tell of clear ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.messages.measurements import CameraImage
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap, ShadowMapper
from lunarsim.onboard.perception.image_quality import ImageQualityCheck
from lunarsim.scenario import Scenario
from lunarsim.world import World
from lunarsim.world.light import Light
from tests.shadow_scene import MODEL, SUN, at, rocks_on_a_plane, tracker_at

PLACE = (0.0, 0.0, 50.0)


@pytest.fixture(scope="module")
def frames():
    """Pictures of one scene from the same place, none like another."""
    world = World(
        rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0), 1.622,
        Light(1.2, np.radians(20.0)),
    )  # fmt: skip
    state, camera = at(PLACE)
    rng = np.random.default_rng(0)
    return camera.model, [camera.expose(world, state, 0.0, rng).counts for _ in range(6)]


def looks(frames, shots, interval):
    """Return how often each camera's pictures were looks, and the mapper; `shots` are who, when."""
    camera, counts = frames
    mapping = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 0.5), MODEL, HazardPrior(0.05, 0.5))
    health = {name: ImageQualityCheck() for name, _ in shots}
    mapper = ShadowMapper(
        tracker_at(PLACE), mapping, SUN, 1.0, health=health, clear_terrain_interval=interval
    )
    found, see = [], mapping.add_image
    mapping.add_image = lambda *a, **k: (found.append(now), see(*a, **k))
    for n, (name, time) in enumerate(shots):
        now = (name, time)
        mapper.update_from_sensor(
            name, CameraImage(time, counts[n], camera), mapper.tracker.filter.inertial
        )
    return found, mapper


def test_observations_are_as_far_apart_as_given_and_every_image_corrects_the_rocks(frames):
    shots = [("camera", round(0.1 * k, 1)) for k in range(6)]
    every, first = looks(frames, shots, 0.0)
    some, second = looks(frames, shots, 0.2)
    assert every == shots and some == shots[::2]
    assert not first.rejected_images and not second.rejected_images
    assert np.array_equal(first.tracker.hits, second.tracker.hits)
    assert np.array_equal(first.tracker.filter.xy, second.tracker.filter.xy)
    assert second.hazard_map().observed.any()


def test_each_camera_looks_by_itself(frames):
    shots = [(name, time) for time in (0.0, 0.1, 0.2) for name in ("narrow", "wide")]
    found, _ = looks(frames, shots, 0.2)
    assert found == [shot for shot in shots if shot[1] != 0.1]


def test_a_scenario_says_how_far_apart_observations_are():
    root = Path(__file__).parents[4] / "scenarios"
    scenario = Scenario.load(root / "shadow_modified.toml")
    assert scenario.mappers["rocks"].clear_terrain_interval_s == 0.4
    other = scenario.changed(mappers={"rocks": {"clear_terrain_interval_s": 0.0}})
    assert other.mappers["rocks"].clear_terrain_interval_s == 0.0
