"""Shadows on ground that slopes, against pictures of rocks whose places and sizes are known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lunarsim.frames import direction_from_angles
from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap
from lunarsim.onboard.hazards.shadows.viewing_geometry import viewing_geometry
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.onboard.perception.image_quality import ImageQualityCheck
from lunarsim.onboard.perception.shadow_direction import measure_shadow_angle
from lunarsim.onboard.perception.shadow_model import ShadowModel, tabulated_elevation
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.world.terrain import Terrain, place_rocks
from tests.shadow_scene import at, picture, tracker_at
from tests.slopes import sloping

# Rise to the east and north, place of the camera, Sun's azimuth and elevation (deg).
SCENES = [
    ((-0.17, 0.0), (-80.0, 0.0, 70.0), (3.67, 20.0)),
    ((0.15, 0.05), (-50.0, 0.0, 40.0), (3.67, 20.0)),
    ((0.0, -0.15), (-60.0, 0.0, 80.0), (3.67, 20.0)),
    ((0.12, -0.1), (50.0, 30.0, 60.0), (1.2, 12.0)),
]


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    """A picture of half spheres on a plane, and what there is to know of it."""
    gradient, place, (azimuth, elevation) = request.param
    rng = np.random.default_rng(3)
    diameters = sample_diameters(240.0**2, 0.05, 0.4, 3.0, rng)
    half_spheres = RockModel("hemisphere", burial=(0.0, 0.0))
    rocks = place_rocks(sloping(gradient, 240.0, 2.0), diameters, rng, model=half_spheres)
    terrain = Terrain(sloping(gradient, 1500.0, 10.0), rocks)
    state, camera, counts = picture(terrain, place, (azimuth, elevation))
    return SimpleNamespace(
        state=state, camera=camera, counts=counts, rocks=rocks, gradient=gradient,
        sun=direction_from_angles(azimuth, np.radians(elevation)),
        model=ShadowModel(np.radians(elevation)),
    )  # fmt: skip


def read(scene, plane):
    return detect_rocks(
        scene.counts, scene.camera, scene.state, scene.sun, terrain=plane, model=scene.model
    )


def off_by(scene, seen):
    """Return how far rocks lie from where they were seen, m, and sizes seen over theirs."""
    sharp = seen.q > 4.0
    true = np.column_stack((scene.rocks.x, scene.rocks.y))
    distance, at = cKDTree(true).query(seen.terrain_xy[sharp])
    radius = np.sqrt(scene.rocks.a * scene.rocks.b)[at]
    return distance, seen.radius[sharp] / radius


def test_rocks_are_where_they_stand_and_as_large_as_they_are(scene):
    distance, size = off_by(scene, read(scene, GroundPlane(0.0, scene.gradient)))
    assert len(distance) > 20
    assert np.median(distance) < 0.25
    assert np.quantile(distance, 0.9) < 0.6
    assert np.median(size) == pytest.approx(1.0, abs=0.12)
    level, _ = off_by(scene, read(scene, 0.0))
    assert np.median(level) > 2.0 * np.median(distance)


def turn(scene, plane, sun):
    seen = detect_rocks(
        scene.counts, scene.camera, scene.state, sun, terrain=plane, model=scene.model
    )
    before = ImageQualityCheck().before_detection(scene.counts, scene.camera, scene.state)
    onto = plane.level_direction(sun)
    return measure_shadow_angle(
        seen, plane.level_view(scene.camera.view(scene.state)),
        np.column_stack((seen.terrain_xy, np.zeros(len(seen)))), onto,
        scene.model.under(float(np.arcsin(onto[2]))), before.metrics["noise"],
    )  # fmt: skip


@pytest.mark.parametrize("off", [0.0, 30.0, 180.0])
def test_the_sun_is_reported_where_it_is_over_a_slope(scene, off):
    cos, sin = np.cos(np.radians(off)), np.sin(np.radians(off))
    # Clockwise from above.
    east, north, up = scene.sun
    believed = np.array([cos * east + sin * north, cos * north - sin * east, up])
    found = turn(scene, GroundPlane(0.0, scene.gradient), believed)
    assert (abs(np.degrees(found.angle)) < 10.0) == (off == 0.0)
    assert (abs(np.degrees(found.angle)) > 15.0) == (off > 0.0)
    assert found.side > 4.0


def test_observations_are_as_sharp_as_shadows_along_the_plane_are_long(scene):
    plane = GroundPlane(0.0, scene.gradient)
    view = scene.camera.view(scene.state)
    drawn = ProbabilityMap(Grid.centred((0.0, 0.0), 40.0, 1.0), scene.model, HazardPrior(0.05, 1.0))
    drawn.add_image(view, scene.sun, read(scene, plane), plane.heights, plane=plane)
    evidence = drawn.evidence
    # Every fourth place is worked out.
    found = np.maximum(evidence.lit[0], evidence.dark[0])[::4, ::4]
    xy = np.stack(np.meshgrid(evidence.grid.x[::4], evidence.grid.y[::4]), -1)
    place = np.dstack((xy, plane.heights(xy.reshape(-1, 2)).reshape(xy.shape[:2])))
    focal = float(np.sqrt(view.fx * view.fy))
    model = scene.model.under(float(np.arcsin(plane.level_direction(scene.sun)[2])))
    sharp = model.visible_q(1.0, *viewing_geometry(place, view.position, focal, scene.sun, plane))
    looked = found > 0.0
    assert looked.sum() > 50
    np.testing.assert_allclose(found[looked], sharp[looked], rtol=1e-5)
    level = scene.model.visible_q(
        1.0, *viewing_geometry(place, view.position, focal, scene.sun, plane)
    )
    assert np.median(abs(level[looked] / sharp[looked] - 1.0)) > 0.03


def test_terrain_above_the_camera_shows_no_rocks(scene):
    """Lines of sight that go up meet it, from below."""
    rise = 2.0 * np.array(scene.state.position[:2]) / np.hypot(*scene.state.position[:2])
    over = GroundPlane.through((0.0, 0.0, 0.0), rise)
    assert over.level_points(scene.state.position)[2] < 0.0
    assert len(read(scene, over)) == 0


def test_flat_terrain_is_read_as_without_a_plane(scene):
    for name in (
        "pixel",
        "pixel_covariance",
        "terrain_xy",
        "radius",
        "radius_sigma",
        "q",
        "shapes",
    ):
        one, other = (getattr(read(scene, p), name) for p in (1.5, GroundPlane(1.5, (0.0, 0.0))))
        np.testing.assert_array_equal(one, other)


def test_rocks_are_started_where_a_slope_turns_from_the_sun(scene):
    """Looks are vague along a low Sun, on ground that makes it one too: they begin rocks alike."""
    begun = {}
    for name, plane in (("slope", GroundPlane(0.0, scene.gradient)), ("level", LEVEL)):
        tracker = tracker_at(scene.state.position)
        tracker.update(read(scene, plane), scene.camera, scene.sun, 0.0, plane)
        begun[name] = tracker.filter.count
    assert begun["slope"] > 0.6 * begun["level"] > 5, begun


def test_shadows_on_a_slope_show_what_is_clear():
    """Under a Sun that a slope faces shadows are short: lit ground beyond them shows nothing."""
    gradient, place, sun = (0.08, 0.14), (-50.0, 0.0, 40.0), (3.67, 12.0)
    rng = np.random.default_rng(5)
    diameters = np.full(500, 1.2)
    half_spheres = RockModel("hemisphere", burial=(0.0, 0.0))
    rocks = place_rocks(sloping(gradient, 240.0, 2.0), diameters, rng, model=half_spheres)
    terrain = Terrain(sloping(gradient, 1500.0, 10.0), rocks)
    state, camera, counts = picture(terrain, place, sun)
    towards = direction_from_angles(sun[0], np.radians(sun[1]))
    model = ShadowModel(np.radians(sun[1]))
    plane = GroundPlane(0.0, gradient)
    grid = Grid.centred((0.0, 0.0), 60.0, 0.25)
    cell_centres = np.column_stack((rocks.x, rocks.y))
    missed = {}
    for name, along in (("slope", plane), ("level", LEVEL)):
        seen = detect_rocks(counts, camera, state, towards, terrain=along, model=model)
        drawn = ProbabilityMap(grid, model, HazardPrior(0.05, 1.0))
        drawn.add_image(camera.view(state), towards, seen, plane.heights, plane=along)
        places = drawn.evidence.grid
        row, col = places.cell(cell_centres[grid.contains(cell_centres)])
        lit, dark = (layer[0, row, col] for layer in (drawn.evidence.lit, drawn.evidence.dark))
        looked = (lit > 0.0) | (dark > 0.0)
        assert looked.sum() > 20
        missed[name] = (lit > dark)[looked].mean()
    assert missed["slope"] < 0.1
    assert missed["level"] > missed["slope"] + 0.1


def test_coordinates_in_which_a_plane_is_level():
    rng = np.random.default_rng(8)
    plane = GroundPlane.through((3.0, -2.0, 5.0), (0.2, -0.1))
    xy = rng.normal(0.0, 30.0, (20, 2))
    on = np.column_stack((xy, plane.heights(xy)))
    assert plane.heights(np.array([[3.0, -2.0]])) == pytest.approx(5.0)
    np.testing.assert_allclose(plane.level_points(on)[:, 2], 0.0, atol=1e-12)
    # A point comes to lie in the same pixel.
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    view = View(np.array([1.0, 2.0, 90.0]), axes, 500.0, 500.0, 0.0, 0.0, 640, 480)
    other = plane.level_view(view)
    np.testing.assert_allclose(
        (plane.level_points(on) - other.position) @ other.enu_to_sensor.T,
        (on - view.position) @ axes,
        atol=1e-9,
    )
    assert plane.level_direction(np.array([0.0, 0.0, 1.0])) == pytest.approx([0.0, 0.0, 1.0])
    assert LEVEL.level_view(view).axes is view.axes


@pytest.mark.parametrize("gradient", [(0.0, 0.0), (0.2, -0.1), (-0.25, 0.1)])
def test_terrain_shows_as_many_pixels_as_flat_terrain_of_its_aspect(gradient):
    """Pixels of a square on the plane, of equal size in the plan, against corners projected."""
    plane = GroundPlane.through((3.0, -2.0, 5.0), gradient)
    state, camera = at((-60.0, 30.0, 50.0))
    view = camera.model.view(state)
    # In the middle of the image: towards its edges a pixel is less of a turn.
    middle = np.zeros((1, 2))
    place = np.column_stack((middle, plane.heights(middle)))
    focal = float(np.sqrt(view.fx * view.fy))
    east = np.array([1.0, 0.0, 0.0])
    azimuth, depression, pixel = viewing_geometry(place, view.position, focal, east, plane)
    xy = 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = np.column_stack((xy, plane.heights(xy)))
    u, v = view.pinhole.project((corners - view.position) @ view.axes).T
    shown = 0.5 * abs(u @ np.roll(v, -1) - v @ np.roll(u, -1))
    assert 0.04 * np.sin(depression) / pixel**2 == pytest.approx(shown, rel=0.01)
    # The camera looks from where it did, and from above its own horizon on the plane.
    away = view.position - place
    np.testing.assert_allclose(azimuth, np.arctan2(away[:, 0], away[:, 1]) - 0.5 * np.pi)
    rise = away[:, :2] @ np.array(gradient)
    np.testing.assert_allclose(
        np.tan(depression), (away[:, 2] - rise) / np.hypot(away[:, 0], away[:, 1])
    )


def test_tables_are_made_for_few_suns():
    start = np.radians(20.0)
    assert tabulated_elevation(start, start) == start
    for degrees in np.linspace(5.0, 60.0, 40):
        near = tabulated_elevation(np.radians(degrees), start)
        assert np.tan(near) / np.tan(np.radians(degrees)) == pytest.approx(1.0, abs=0.05)
    # Ground that slopes away from the Sun by more than it is high lies in its own shadow.
    for degrees, least in ((-6.0, 2.0), (0.0, 2.0), (1.9, 2.0), (85.0, 80.0)):
        assert tabulated_elevation(np.radians(degrees), start) == pytest.approx(np.radians(least))
    model = ShadowModel(start)
    assert model.under(start + 1e-4) is model
    assert model.under(np.radians(12.0)).patch(0.0, 1.0).length > model.patch(0.0, 1.0).length
