"""The Sun's disc, scattered light, Earthshine and albedo against closed forms and references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.frames import sensor_axes
from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.shapes import CUBE
from lunarsim.sensors.rendering import Renderer, renderer_of
from lunarsim.world.light import FULL_EARTH_IRRADIANCE_RATIO, Light
from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief, place_rocks
from tests.reference.photometry import scattered_light, scattered_on
from tests.worlds import flat_terrain

SUN = np.radians(0.533)
_PLANE = flat_terrain(400.0, 4.0)


def above(place, height, pixel, size):
    """A view straight down whose pixels are `pixel` wide on the ground."""
    w, h = size
    f = height / pixel
    axes = sensor_axes(np.array([0.0, 0.0, -1.0]))
    return View(np.array([*place, height]), axes, f, f, 0.5 * (w - 1), 0.5 * (h - 1), w, h)


def sun_share(terrain, view, light):
    """How much of the sunlight comes through: with shadows over without."""
    renderer = renderer_of(terrain)
    lit = renderer.render(view, light, shadows=False).radiance
    return renderer.render(view, light).radiance / np.maximum(lit, 1e-9)


@pytest.mark.parametrize(("elevation", "tilt", "azimuth"), [(20.0, 0.3, 1.0), (50.0, 0.68, 4.0)])
def test_hapke_is_drawn_as_it_is_computed(elevation, tilt, azimuth):
    light = Light(1.0, np.radians(elevation), photometry="hapke")
    boresight = np.array(
        [np.sin(tilt) * np.sin(azimuth), np.sin(tilt) * np.cos(azimuth), -np.cos(tilt)]
    )
    position = -60.0 * boresight
    view = View(position, sensor_axes(boresight), 60.0, 60.0, 39.5, 29.5, 80, 60)
    rays = view.rays()
    drawn = renderer_of(_PLANE).render(view, light).radiance
    told = light.radiance_factor(np.sin(light.elevation), -rays[..., 2], -rays @ light.direction)
    assert np.allclose(drawn, told, rtol=2e-3)


def wall(height):
    """A wall across the Sun's azimuth, so wide that its shadow has no sides in the picture."""
    one = np.ones(1)
    field = RockField(0 * one, 0 * one, 0 * one, 0.5 * one, 60.0 * one, height * one, 0 * one,
                      np.array([CUBE]))  # fmt: skip
    return Terrain(_PLANE.relief, field)


@pytest.mark.parametrize(
    ("elevation", "height", "pixel"),
    [(3.0, 1.0, 0.05), (3.0, 1.0, 0.3), (10.0, 2.0, 0.01), (30.0, 5.0, 0.01), (3.0, 4.0, 0.2)],
)
def test_penumbra_of_a_wall_is_the_closed_form(elevation, height, pixel):
    """3.4 m for a metre at 3 degrees; the share of the disc over a straight edge within it."""
    light = Light(1.5 * np.pi, np.radians(elevation), photometry="lambert", diameter=SUN)
    tip = 0.5 + height / np.tan(light.elevation)
    view = above((tip, 0.0), 60.0, pixel, (160, 8))
    x = tip + pixel * (np.arange(160) - 79.5)
    behind = x > 0.7
    x, share = x[behind], sun_share(wall(height), view, light)[4, behind]
    # The disc's lower edge is seen up to the angle at which the wall's top is seen.
    over = np.arctan2(height, x - 0.5)
    u = np.clip((light.elevation - over) / (0.5 * SUN), -1.0, 1.0)
    told = 0.5 + (u * np.sqrt(1.0 - u**2) + np.arcsin(u)) / np.pi
    wide = height * (1 / np.tan(light.elevation - SUN / 2) - 1 / np.tan(light.elevation + SUN / 2))
    assert np.mean(np.abs(share - told)) < 0.03
    dark, bright = (x[np.argmax(share > level)] for level in (0.1, 0.9))
    # From a tenth to nine tenths it is 0.687 of the diameter.
    assert bright - dark == pytest.approx(0.687 * wide, rel=0.15, abs=2.5 * pixel)
    if elevation == 3.0:
        assert wide == pytest.approx(3.4 * height, rel=0.02)


@pytest.fixture(scope="module")
def rocky():
    rng = np.random.default_rng(8)
    relief = fractal_relief(
        Grid.centred((0.0, 0.0), 120.0, 0.5), rng, hurst=0.8, rms_slope=np.radians(4.0)
    )
    diameters = rng.uniform(0.4, 2.5, 400)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("mixed")))


@pytest.mark.parametrize(("elevation", "most"), [(3.0, 0.08), (8.0, 0.05), (25.0, 0.04)])
def test_disc_is_the_mean_of_many_points(rocky, elevation, most):
    """On rocky relief, against pictures under points spread over the disc, each with hard edges."""
    view = above((3.0, -2.0), 80.0, 0.12, (160, 120))
    light = Light(1.2, np.radians(elevation), photometry="lambert")
    renderer = renderer_of(rocky)
    lit = renderer.render(view, light, shadows=False).radiance
    total, count = np.zeros_like(lit), 24
    for k in range(count):
        r, a = 0.5 * SUN * np.sqrt((k + 0.5) / count), 2.399963 * k
        azimuth = light.azimuth + r * np.cos(a) / np.cos(light.elevation)
        point = replace(light, azimuth=azimuth, elevation=light.elevation + r * np.sin(a))
        total += renderer.render(view, point).radiance > 0.0
    facing = lit > 0.02 * lit.max()
    ours = renderer.render(view, replace(light, diameter=SUN)).radiance / np.maximum(lit, 1e-9)
    hard = renderer.render(view, light).radiance > 0.0
    error = np.abs(ours - total / count)[facing]
    assert error.mean() < most
    assert error.mean() < 0.8 * np.abs(hard - total / count)[facing].mean()


def test_no_light_reaches_the_floor_of_a_crater_from_under_its_wall():
    """A deep bowl at a low Sun: dark wherever points all over the disc leave it dark."""
    grid = Grid.centred((0.0, 0.0), 100.0, 0.5)
    x, y = np.meshgrid(grid.x, grid.y)
    z = np.minimum(8.0 * (np.hypot(x, y) / 22.0) ** 2 - 8.0, 0.0)
    bowl = Terrain(Heightfield(grid, z.astype(np.float32)))
    view = above((0.0, 0.0), 80.0, 0.3, (160, 120))
    light = Light(1.2, np.radians(4.0), photometry="lambert")
    renderer = renderer_of(bowl)
    dark = np.ones((120, 160), bool)
    for k in range(16):
        r, a = 0.52 * SUN, 2.0 * np.pi * k / 16
        azimuth = light.azimuth + r * np.cos(a)
        point = replace(light, azimuth=azimuth, elevation=light.elevation + r * np.sin(a))
        dark &= renderer.render(view, point).radiance == 0.0
    ours = renderer.render(view, replace(light, diameter=SUN)).radiance
    assert dark.sum() > 2000
    assert np.mean(ours[dark] > 0.02 * ours.max()) < 0.003


def test_edges_of_shadows_are_smooth_where_pixels_are_coarse():
    """What is dark of a wall's shadow grows evenly as the camera moves by parts of a pixel."""
    light = Light(1.5 * np.pi, np.radians(20.0), photometry="lambert", diameter=SUN)
    length = 1.0 / np.tan(light.elevation)
    found = {}
    for diameter in (0.0, SUN):
        one = replace(light, diameter=diameter)
        dark = []
        for shift in np.linspace(0.0, 0.4, 9):
            view = above((1.9 + shift, 0.0), 100.0, 0.4, (24, 6))
            # The end of the shadow alone: the wall itself has the edges of its pixels.
            x = 1.9 + shift + 0.4 * (np.arange(24) - 11.5)
            beyond = np.clip((x - 1.3) / 0.4 + 0.5, 0.0, 1.0)
            darkness = 1.0 - sun_share(wall(1.0), view, one)[3]
            dark.append(0.4 * (darkness * beyond).sum())
        found[diameter] = np.std(dark)
        # Within half a pixel: at the foot of a wall no light may leak in.
        assert np.mean(dark) == pytest.approx(length + 0.5 - 1.3, abs=0.2)
    # What is left is the map's own texels, two thirds of a pixel.
    assert found[SUN] < 0.75 * found[0.0]


def test_shadows_of_a_valley_are_lit_by_its_other_side():
    """One bounce in a valley, against rays that are cast at random, of the same ground."""
    grid = Grid.centred((0.0, 0.0), 120.0, 1.0)
    east = np.meshgrid(grid.x, grid.y)[0]
    z = 12.0 * np.abs(east / 20.0) ** 2
    z = np.where(np.abs(east) < 25.0, z, 12.0 * 1.25**2)
    terrain = Terrain(Heightfield(grid, z.astype(np.float32)))
    light = Light(0.5 * np.pi, np.radians(25.0), photometry="lambert", scattered_light=True)
    places = np.array([[8.2, 0.3], [12.4, 3.3], [18.4, -7.2], [22.3, 11.2]])  # in the shade
    drawn, told = [], []
    for k, (x, y) in enumerate(places):
        height = float(terrain.elevation([x, y])) + 30.0
        view = above((x, y), height, 0.3, (9, 9))
        view = replace(view, position=np.array([x, y, height]))
        image = Renderer(terrain).render(view, light) if k == 0 else renderer_of(terrain).render(
            view, light)  # fmt: skip
        drawn.append(float(image.radiance[4, 4]))
        told.append(scattered_light(terrain, (x, y), light.direction, light.albedo, k))
    assert min(told) > 2e-4
    assert np.allclose(drawn, told, rtol=0.2)
    dark = renderer_of(terrain).render(view, replace(light, scattered_light=False)).radiance
    assert dark[4, 4] == 0.0


def test_shaded_sides_of_rocks_see_the_terrain():
    """The ground's mean light over half the sky; rays cast at random say how much that is too much.

    A rock's own shadow lies before its shaded side, which the map of scattered light leaves out.
    """
    one = np.ones(1)
    rock = RockField(0 * one, 0 * one, 0 * one, one, one, 2.0 * one, 0 * one, np.array([CUBE]))
    terrain = Terrain(_PLANE.relief, rock)
    light = Light(1.5 * np.pi, np.radians(40.0), photometry="lambert", scattered_light=True)
    boresight = np.array([-np.cos(0.3), 0.0, -np.sin(0.3)])
    view = View(-20.0 * boresight + [1.0, 0.0, 1.5], sensor_axes(boresight), 300.0, 300.0, 19.5,
                14.5, 40, 30)  # fmt: skip
    image = Renderer(terrain).render(view, light, truth=True)
    side = (image.identity == 0) & (image.normal[..., 0] > 0.99)
    assert side.sum() > 50
    told = 0.5 * light.albedo**2 * np.sin(light.elevation)
    assert image.radiance[side] == pytest.approx(told, rel=0.02)
    at = np.array([1.0, 0.0, 1.5])
    true = scattered_on(terrain, at, np.array([1.0, 0.0, 0.0]), light.direction, light.albedo, 0)
    assert 1.0 < told / true < 2.5


def test_flat_terrain_throws_no_light_on_itself():
    light = Light(1.0, 0.5)
    view = above((0.0, 0.0), 30.0, 0.5, (16, 12))
    plain, more = (
        renderer_of(_PLANE).render(view, one).radiance
        for one in (light, replace(light, scattered_light=True))
    )
    assert np.allclose(plain, more, rtol=1e-6)


def test_earthshine_is_the_only_light_of_the_night():
    view = above((0.0, 0.0), 30.0, 0.5, (16, 12))
    night = Light(
        0.0, -0.1, 0.2, earthshine=FULL_EARTH_IRRADIANCE_RATIO, earth_elevation=np.radians(40.0)
    )
    shine = renderer_of(_PLANE).render(view, night).radiance
    assert np.allclose(
        shine, 0.2 * FULL_EARTH_IRRADIANCE_RATIO * np.sin(np.radians(40.0)), rtol=1e-4
    )
    below = replace(night, earth_elevation=-0.2)
    assert np.all(renderer_of(_PLANE).render(view, below).radiance == 0.0)


def test_the_darkest_mottles_still_reflect_light():
    """Of a spread of 0.3 one in some 2000 places would have less than nothing."""
    light = Light(
        1.0,
        0.6,
        photometry="lambert",
        albedo_variation=0.3,
        albedo_correlation_length=0.5,
        albedo_seed=3,
    )
    field = renderer_of(_PLANE).render(above((13.0, 7.0), 40.0, 0.1, (512, 512)), light).radiance
    even = 0.12 * np.sin(0.6)
    assert 0.0 < field.min() < 0.03 * even
    assert field.mean() == pytest.approx(even, rel=0.02)


def test_mottles_have_the_spread_and_the_correlation_they_are_given():
    light = Light(
        1.0,
        0.6,
        photometry="lambert",
        albedo_variation=0.06,
        albedo_correlation_length=4.0,
        albedo_seed=3,
    )
    view = above((13.0, 7.0), 200.0, 0.5, (512, 512))
    even = 0.12 * np.sin(0.6)
    field = renderer_of(_PLANE).render(view, light).radiance / even - 1.0
    assert abs(field.mean()) < 0.005
    assert field.std() == pytest.approx(0.06, rel=0.12)
    field = field - field.mean()
    along = np.mean(field[:, :-8] * field[:, 8:]) / field.var()  # 4 m
    assert along == pytest.approx(np.exp(-1.0), abs=0.1)
    again = Renderer(_PLANE).render(view, light).radiance
    assert np.array_equal(again, renderer_of(_PLANE).render(view, light).radiance)
    other = renderer_of(_PLANE).render(view, replace(light, albedo_seed=4)).radiance / even - 1.0
    assert abs(np.mean(other * field)) / field.var() < 0.3
    # They lie on the ground: another camera sees the same place alike.
    near = renderer_of(_PLANE).render(above((13.0, 7.0), 100.0, 0.5, (512, 512)), light).radiance
    assert np.corrcoef((near / even - 1.0).ravel(), field.ravel())[0, 1] > 0.99


def test_boulders_are_as_bright_as_given_each_with_its_own_factor(rocky):
    view = above((0.0, 0.0), 100.0, 0.2, (320, 240))
    light = Light(1.0, 0.8, photometry="lambert")
    renderer = renderer_of(rocky)
    plain = renderer.render(view, light, truth=True)
    bright = renderer.render(
        view, replace(light, boulder_albedo=1.5, boulder_albedo_variation=0.2), truth=True
    )
    lit = (plain.radiance > 0.0) & (plain.identity >= 0)
    gain = bright.radiance[lit] / plain.radiance[lit]
    each = np.array([gain[plain.identity[lit] == n].mean() for n in np.unique(plain.identity[lit])])
    assert each.size > 60
    assert each.mean() == pytest.approx(1.5, abs=5.0 * 0.3 / np.sqrt(each.size))
    assert each.std() == pytest.approx(0.3, rel=0.4)
    one = plain.identity[lit][0]
    assert np.ptp(gain[plain.identity[lit] == one]) < 1e-4
    ground = plain.identity == -1
    assert np.array_equal(plain.radiance[ground], bright.radiance[ground])
    # The same stones whether they are drawn as boxes or, from afar, as points.
    far = above((0.0, 0.0), 400.0, 1.0, (64, 48))
    points, before = (
        renderer.render(far, one, truth=True) for one in (replace(light, boulder_albedo=1.5), light)
    )
    stones = (before.identity >= 0) & (before.radiance > 0.0)
    assert np.allclose(points.radiance[stones], 1.5 * before.radiance[stones], rtol=1e-5)


def test_lights_do_not_leave_traces_in_one_another(rocky):
    view = above((0.0, 0.0), 60.0, 0.3, (120, 90))
    full = Light(
        1.0, 0.2, photometry="hapke", diameter=SUN, scattered_light=True,
        earthshine=FULL_EARTH_IRRADIANCE_RATIO,
        albedo_variation=0.05, boulder_albedo=1.3, boulder_albedo_variation=0.1,
    )  # fmt: skip
    lights = [Light(1.0, 0.2), full, Light(1.0, 0.05, diameter=SUN)]
    fresh = [Renderer(rocky).render(view, one).radiance for one in lights]
    used = Renderer(rocky)
    for k in (0, 1, 2, 1, 0, 2, 1):
        assert np.array_equal(used.render(view, lights[k]).radiance, fresh[k])


@pytest.mark.parametrize("elevation", [np.radians(90.0), np.radians(0.1), 0.0, -0.3])
def test_sun_at_zenith_and_at_the_horizon_is_defined(rocky, elevation):
    full = Light(
        1.0,
        elevation,
        photometry="hapke",
        diameter=SUN,
        scattered_light=True,
        albedo_variation=0.05,
    )
    image = renderer_of(rocky).render(above((0.0, 0.0), 60.0, 0.5, (64, 48)), full).radiance
    assert np.isfinite(image).all() and image.min() >= 0.0
    if elevation <= 0.0:
        assert np.all(image == 0.0)
