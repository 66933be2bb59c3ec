"""Pictures of known rocks on a plane, and a tracker that follows them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.frames import direction_from_angles
from lunarsim.grid import Grid
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.hazards.shadows import RockTracker, TrackerSettings
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockModel
from lunarsim.sensors.camera import Camera
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield, Terrain, place_rocks
from tests.worlds import flat_terrain

SUN = direction_from_angles(1.2, np.radians(20.0))
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
MODEL = ShadowModel(np.radians(20.0))


def at(position, attitude=LEVEL, **camera):
    state = State(np.array(position, float), np.zeros(3), np.array(attitude), np.zeros(3), 1000.0)
    mount = gimbal_mount(state.attitude, -state.position)
    return state, replace(Camera(**camera), mount=mount)


def picture(terrain, position, sun=(1.2, 20.0), **camera):
    state, eye = at(position, **camera)
    world = World(terrain, 1.622, Light(sun[0], np.radians(sun[1])))
    return state, eye, eye.expose(world, state, 0.0, np.random.default_rng(0)).counts


def rocks_on_a_plane(shape, seed=0, count=120, size=80.0):
    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), size, 2.0)
    relief = Heightfield(grid, np.zeros(grid.shape, np.float32))
    sizes = rng.uniform(0.8, 2.0, count)
    rocks = place_rocks(relief, sizes, rng, model=RockModel(shape, burial=(0.0, 0.0)))
    # The ground goes on beyond the rocks: black sky in view would run into their shadows.
    return Terrain(flat_terrain(2000.0, 50.0).relief, rocks)


def tracker_at(position, model=MODEL, **settings):
    state, _ = at(position)
    inertial = StrapdownState(state.position, np.zeros(3), state.attitude, 1.622)
    rocks = RockFilter.of(inertial, StartSigmas(1e-3, 1e-3, 1e-5))
    return RockTracker(rocks, model, settings=TrackerSettings(**settings))


def follow(terrain, path, tracker, mapping=None, begins=0.0):
    """Take one picture from each place on a path; the lander's own motion is known."""
    for k, position in enumerate(path):
        state, camera, counts = picture(terrain, position)
        error = np.zeros(15)
        error[:3] = state.position - tracker.filter.inertial.position
        tracker.filter.inertial.correct(error)
        seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
        tracker.update(seen, camera, SUN, begins + 0.1 * k)
        if mapping is not None:
            mapping.add_image(camera.view(state), SUN, seen)
    return tracker
