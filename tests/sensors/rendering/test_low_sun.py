"""Under a low Sun with scattered light no radiance is negative, and cameras expose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.scenario.shipped import names
from lunarsim.sensors.rendering import renderer_of
from lunarsim.simulation.image_rendering import camera_pointing_state, first_camera
from lunarsim.simulation.worlds import build_world

ROUGH = {
    "terrain": {"preset": "highland", "size_m": 80.0, "posting_m": 1.0},
    "rocks": {"cover": 0.05, "min_diameter_m": 0.5},
}


def check_scene(scene: dict, elevations, altitudes):
    for elevation in elevations:
        sun = scene.get("sun", {}) | {"elevation_deg": elevation, "scattered_light": True}
        scenario = Scenario.from_dict(scene | {"sun": sun})
        world = build_world(scenario, RandomStreams(flight_seed(1, 0)))
        camera = replace(first_camera(scenario), width=160, height=120)
        for altitude in altitudes:
            target = scenario.target.position_m
            state = camera_pointing_state(camera, world, target, altitude, 0.2, 1.0)
            image = renderer_of(world.terrain).render(camera.view(state), world.light)
            assert np.isfinite(image.radiance).all() and image.radiance.min() >= 0.0
            camera.expose(world, state, 0.0, np.random.default_rng(1))


@pytest.mark.parametrize("photometry", ["lunar-lambert", "hapke"])
def test_rough_terrain(photometry):
    scene = ROUGH | {"sun": {"photometry": photometry, "diameter_deg": 0.53}}
    check_scene(scene, (0.5, 3.0), (60.0,))


@pytest.mark.slow
@pytest.mark.parametrize("name", names())
def test_shipped_scenarios(name):
    shipped = Scenario.load(names()[name])
    scene = {k: v for k, v in shipped.to_dict().items() if k in ("terrain", "rocks", "sun")}
    if "path" in scene["terrain"]:
        scene["terrain"]["path"] = str(shipped.terrain.path)
    check_scene(scene, (0.5, 1.0, 3.0), (20.0, 60.0, 300.0))
