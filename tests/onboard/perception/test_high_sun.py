"""The Sun's azimuth by grey beside black, under a Sun so high that lit faces are no brighter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from lunarsim.frames import direction_from_angles
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.high_sun_direction import more_accurate_angle
from lunarsim.onboard.perception.image_quality import (
    ImageQualityCheck,
    ImageRejection,
    SunConfirmation,
)
from lunarsim.onboard.perception.lit_faces import lit_faces
from lunarsim.onboard.perception.shadow_direction import measure_shadow_angle
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.perception.sun_angle import SunAngle
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.world import World
from lunarsim.world.light import Light
from lunarsim.world.terrain import Terrain, place_rocks
from tests.chance import CHANCE
from tests.shadow_scene import at, picture
from tests.worlds import flat_terrain

# Shape, camera's azimuth from the Sun's, elevation of the Sun (deg).
SCENES = [("cube", 180.0, 45.0), ("cube", 180.0, 60.0), ("ellipsoid", 0.0, 45.0)]
AZIMUTH = 1.2


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    shape, beside, elevation = request.param
    rng = np.random.default_rng(77)
    relief = flat_terrain(260.0, 2.0).relief
    diameters = sample_diameters(260.0**2, 0.06, 0.3, 3.0, rng)
    model = RockModel(shape, burial=(0.0, 0.0))
    terrain = Terrain(relief, place_rocks(relief, diameters, rng, model=model))
    back = direction_from_angles(AZIMUTH + np.radians(beside), np.radians(65.0))
    state, camera, counts = picture(terrain, 70.0 * back, (AZIMUTH, elevation))
    return state, camera, counts, elevation


def looked_at(scene, off):
    """Return the angle found under a Sun taken to be `off` (deg) beside, and the verdict."""
    state, camera, counts, elevation = scene
    sun = direction_from_angles(AZIMUTH + np.radians(off), np.radians(elevation))
    model, health = ShapeMixture(np.radians(elevation)), ImageQualityCheck(sun=SunConfirmation())
    first = health.before_detection(counts, camera, state)
    seen = detect_rocks(counts, camera, state, sun, model=model)
    points = np.column_stack((seen.terrain_xy, np.zeros(len(seen))))
    noise = first.metrics["noise"]
    turn = measure_shadow_angle(seen, camera.view(state), points, sun, model, noise)
    return turn, health.after_detection(seen, turn, noise).fault


def test_a_high_sun_is_found_to_be_in_its_place(scene):
    turn, fault = looked_at(scene, 0.0)
    # Over 24 draws of the noise the angle has a mean of 10.4 deg and a deviation of 1.1 deg in the
    # scene where both are largest. Above 10 deg the Sun counts as unproven, not as elsewhere.
    assert abs(np.degrees(turn.angle)) < 10.4 + norm.isf(CHANCE) * 1.1
    assert turn.side > 5.0
    assert fault in {None, ImageRejection.SUN_UNPROVEN}


@pytest.mark.parametrize("beside", [20.0, 100.0, 250.0])
def test_boulders_brighter_than_the_terrain_do_not_put_a_high_sun_elsewhere(beside):
    rng = np.random.default_rng(8)
    relief = flat_terrain(160.0, 2.0).relief
    diameters = sample_diameters(160.0**2, 0.06, 0.3, 3.0, rng)
    model = RockModel("cube")
    terrain = Terrain(relief, place_rocks(relief, diameters, rng, model=model))
    back = direction_from_angles(AZIMUTH + np.radians(beside), np.radians(65.0))
    state, eye = at(60.0 * back)
    light = Light(AZIMUTH, np.radians(42.0), boulder_albedo=1.3)
    counts = eye.expose(World(terrain, 1.622, light), state, 0.0, rng).counts
    turn, fault = looked_at((state, eye.model, counts, 42.0), 0.0)
    # On some draws of the noise no angle is found.
    assert np.isnan(turn.angle) or abs(np.degrees(turn.angle)) < 20.0
    assert fault is not ImageRejection.SUN_ELSEWHERE


@pytest.mark.parametrize("off", [30.0, -30.0, 90.0, 180.0])
def test_a_high_sun_that_is_elsewhere_is_not_believed(scene, off):
    turn, fault = looked_at(scene, off)
    assert fault in {ImageRejection.SUN_ELSEWHERE, ImageRejection.SUN_UNPROVEN}
    if np.isfinite(turn.angle):
        beside = np.angle(np.exp(1j * (turn.angle - np.radians(off))))
        # 11.3 +- 0.5 deg at most over 20 draws of the noise.
        assert abs(np.degrees(beside)) < 15.0


def test_an_inaccurate_angle_confirms_a_high_sun_only_if_it_is_far_from_the_limit():
    limit = 30.0 / 3.5  # largest error of a confirmed direction, deg, by standard deviations

    def proven(angle, sigma, side=6.0, high=True):
        scene = ImageQualityCheck(sun=SunConfirmation())
        angle_now = SunAngle(np.radians(angle), np.radians(sigma), side, 50, high_sun=high)
        scene.after_detection(_seen(), angle_now, 0.01)
        return scene.sun.confirmed

    assert proven(0.0, 0.95 * limit) and not proven(0.0, 1.05 * limit)
    assert proven(9.0, 5.0) and not proven(9.0, 0.95 * limit)
    assert not proven(0.0, 5.0, side=3.0)
    assert not proven(float("nan"), float("inf"))
    # Under a lower Sun it will soon be known better.
    assert not proven(0.0, 0.95 * limit, high=False) and proven(0.0, 4.9, high=False)


def _seen():
    rng = np.random.default_rng(5)
    relief = flat_terrain(200.0, 2.0).relief
    rocks = place_rocks(
        relief, np.full(200, 1.2), rng, model=RockModel("cube", burial=(0.0, 0.0))
    )  # fmt: skip
    state, camera, counts = picture(Terrain(relief, rocks), (0.0, -20.0, 60.0), (AZIMUTH, 45.0))
    sun = direction_from_angles(AZIMUTH, np.radians(45.0))
    return detect_rocks(counts, camera, state, sun)


def test_of_two_measurements_the_better_counts_and_none_if_they_contradict():
    good, poor = SunAngle(0.1, 0.05, 6.0, 30), SunAngle(0.0, 0.2, 3.0, 9)
    none = SunAngle(float("nan"), float("inf"), 0.0, 0)
    assert more_accurate_angle(good, poor) is good and more_accurate_angle(poor, good) is good
    assert more_accurate_angle(none, poor) is poor
    assert not np.isfinite(more_accurate_angle(good, SunAngle(1.5, 0.1, 6.0, 30)).sigma)


def test_faces_of_half_spheres_lie_towards_the_sun():
    """By symmetry; seen from the side they lean away from the camera, since they stand higher."""
    model = ShadowModel(np.radians(45.0))
    turn = np.radians([0.0, 180.0, 120.0, -120.0])
    direction, axis = lit_faces(model, turn, np.radians([90.0, 60.0, 60.0, 60.0]))
    assert direction[:2] == pytest.approx([-1.0, -1.0], abs=0.08)
    assert direction[2] == pytest.approx(np.conj(direction[3]), abs=0.05)
    # The camera stands to the right of the Sun: what is lit leans to the left.
    assert direction[2].imag < -0.02
    # The patch of a half sphere under so high a Sun is broader than long.
    assert axis[0].real < -0.2 and axis[0].imag == pytest.approx(0.0, abs=0.05)


def test_terrain_without_rocks_contains_nothing_about_a_high_sun():
    sun = direction_from_angles(AZIMUTH, np.radians(45.0))
    terrain = flat_terrain(260.0, 2.0)
    state, camera, counts = picture(terrain, (0.0, 0.0, 70.0), (AZIMUTH, 45.0))
    seen = detect_rocks(counts, camera, state, sun)
    model = ShadowModel(np.radians(45.0))
    turn = measure_shadow_angle(seen, camera.view(state), np.empty((0, 3)), sun, model, 0.01)
    assert not np.isfinite(turn.sigma) and turn.number == 0
