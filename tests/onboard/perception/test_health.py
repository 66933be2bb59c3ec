"""Health of pictures: nothing that is wrong counts, and what is right mostly does."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from lunarsim.frames import direction_from_angles
from lunarsim.onboard.perception import image_quality as quality
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.image_quality import (
    ImageQualityCheck,
    ImageRejection,
)
from lunarsim.onboard.perception.shadow_direction import SunAngle, measure_shadow_angle
from lunarsim.onboard.perception.shadow_model import ShadowModel
from tests.conftest import ROOT
from tests.picture_faults import all_faults, defocused, halved, rocky, smeared
from tests.shadow_scene import at, picture

# Terrain (seed, cover, slope, shape), place, Sun's azimuth and elevation (deg).
SCENES = [
    ((3, 0.05, 0.0, "cube"), (0.0, 0.0, 40.0), (1.2, 20.0)),
    ((5, 0.03, 2.0, "mixed"), (-20.0, 25.0, 45.0), (4.0, 10.0)),
    ((8, 0.08, 4.0, "hemisphere"), (15.0, 8.0, 30.0), (2.5, 35.0)),
    ((9, 0.05, 3.0, "irregular"), (5.0, -12.0, 35.0), (5.5, 6.0)),
]


@pytest.fixture(scope="module", params=range(len(SCENES)))
def scene(request):
    ground, place, sun = SCENES[request.param]
    terrain = rocky(*ground)
    place = np.array(place)
    level = float(terrain.elevation(np.zeros((1, 2)))[0])
    place[2] += level
    state, camera, counts = picture(terrain, place, sun)
    direction = direction_from_angles(sun[0], np.radians(sun[1]))
    return state, camera, counts, direction, level


def judge(scene, counts, sun=None, health=None):
    state, camera, _, right, level = scene
    sun = right if sun is None else sun
    health = health or ImageQualityCheck()
    verdict = health.before_detection(counts, camera, state)
    if not verdict.good:
        return verdict
    model = ShadowModel(float(np.arcsin(sun[2])))
    seen = detect_rocks(counts, camera, state, sun, terrain=level, model=model)
    points = np.column_stack((seen.terrain_xy, np.full(len(seen), level)))
    noise = verdict.metrics["noise"]
    turn = measure_shadow_angle(seen, camera.view(state), points, sun, model, noise)
    return health.after_detection(seen, turn, noise)


def test_good_images_count(scene):
    assert judge(scene, scene[2]).fault is None


def test_no_fault_of_an_image_counts(scene):
    for name, counts in all_faults(scene[2], np.random.default_rng(7)).items():
        assert not judge(scene, counts).good, name


@pytest.mark.parametrize("off", [30.0, -30.0, 90.0, 180.0])
def test_no_image_counts_under_a_sun_that_is_elsewhere(scene, off):
    c, s = np.cos(np.radians(off)), np.sin(np.radians(off))
    wrong = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ scene[3]
    assert not judge(scene, scene[2], wrong).good


def test_the_reason_is_reported(scene):
    rng = np.random.default_rng(1)
    faults = all_faults(scene[2], rng)
    for name, why in {
        "black": ImageRejection.FAINT, "white": ImageRejection.SATURATED,
        "no numbers": ImageRejection.NO_NUMBERS,
        "noise": ImageRejection.NOISE, "grey with shot noise": ImageRejection.NO_SHADOWS,
        "half black": ImageRejection.GAPS,
        "half white": ImageRejection.SATURATED, "repeated rows": ImageRejection.GAPS,
        "wrong size": ImageRejection.FORM,
        "colour": ImageRejection.FORM, "words": ImageRejection.FORM, "complex": ImageRejection.FORM,
        "true or false": ImageRejection.FORM,
        "picture under noise": ImageRejection.NOISE, "far too dark": ImageRejection.FAINT,
    }.items():  # fmt: skip
        assert judge(scene, faults[name]).fault is why, name
    assert judge(scene, faults["strong defocus"]).fault in {
        ImageRejection.BLURRED,
        ImageRejection.NO_SHADOWS,
    }
    unsharp = {ImageRejection.BLURRED, ImageRejection.SMEARED, ImageRejection.NO_SHADOWS}
    assert {judge(scene, faults[name]).fault for name in ("defocus", "smear")} <= unsharp
    # Nothing is wrong with ground on which there is nothing to see.
    assert not judge(scene, faults["grey with shot noise"]).alarm
    assert judge(scene, faults["black"]).alarm


@pytest.mark.statistical
def test_a_smear_of_12_pixels_hardly_ever_counts(scene):
    """One in about a hundred does; more than two of six have a chance of 2e-5."""
    rng = np.random.default_rng(2)
    assert sum(judge(scene, smeared(scene[2], rng, 12.0)).good for _ in range(6)) <= 2


def test_a_frame_read_again_does_not_count_in_whole_or_in_part(scene):
    state, camera, counts = scene[:3]
    rng = np.random.default_rng(3)

    def again():
        return (counts + rng.integers(-1, 2, counts.shape)).clip(0, 255).astype(np.uint8)

    health = ImageQualityCheck()
    frames = [again() for _ in range(4)]
    for frame in frames[:3]:
        assert health.before_detection(frame, camera, state).good
    # Two buffers that take turns are stuck as well.
    assert health.before_detection(frames[2], camera, state).fault is ImageRejection.STUCK
    assert health.before_detection(frames[1], camera, state).fault is ImageRejection.STUCK
    half = frames[3].copy()
    half[:240] = frames[2][:240]
    assert health.before_detection(half, camera, state).fault is ImageRejection.STUCK
    assert health.before_detection(again(), camera, state).good


def test_a_pose_that_is_none_is_not_looked_from(scene):
    state, camera, counts = scene[:3]
    health = ImageQualityCheck()
    for bad in (
        replace(state, position=np.array([0.0, np.nan, 40.0])),
        replace(state, attitude=np.array([0.0, 0.0, 0.0, 1.5])),
        replace(state, attitude=np.full(4, np.nan)),
    ):
        assert health.before_detection(counts, camera, bad).fault is ImageRejection.POSE


def test_sky_above_the_horizon_is_no_missing_half():
    terrain = rocky(3, 0.05, 0.0)
    place = np.array([0.0, -60.0, 25.0])
    state, camera = at(place)
    # Level view to the north: the upper half is sky.
    level = replace(camera, mount=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
    from lunarsim.world import World
    from lunarsim.world.light import Light

    world = World(terrain, 1.622, Light(1.2, np.radians(20.0)))
    counts = level.expose(world, state, 0.0, np.random.default_rng(0)).counts
    assert (counts[:200] <= 1).all()
    assert ImageQualityCheck().before_detection(counts, level, state).good
    upside_down = replace(level, mount=level.mount @ np.diag([-1.0, -1.0, 1.0]))
    assert not ImageQualityCheck().before_detection(counts, upside_down, state).good


def test_noise_is_measured(scene):
    state, camera = scene[:2]
    rng = np.random.default_rng(5)
    ramp = 90.0 + 0.05 * np.arange(640) + np.zeros((480, 1))
    for sigma in (1.5, 4.0):
        counts = np.rint(ramp + sigma * rng.standard_normal(ramp.shape)).astype(np.uint8)
        found = ImageQualityCheck().before_detection(counts, camera, state).metrics
        # That of the noisiest of sixteen parts.
        assert found["noise"] * found["lit"] == pytest.approx(sigma, rel=0.15)


def test_a_sun_once_seen_is_believed_until_shadows_say_otherwise(scene):
    state, camera, counts, sun, level = scene
    seen = detect_rocks(counts, camera, state, sun, terrain=level)
    health = ImageQualityCheck()
    silent = SunAngle(np.nan, np.inf, 0.0, 0)
    either = SunAngle(0.0, 0.02, 2.5, 900)
    there, between, away = (SunAngle(np.radians(a), 0.02, 6.0, 60) for a in (2.0, 12.0, 25.0))
    for turn, fault in (
        (silent, ImageRejection.SUN_UNPROVEN), (either, ImageRejection.SUN_UNPROVEN), (between,
        ImageRejection.SUN_UNPROVEN),
        (there, None), (silent, None), (between, None), (away, ImageRejection.SUN_ELSEWHERE),
        (silent, ImageRejection.SUN_UNPROVEN), (there, None),
    ):  # fmt: skip
        assert health.after_detection(seen, turn, 0.02).fault is fault


def test_craters_do_not_indicate_a_wrong_sun_direction(scene):
    """What is dark beside bright in all directions may be turned as a whole, and is no rock."""
    state, camera, counts, sun, level = scene
    seen = detect_rocks(counts, camera, state, sun, terrain=level)
    craters = SunAngle(np.radians(34.0), np.radians(4.8), 13.0, 306)
    rocks = SunAngle(np.radians(34.0), np.radians(4.8), 14.0, 306)
    assert craters.agreement == pytest.approx(0.529, abs=1e-3)
    health = ImageQualityCheck()
    assert health.after_detection(seen, craters, 0.02).fault is ImageRejection.SUN_UNPROVEN
    assert not health.is_conclusive(craters)
    assert health.after_detection(seen, rocks, 0.02).fault is ImageRejection.SUN_ELSEWHERE
    assert health.is_conclusive(rocks)
    # Nor do axes tell it that lit faces deny.
    for faces, fault in (
        (-14.0, ImageRejection.SUN_UNPROVEN),
        (16.0, ImageRejection.SUN_ELSEWHERE),
    ):
        both = replace(rocks, by_faces=np.radians(faces))
        assert ImageQualityCheck().after_detection(seen, both, 0.02).fault is fault
    # Under a high Sun the side is told by other means, which agreement does not measure.
    high = replace(craters, high_sun=True)
    assert health.after_detection(seen, high, 0.02).fault is ImageRejection.SUN_ELSEWHERE
    assert health.is_conclusive(high)
    # Bright boulders turn it there.
    turned = replace(high, angle=np.radians(20.0))
    assert health.after_detection(seen, turned, 0.02).fault is ImageRejection.SUN_UNPROVEN
    assert not health.is_conclusive(turned)
    # Directions that agree less may show the Sun in its place, and what tells nothing judges not.
    assert health.is_conclusive(replace(craters, angle=np.radians(14.0)))
    assert not health.is_conclusive(SunAngle(np.nan, np.inf, 0.0, 0))
    assert SunAngle(np.nan, np.inf, 0.0, 0).agreement == 0.0


def test_a_sun_that_shadows_put_elsewhere_is_not_proven_and_no_more_believed(scene):
    """Where shadows run into each other few directions agree, and they may be the wrong ones."""
    state, camera, counts, sun, level = scene
    seen = detect_rocks(counts, camera, state, sun, terrain=level)

    def told(degrees, sigma, side, number):
        turn = SunAngle(np.radians(degrees), np.radians(sigma), side, number)
        return health.after_detection(seen, turn, 0.02).fault

    health = ImageQualityCheck()
    # Agreement of 0.18 proves nothing, one of 0.25 does.
    assert told(-6.0, 3.0, 8.4, 1110) is ImageRejection.SUN_UNPROVEN
    assert told(-6.0, 3.0, 8.4, 570) is None
    # Craters may say otherwise: such a picture does not count, and changes nothing as long as it
    # says so less surely.
    assert told(179.0, 3.3, 7.1, 90) is ImageRejection.SUN_UNPROVEN
    assert told(179.0, 5.2, 4.6, 56) is ImageRejection.SUN_UNPROVEN  # no less so if known less well
    assert told(np.nan, np.inf, 0.0, 0) is None
    assert told(174.0, 3.0, 9.3, 340) is ImageRejection.SUN_UNPROVEN
    assert told(np.nan, np.inf, 0.0, 0) is ImageRejection.SUN_UNPROVEN
    assert told(1.0, 3.0, 5.0, 60) is None
    # An angle far less certain than that it is elsewhere tells nothing.
    assert told(17.0, 4.0, 3.0, 60) is None
    assert told(14.0, 4.0, 6.0, 60) is None


@pytest.mark.parametrize(("veil", "fault"), [(0.0, None), (0.6, ImageRejection.VEILED)])
def test_dust_or_stray_light_over_all_of_an_image_is_noticed(scene, veil, fault):
    counts = scene[2] + veil * (np.median(scene[2]) - scene[2])
    noisy = counts + 0.4 * np.random.default_rng(0).standard_normal(counts.shape)
    found = judge(scene, np.rint(noisy).clip(0, 255).astype(np.uint8))
    if fault is None:
        assert found.fault is None and found.metrics["shade"] < 0.3
    else:
        assert found.fault in {
            fault,
            ImageRejection.NO_SHADOWS,
            ImageRejection.BLURRED,
            ImageRejection.SUN_UNPROVEN,
        }
        assert found.metrics.get("shade", 1.0) > 0.35


def test_mild_defocus_is_reported_by_the_cameras_own_point_spread(scene):
    soft = defocused(scene[2], np.random.default_rng(2), 1.5)
    assert judge(scene, soft).fault in {
        ImageRejection.BLURRED,
        ImageRejection.SMEARED,
        ImageRejection.NO_SHADOWS,
    }
    # A camera that is as soft as that by itself sees what it should.
    known = ImageQualityCheck(1.6)
    assert judge(scene, soft, health=known).fault in {
        None,
        ImageRejection.NO_SHADOWS,
        ImageRejection.SUN_UNPROVEN,
    }


def test_half_an_image_from_before_the_shutter_is_noticed(scene):
    counts = halved(scene[2], np.random.default_rng(4), 3)
    assert judge(scene, counts).fault is ImageRejection.GAPS


def test_limits_are_those_of_the_page():
    page = (ROOT / "docs" / "explanation" / "shadow-images.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([\w ]+) \| [^|]+\| ([^|]*?) \|$", page, re.MULTILINE))
    limits_by_check = {
        "finite pixels": [100 * quality.MAX_MISSING_FRACTION], "exposure": [quality.MIN_LIT_COUNTS,
        100 * quality.MAX_SATURATED_FRACTION],
        "missing lines": [100 * quality.MAX_MISSING_FRACTION],
        "repeated image": [100 * quality.MAX_REPEATED_FRACTION],
        "noise": [100 * quality.MAX_NOISE],
        "dark area": [100 * quality.MAX_DARK_FRACTION], "shadows": [quality.MIN_SHADOWS],
        "focus": [quality.MAX_EDGE_WIDTH_RATIO],
        "smear": [quality.MAX_SMEAR_RATIO], "veil": [quality.MAX_SHADOW_BRIGHTNESS],
        "Sun direction": [np.degrees(quality.CONFIRM_ANGLE)],
    }  # fmt: skip
    for name, limits in limits_by_check.items():
        assert [float(n) for n in re.findall(r"[\d.]+", rows[name])] == pytest.approx(limits), name
