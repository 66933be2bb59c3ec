"""The mapper over ground that another has measured, and how one comes to know of the other."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from lunarsim.frames import direction_from_angles
from lunarsim.grid import Grid
from lunarsim.messages.measurements import CameraImage
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.mapper import build_mappers
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap, ShadowMapper
from lunarsim.onboard.hazards.shadows.mapping import ShadowMapping
from lunarsim.onboard.hazards.shadows.terrain_errors import (
    MeasuredTerrain,
    fit_terrain_plane,
    position_sigma,
)
from lunarsim.onboard.hazards.shadows.viewing_geometry import viewing_geometry
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.image_quality import ImageQualityCheck
from lunarsim.onboard.perception.shadow_direction import measure_shadow_angle
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.population import RockExpectation
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.world.terrain import Terrain, place_rocks
from tests.shadow_scene import picture, tracker_at
from tests.slopes import Slope, sloping

GRADIENT, PLACE = (0.0, -0.15), (0.0, -60.0, 70.0)
AZIMUTH, ELEVATION = 3.67, np.radians(20.0)
SUN, MODEL = direction_from_angles(AZIMUTH, ELEVATION), ShadowModel(ELEVATION)
GRID = Grid.centred((0.0, 0.0), 40.0, 0.5)


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(3)
    diameters = sample_diameters(160.0**2, 0.05, 0.3, 3.0, rng)
    rocks = place_rocks(sloping(GRADIENT, 160.0, 2.0), diameters, rng, model=RockModel("irregular"))
    terrain = Terrain(sloping(GRADIENT, 1500.0, 10.0), rocks)
    return picture(terrain, PLACE, (AZIMUTH, np.degrees(ELEVATION)))


def parts_of_a_map():
    return tracker_at(PLACE, MODEL), ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))


def look(scene, relief, turned=0.0):
    """Let a mapper see the picture, its Sun turned from where it is, deg."""
    tracker, probability = parts_of_a_map()
    sun = direction_from_angles(AZIMUTH + np.radians(turned), ELEVATION)
    mapper = ShadowMapper(tracker, probability, sun, 1.0, terrain_mapper=relief)
    update(mapper, scene)
    return mapper


def update(mapper, scene):
    _, camera, counts = scene
    rocks = mapper.tracker.filter
    estimate = rocks.inertial.estimate(rocks.covariance, 0.0, 1.0)
    mapper.update(CameraImage(0.0, counts, camera.model), estimate)


def test_rocks_are_found_tracked_and_ruled_out_along_the_measured_terrain(scene):
    state, camera, counts = scene
    mapper = look(scene, Slope(GRADIENT))
    plane = fit_terrain_plane(Slope(GRADIENT).drawn)
    seen = detect_rocks(counts, camera.model, state, SUN, terrain=plane, model=MODEL)
    np.testing.assert_array_equal(mapper.seen.terrain_xy, seen.terrain_xy)
    tracker, probability = parts_of_a_map()
    tracker.filter.measured_terrain = MeasuredTerrain(Slope(GRADIENT))
    tracker.update(seen, camera.model, SUN, 0.0, plane)
    np.testing.assert_array_equal(mapper.tracker.filter.xyz, tracker.filter.xyz)
    assert mapper.tracker.filter.count > 0
    probability.add_image(
        camera.model.view(tracker.filter.inertial), SUN, seen, tracker.filter.terrain_height_at,
        tracker.explained, partial(position_sigma, tracker.filter), plane,
    )  # fmt: skip
    np.testing.assert_array_equal(mapper.probability.evidence.lit, probability.evidence.lit)
    assert probability.evidence.lit.any()


def test_the_sun_is_evaluated_along_the_measured_terrain(scene):
    """This picture does not tell where the Sun is if the ground is taken to be level."""
    assert not look(scene, Slope(GRADIENT)).rejected_images
    assert look(scene, None).rejected_images
    mapper = look(scene, Slope(GRADIENT), 30.0)
    state, camera, counts = scene
    sun = direction_from_angles(AZIMUTH + np.radians(30.0), ELEVATION)
    plane = fit_terrain_plane(Slope(GRADIENT).drawn)
    seen = detect_rocks(counts, camera.model, state, sun, terrain=plane, model=MODEL)
    onto = plane.level_direction(sun)
    sun_angle = measure_shadow_angle(
        seen, plane.level_view(camera.model.view(state)),
        np.column_stack((seen.terrain_xy, np.zeros(len(seen)))), onto,
        MODEL.under(float(np.arcsin(onto[2]))),
        ImageQualityCheck().before_detection(counts, camera.model, state).metrics["noise"],
    )  # fmt: skip
    (event,) = [e for e in mapper.tracker.filter.events if e.name == "image-rejected"]
    assert event.details["turn"] == pytest.approx(sun_angle.angle)


@pytest.mark.parametrize("turned", [30.0, -30.0, 180.0])
@pytest.mark.parametrize("relief", [None, Slope(GRADIENT)])
def test_under_a_sun_that_is_elsewhere_no_terrain_is_seen(scene, relief, turned):
    mapper = look(scene, relief, turned)
    assert mapper.rejected_images.total() == 1
    assert not mapper.hazard_map().observed.any()


def test_terrain_that_nobody_has_measured_yet_is_level(scene):
    blind = Slope(GRADIENT)
    blind.drawn = blind.unobserved()
    one, other = look(scene, blind), look(scene, None)
    assert one.rejected_images == other.rejected_images
    np.testing.assert_array_equal(one.tracker.filter.xyz, other.tracker.filter.xyz)


PLANE = GroundPlane(0.0, (-0.2, -0.1))


def missed(scene, radius, labels=None):
    """Return by what the odds of a rock at the origin fall that a picture does not show."""
    state, camera, counts = scene
    nothing = detect_rocks(np.full_like(counts, 90), camera.model, state, SUN, model=MODEL)
    assert len(nothing) == 0
    tracker = tracker_at(PLACE, MODEL)
    tracker.add_known([[0.0, 0.0]], 0.1, radius, 0.01)
    before = tracker.existence[0]
    seen = nothing if labels is None else replace(nothing, labels=labels)
    tracker.update(seen, camera.model, SUN, 0.0, PLANE)
    after = tracker.existence[0]
    return after / (1.0 - after) * (1.0 - before) / before


def viewing_angles(scene):
    state, camera, _ = scene
    view = camera.model.view(state)
    towards = PLANE.level_direction(SUN)
    model = MODEL.under(float(np.arcsin(towards[2])))
    focal = float(np.sqrt(view.fx * view.fy))
    return view, model, viewing_geometry(np.zeros((1, 3)), view.position, focal, SUN, PLANE)


def test_a_rock_that_is_not_seen_is_missed_by_what_it_shows_on_a_slope(scene):
    _, model, (azimuth, depression, pixel) = viewing_angles(scene)
    rates = DetectionRates()
    radius = 2.2 / model.visible_q(1.0, azimuth, depression, pixel)[0]
    level = MODEL.visible_q(radius, azimuth, depression, pixel)
    expected = rates.false_negative(np.array([2.2]))[0]
    assert 0.6 < rates.false_negative(level)[0] < 1.0
    assert abs(rates.false_negative(level)[0] - expected) > 0.05
    assert missed(scene, radius) == pytest.approx(np.clip(expected, 0.6, 1.0), rel=1e-6)


def test_a_rock_is_not_missing_whose_shadow_on_a_slope_falls_into_the_dark(scene):
    view, model, (azimuth, depression, _) = viewing_angles(scene)
    unit = model.patch(azimuth, depression)
    towards = SUN[:2] / np.hypot(*SUN[:2])
    off = 2.0 * (unit.along[0] * towards + unit.across[0] * np.array([-towards[1], towards[0]]))
    middle = np.array([*off, off @ np.array(PLANE.gradient)])
    u, v = np.rint(view.pinhole.project((middle - view.position)[None] @ view.axes)[0]).astype(int)
    labels = np.zeros((view.height, view.width), np.int32)
    labels[v - 1 : v + 2, u - 1 : u + 2] = 1
    assert missed(scene, 2.0, labels) == pytest.approx(1.0)
    assert missed(scene, 2.0) < 0.7


def test_a_mapper_is_built_after_the_one_whose_terrain_it_asks_for(scene):
    state, _, _ = scene
    inertial = StrapdownState(state.position, np.zeros(3), state.attitude, 1.622)
    ground = TerrainPrior(0.0, 2.0)
    navigation = Navigator(
        inertial, StartSigmas(1e-3, 1e-3, 1e-5), terrain_prior=ground, rocks=True
    )
    relief = Slope(GRADIENT)
    received = {}

    def fused(briefing, navigation, mappers):
        received.update(mappers)
        return Slope((0.0, 0.0))

    parts = {
        "all": SimpleNamespace(inputs=(), build=fused),
        "eye": ShadowMapping(shapes="hemisphere", size=40.0, terrain_mapper="dem"),
        "dem": SimpleNamespace(build=lambda briefing, navigation: relief),
    }
    briefing = SimpleNamespace(
        software=SimpleNamespace(mappers=parts), lander=Lander(), rocks=RockExpectation(),
        target=np.zeros(3), sun=SUN, instruments={},
    )  # fmt: skip
    built = build_mappers(briefing, navigation)
    assert list(built) == list(parts)
    assert set(received) == {"eye", "dem"}
    tracked = built["eye"].tracker.settings
    assert tracked.min_landmark_radius < 0.5 * tracked.min_radius
    assert not relief.asked
    update(built["eye"], scene)
    assert relief.asked
