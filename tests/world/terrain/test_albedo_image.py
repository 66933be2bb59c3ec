"""Orthoimages and albedo maps as the relative albedo of measured terrain."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from lunarsim.errors import InputError
from lunarsim.frames import sensor_axes
from lunarsim.models.pinhole import View
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.rocks.population import RockPopulation
from lunarsim.sensors.rendering import renderer_of
from lunarsim.world.light import Light
from lunarsim.world.terrain_models.measured import RasterTerrain

R = 1_737_400.0
# Longitude and latitude of the middle of the terrain, deg: beside the edge of most maps.
LON, LAT = 179.99, -60.0
MAP = f"+proj=eqc +lat_ts=-60 +lon_0=180 +R={R} +units=m +no_defs"
PLANE = 'LOCAL_CS["site",UNIT["metre",1]]'
SIDE, POSTING = 200.0, 2.0


def write(path, values, transform, crs, nodata=None):
    with rasterio.open(
        path, "w", driver="GTiff", height=values.shape[0], width=values.shape[1], count=1,
        dtype=values.dtype, crs=crs, transform=transform, nodata=nodata,
    ) as file:  # fmt: skip
        file.write(values, 1)
    return path


def brightness(east, north):
    """Image over the terrain: mean 1 over complete periods, not symmetric."""
    return 1.0 + 0.3 * np.sin(2 * np.pi * east / 50.0) + 0.2 * np.cos(2 * np.pi * north / 100.0)


def terrain_file(folder, crs=MAP):
    """A level raster of 101 x 101 posts around (LON, LAT)."""
    x, y = (np.radians(LON - 180.0) * R * 0.5, np.radians(LAT) * R) if crs == MAP else (500.0, 0.0)
    n = int(SIDE / POSTING) + 1
    half = 0.5 * n * POSTING
    z = np.zeros((n, n), np.float32)
    return write(folder / "dtm.tif", z, Affine(POSTING, 0, x - half, 0, -POSTING, y + half), crs)


def points_of(transform, shape):
    """Map coordinates of the pixel centres."""
    col, row = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    return transform @ (col, row)


def local(lon, lat):
    """East and north of points, deg, by the formulas of the azimuthal equidistant projection."""
    l0, p0, lon, lat = (np.radians(v) for v in (LON, LAT, lon, lat))
    cos_c = np.sin(p0) * np.sin(lat) + np.cos(p0) * np.cos(lat) * np.cos(lon - l0)
    c = np.arccos(np.clip(cos_c, -1.0, 1.0))
    k = R * c / np.maximum(np.sin(c), 1e-12)
    north = np.cos(p0) * np.sin(lat) - np.sin(p0) * np.cos(lat) * np.cos(lon - l0)
    return k * np.cos(lat) * np.sin(lon - l0), k * north


def polar_image(folder):
    """The image in polar stereographic projection, pixels of 0.5 m."""
    crs = f"+proj=stere +lat_0=-90 +lon_0=0 +R={R} +units=m +no_defs"
    rho = 2.0 * R * np.tan(np.radians(0.5 * (90.0 + LAT)))
    x0, y0 = rho * np.sin(np.radians(LON)), rho * np.cos(np.radians(LON))
    transform = Affine(0.5, 0, x0 - 150.0, 0, -0.5, y0 + 150.0)
    x, y = points_of(transform, (600, 600))
    lon = np.degrees(np.arctan2(x, y))
    lat = 2.0 * np.degrees(np.arctan(np.hypot(x, y) / (2.0 * R))) - 90.0
    values = (1e4 * brightness(*local(lon, lat))).astype(np.uint16)
    return write(folder / "polar.tif", values, transform, crs)


def degree_image(folder):
    """The image in degrees from 0 to 360, about 0.4 m north and 0.2 m east."""
    step = 1.3e-5
    transform = Affine(step, 0, LON - 600 * step, 0, -step, LAT + 300 * step)
    lon, lat = points_of(transform, (600, 1200))
    values = (1e4 * brightness(*local(lon, lat))).astype(np.uint16)
    crs = f"+proj=longlat +R={R} +no_defs"
    return write(folder / "degrees.tif", values, transform, crs)


def south_up_image(folder):
    """The image in the frame of the map, rows from the south."""
    x, y = np.radians(LON - 180.0) * R * 0.5, np.radians(LAT) * R
    transform = Affine(0.7, 0, x - 140.0, 0, 0.7, y - 140.0)
    px, py = points_of(transform, (400, 400))
    lon, lat = 180.0 + np.degrees(px / (0.5 * R)), np.degrees(py / R)
    values = (1e4 * brightness(*local(lon, lat))).astype(np.uint16)
    return write(folder / "south.tif", values, transform, MAP)


def settings(folder, **more):
    given = {"path": folder / "dtm.tif", "posting": POSTING, "detail": False}
    return RasterTerrain(**(given | more))


def built(model):
    return model.build(RockPopulation(cover=0.0), RandomStreams(flight_seed(1, 0)))


def above(place, height, pixel, size):
    f, (w, h) = height / pixel, size
    axes = sensor_axes(np.array([0.0, 0.0, -1.0]))
    return View(np.array([*place, height]), axes, f, f, 0.5 * (w - 1), 0.5 * (h - 1), w, h)


@pytest.mark.parametrize("image", [polar_image, degree_image, south_up_image])
def test_an_image_in_another_projection_is_where_its_coordinates_are(tmp_path, image):
    terrain_file(tmp_path)
    terrain = built(settings(tmp_path, albedo_path=image(tmp_path)))
    rng = np.random.default_rng(3)
    xy = rng.uniform(-0.45 * SIDE, 0.45 * SIDE, (2000, 2))
    wanted = brightness(*xy.T)
    # A shift of 0.05 m would change the image by up to 0.002.
    assert terrain.albedo.at(xy) / wanted == pytest.approx(1.0, abs=0.006)
    assert np.mean(terrain.albedo.at(xy) / wanted) == pytest.approx(1.0, abs=2e-3)


def test_a_rendered_image_shows_it(tmp_path):
    terrain_file(tmp_path)
    terrain = built(settings(tmp_path, albedo_path=polar_image(tmp_path)))
    plain = built(settings(tmp_path))
    view, light = above((7.0, -4.0), 120.0, 0.25, (480, 320)), Light(1.0, 0.7, 0.1, ambient=0.1)
    ratio = renderer_of(terrain).render(view, light).radiance
    ratio = ratio / renderer_of(plain).render(view, light).radiance
    col, row = np.meshgrid(np.arange(480), np.arange(320))
    at = (np.stack((col, row), -1) - [239.5, 159.5]) * 0.25
    east, north = 7.0 + at[..., 0], -4.0 - at[..., 1]
    assert ratio == pytest.approx(brightness(east, north), abs=0.012)
    uneven = replace(light, albedo_variation=0.1, albedo_correlation_length=3.0, ambient=0.0)
    images = [renderer_of(t).render(view, uneven).radiance for t in (terrain, plain)]
    assert np.std(images[1]) > 0.05 * np.mean(images[1])
    assert images[0] / images[1] == pytest.approx(brightness(east, north), abs=0.012)


@pytest.mark.parametrize("west", [-180.0, 0.0])
def test_an_image_of_the_complete_body_is_read_around_the_terrain(tmp_path, west):
    terrain_file(tmp_path)
    step = 0.1
    lat = 90.0 - step * (np.arange(1800) + 0.5)
    values = np.tile((1000.0 + 10.0 * lat).astype(np.float32)[:, None], (1, 3600))
    transform = Affine(step, 0, west, 0, -step, 90.0)
    image = write(tmp_path / "body.tif", values, transform, f"+proj=longlat +R={R} +no_defs")
    albedo = built(settings(tmp_path, albedo_path=image)).albedo
    south, north = albedo.at([[-80.0, -90.0], [-80.0, 90.0]])
    per_metre = 10.0 * np.degrees(1.0 / R) / (1000.0 + 10.0 * LAT)
    assert (north - south) / 180.0 == pytest.approx(per_metre, rel=0.02)


def test_rocks_keep_their_brightness(tmp_path):
    terrain_file(tmp_path)
    rocks, streams = RockPopulation(cover=0.05), lambda: RandomStreams(flight_seed(1, 0))
    dark = settings(tmp_path, albedo_path=polar_image(tmp_path)).build(rocks, streams())
    plain = settings(tmp_path).build(rocks, streams())
    view, light = above((0.0, 0.0), 60.0, 0.1, (320, 240)), Light(1.0, 0.7)
    seen, before = (renderer_of(t).render(view, light, truth=True) for t in (dark, plain))
    on_rock = before.identity >= 0
    assert np.mean(on_rock) > 0.01
    assert seen.radiance[on_rock] == pytest.approx(before.radiance[on_rock], rel=1e-5)


def test_a_fine_image_is_averaged(tmp_path, monkeypatch):
    monkeypatch.setattr("lunarsim.world.terrain.albedo_image._MAX_CELLS", 52)
    monkeypatch.setattr("lunarsim.world.terrain.albedo_image._MIN_CELLS", 2)
    terrain_file(tmp_path)
    stripes = np.zeros((600, 600), np.uint16)
    stripes[:, ::2] = 2000
    name = write(tmp_path / "stripes.tif", stripes, Affine.identity(), None)
    albedo = built(settings(tmp_path, albedo_path=name, albedo_posting=0.5)).albedo
    assert albedo.grid.posting == pytest.approx(4.0)
    assert albedo.values == pytest.approx(1.0, abs=0.01)


def test_an_image_without_georeferencing_lies_north_up_at_the_centre(tmp_path):
    n = int(SIDE / POSTING) + 1
    name = write(tmp_path / "dtm.tif", np.zeros((n, n), np.float32), Affine.identity(), None)
    col, row = np.meshgrid(np.arange(500), np.arange(500))
    values = brightness(0.5 * (col - 249.5), -0.5 * (row - 249.5)).astype(np.float32)
    image = write(tmp_path / "image.tif", values, Affine.identity(), None)
    model = settings(
        tmp_path, path=name, dtm_posting=POSTING, albedo_path=image, albedo_posting=0.5
    )
    xy = np.random.default_rng(4).uniform(-90.0, 90.0, (500, 2))
    assert built(model).albedo.at(xy) == pytest.approx(brightness(*xy.T), abs=0.01)


def test_the_image_is_mirrored_with_the_terrain(tmp_path):
    terrain_file(tmp_path)
    terrain = built(settings(tmp_path, albedo_path=polar_image(tmp_path), mirrored_size=360.0))
    half = 0.5 * SIDE
    assert terrain.bounds[1] > half + 70.0
    inside, outside = np.array([[half - 60.0, 31.0]]), np.array([[half + 60.0, 31.0]])
    assert terrain.albedo.at(outside) == pytest.approx(terrain.albedo.at(inside), abs=0.004)
    inside, outside = np.array([[12.0, -half + 70.0]]), np.array([[12.0, -half - 70.0]])
    assert terrain.albedo.at(outside) == pytest.approx(terrain.albedo.at(inside), abs=0.004)


def test_missing_pixels_have_the_mean_albedo_and_shadows_reflect_a_little(tmp_path):
    terrain_file(tmp_path, None)
    values = np.full((400, 400), 500, np.uint16)
    values[:, :100] = 0
    values[:, 100:200] = 1
    image = write(tmp_path / "image.tif", values, Affine.identity(), None, nodata=0)
    model = settings(tmp_path, dtm_posting=POSTING, albedo_path=image, albedo_posting=0.5)
    albedo = built(model).albedo
    assert albedo.at([[-75.0, 0.0]]) == pytest.approx(1.0)
    assert albedo.at([[-25.0, 0.0]]) == pytest.approx(0.02)
    # A third of the known pixels is dark.
    assert albedo.at([[50.0, 0.0]]) == pytest.approx(1.5, rel=0.02)


@pytest.mark.parametrize(
    ("image", "more", "field", "words"),
    [
        (polar_image, {"albedo_posting": 0.5}, "albedo_posting_m", "must be omitted"),
        (None, {}, "albedo_path", "must be an existing raster file"),
        ("bare", {}, "albedo_posting_m", "is required"),
        ("plane", {}, "albedo_path", "must have the local coordinate reference of the terrain"),
        ("far", {}, "albedo_path", "must cover at least 1 % of the terrain, but covers 0 %"),
        ("black", {}, "albedo_path", "must have a positive mean"),
    ],
)
def test_bad_images_are_refused(tmp_path, image, more, field, words):
    terrain_file(tmp_path)
    transform = Affine(1.0, 0, 0.0, 0, -1.0, np.radians(LAT) * R + 150.0)
    values = np.full((300, 300), 7, np.uint8)
    name = tmp_path / "image.tif"
    if callable(image):
        name = image(tmp_path)
    elif image == "bare":
        write(name, values, Affine.identity(), None)
    elif image == "plane":
        write(name, values, transform, PLANE)
    elif image == "far":
        write(name, values, transform, MAP)
    elif image == "black":
        name = write(name, 0 * values, Affine.translation(-300.0, 0) @ transform, MAP)
    model = settings(tmp_path, albedo_path=name, **more)
    for use in (model.check_files, lambda: built(model)):
        with pytest.raises(InputError, match=words) as found:
            use()
        assert found.value.field == f"terrain.{field}"
    assert str(tmp_path) in str(found.value) or field == "albedo_posting_m"


def test_without_an_image_nothing_changes(tmp_path):
    terrain_file(tmp_path)
    assert built(settings(tmp_path)).albedo is None
