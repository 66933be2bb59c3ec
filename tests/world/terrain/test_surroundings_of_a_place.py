"""Rasters loaded around a place: distances and directions on the sphere, and their limits."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine

from lunarsim.errors import InputError
from lunarsim.world.ephemeris import MOON_RADIUS_M
from lunarsim.world.horizon import terrain_horizon
from lunarsim.world.terrain.dtm import load_surroundings

POLAR = f"+proj=stere +lat_0=-90 +lon_0=0 +R={MOON_RADIUS_M:.0f} +units=m +no_defs"
SUMMIT_M = 900.0


def _bearing_and_distance(place, other):
    """Return azimuth, rad, and arc length, m, between places (latitude, longitude, deg)."""
    (lat, lon), (lat2, lon2) = np.radians(place), np.radians(other)
    turn = lon2 - lon
    cosine = np.sin(lat) * np.sin(lat2) + np.cos(lat) * np.cos(lat2) * np.cos(turn)
    azimuth = np.arctan2(
        np.sin(turn) * np.cos(lat2),
        np.cos(lat) * np.sin(lat2) - np.sin(lat) * np.cos(lat2) * np.cos(turn),
    )
    return azimuth, MOON_RADIUS_M * np.arccos(np.clip(cosine, -1.0, 1.0))


def _polar_raster(path, hill, side=60_000.0, step=200.0):
    """Write a polar stereographic raster of a plain with a round hill of 2 km (1 sigma)."""
    n = int(side / step)
    x, y = np.meshgrid(
        (np.arange(n) + 0.5) * step - side / 2, side / 2 - (np.arange(n) + 0.5) * step
    )
    lat = -90.0 + np.degrees(2.0 * np.arctan(np.hypot(x, y) / (2.0 * MOON_RADIUS_M)))
    lon = np.degrees(np.arctan2(x, y))  # on a south polar map, longitude 0 is up
    _, distance = _bearing_and_distance((lat, lon), hill)
    z = SUMMIT_M * np.exp(-0.5 * (distance / 2_000.0) ** 2)
    with rasterio.open(
        path, "w", driver="GTiff", height=n, width=n, count=1, dtype="float32", crs=POLAR,
        transform=Affine(step, 0.0, -side / 2, 0.0, -step, side / 2),
    ) as file:  # fmt: skip
        file.write(z.astype(np.float32), 1)
    return path


@pytest.mark.parametrize("place", [(-89.6, 200.0), (-89.95, 30.0), (-89.3, -75.0)])
def test_a_hill_has_its_true_bearing_and_distance(tmp_path, place):
    hill = (-89.7, 100.0)
    path = _polar_raster(tmp_path / "pole.tif", hill)
    field = load_surroundings(path, *place, max_range=40_000.0)
    row, col = np.unravel_index(np.nanargmax(field.z), field.z.shape)
    azimuth, distance = _bearing_and_distance(place, hill)
    east, north = distance * np.sin(azimuth), distance * np.cos(azimuth)
    assert field.grid.x0 + col * field.grid.posting == pytest.approx(east, abs=250.0)
    assert field.grid.y0 + row * field.grid.posting == pytest.approx(north, abs=250.0)
    found = terrain_horizon(
        field, height=0.0, radius=MOON_RADIUS_M, posting=field.grid.posting, max_range=40_000.0
    )
    highest = found.azimuth[np.argmax(found.elevation)]
    off = (highest - azimuth + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(np.rad2deg(off)) < 1.5
    s = np.linspace(100.0, 40_000.0, 4_000)
    hill = SUMMIT_M * np.exp(-0.5 * ((s - distance) / 2_000.0) ** 2)
    top = np.rad2deg(np.arctan2(hill, s) - 0.5 * s / MOON_RADIUS_M).max()
    assert np.rad2deg(found.elevation.max()) == pytest.approx(top, abs=0.02)


def test_only_the_range_is_loaded(tmp_path):
    path = _polar_raster(tmp_path / "pole.tif", (-89.7, 100.0))
    whole = load_surroundings(path, -89.6, 200.0, max_range=40_000.0)
    near = load_surroundings(path, -89.6, 200.0, max_range=5_000.0)
    assert near.grid.posting == pytest.approx(whole.grid.posting, rel=1e-6)
    assert max(np.abs(near.bounds)) < 10_000.0
    assert max(np.abs(whole.bounds)) > 30_000.0


def test_a_place_outside_is_refused(tmp_path):
    path = _polar_raster(tmp_path / "pole.tif", (-89.7, 100.0))
    with pytest.raises(InputError, match=r"terrain\.path: must have a height at latitude -80"):
        load_surroundings(path, -80.0, 10.0, max_range=5_000.0)
    with pytest.raises(InputError, match="pixel: must be omitted"):
        load_surroundings(path, -89.6, 10.0, max_range=5_000.0, pixel=(3.0, 3.0))


def test_a_file_without_georeferencing_has_its_origin_at_the_pixel(tmp_path):
    z = np.zeros((40, 60), np.float32)
    z[10, 45] = 100.0
    path = tmp_path / "plain.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=40, width=60, count=1, dtype="float32"
    ) as file:
        file.write(z, 1)
    for pixel, east, north in (((30.0, 5.0), 400.0, 200.0), (None, 155.0, 95.0)):
        field = load_surroundings(path, 0.0, 0.0, max_range=9e9, posting=10.0, pixel=pixel)
        row, col = np.unravel_index(np.argmax(field.z), field.z.shape)
        found = field.grid.x0 + 10.0 * col, field.grid.y0 + 10.0 * row
        assert found == pytest.approx((east, north))
    with pytest.raises(InputError, match="pixel: must be a row up to 39 and a column up to 59"):
        load_surroundings(path, 0.0, 0.0, max_range=9e9, posting=10.0, pixel=(40.0, 5.0))
    with pytest.raises(InputError, match=r"no georeferencing.*Set terrain\.dtm_posting_m"):
        load_surroundings(path, 0.0, 0.0, max_range=9e9)
