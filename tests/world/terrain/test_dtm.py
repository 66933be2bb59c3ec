from __future__ import annotations

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from lunarsim.errors import InputError
from lunarsim.world.terrain import Terrain
from lunarsim.world.terrain.dtm import load_terrain, read_info
from tests.worlds import SCENARIOS

MOON = "+proj=eqc +R=1737400 +units=m +no_defs"


def write(path, z, *, crs=MOON, posting=2.0, nodata=None, driver="GTiff"):
    with rasterio.open(
        path, "w", driver=driver, height=z.shape[0], width=z.shape[1], count=1,
        dtype="float32", crs=crs, transform=from_origin(0.0, 0.0, posting, posting), nodata=nodata,
    ) as file:  # fmt: skip
        file.write(z.astype(np.float32), 1)
    return path


PDS_LABEL = """PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {record}
FILE_RECORDS = {total}
LABEL_RECORDS = {labels}
^IMAGE = {start}
TARGET_NAME = MOON
OBJECT = IMAGE
  LINES = {rows}
  LINE_SAMPLES = {cols}
  SAMPLE_TYPE = PC_REAL
  SAMPLE_BITS = 32
END_OBJECT = IMAGE
OBJECT = IMAGE_MAP_PROJECTION
  MAP_PROJECTION_TYPE = "EQUIRECTANGULAR"
  A_AXIS_RADIUS = 1737.4 <KM>
  B_AXIS_RADIUS = 1737.4 <KM>
  C_AXIS_RADIUS = 1737.4 <KM>
  POSITIVE_LONGITUDE_DIRECTION = EAST
  CENTER_LATITUDE = 0.0
  CENTER_LONGITUDE = 0.0
  MAP_SCALE = 2.0 <METERS/PIXEL>
  LINE_PROJECTION_OFFSET = 0.0
  SAMPLE_PROJECTION_OFFSET = 0.0
END_OBJECT = IMAGE_MAP_PROJECTION
END
"""


def test_pds_image(tmp_path):
    z = np.arange(120, dtype="<f4").reshape(10, 12)
    record, labels = 4 * 12, 30
    text = PDS_LABEL.format(
        record=record, total=labels + 10, labels=labels, start=labels + 1, rows=10, cols=12
    )
    path = tmp_path / "dtm.img"
    path.write_bytes(text.encode().ljust(labels * record) + z.tobytes())
    info = read_info(path)
    assert info.driver == "PDS"
    assert info.posting == pytest.approx(2.0)
    relief = load_terrain(path)
    assert np.allclose(relief.z[::-1] + z.mean(), z)


def test_hirise_crop():
    relief = load_terrain(SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif")
    assert relief.grid.shape == (120, 70)
    assert relief.grid.posting == pytest.approx(1.01, abs=1e-6)
    low, high = relief.z_range
    assert high - low == pytest.approx(792 - 753, abs=1.5)
    assert abs(float(np.nanmean(relief.z))) < 1e-3
    step = relief.grid.posting
    slope = np.rad2deg(np.arctan(np.hypot(*np.gradient(relief.z, step))))
    assert np.percentile(slope, 50) == pytest.approx(21, abs=3)


def test_north_is_up(tmp_path):
    z = np.zeros((4, 5))
    z[0, :] = 10.0  # first row of a raster is the northernmost
    relief = load_terrain(write(tmp_path / "a.tif", z))
    terrain = Terrain(relief)
    assert terrain.elevation([0.0, 3.0]) > terrain.elevation([0.0, -3.0])


def test_no_data_becomes_nan(tmp_path):
    z = np.ones((6, 6))
    z[2, 3] = -9999.0
    z[4, 4] = -3.4e38
    relief = load_terrain(write(tmp_path / "a.tif", z, nodata=-9999.0))
    assert np.isnan(relief.z).sum() == 2
    assert read_info(tmp_path / "a.tif").no_data_share == pytest.approx(2 / 36)


def test_pds_style_raster_without_crs_needs_a_posting(tmp_path):
    z = np.random.default_rng(1).random((8, 8))
    path = write(tmp_path / "a.tif", z, crs=None)
    with pytest.raises(InputError, match="dtm_posting_m"):
        load_terrain(path)
    assert load_terrain(path, posting=40.0).grid.posting == 40.0


def test_bad_files(tmp_path):
    with pytest.raises(InputError, match="existing"):
        load_terrain(tmp_path / "none.tif")
    (tmp_path / "text.tif").write_text("not a raster")
    with pytest.raises(InputError, match="must be a raster"):
        load_terrain(tmp_path / "text.tif")
    nowhere = write(tmp_path / "none.tif", np.ones((4, 4)), crs=None, posting=0.1)
    with pytest.raises(InputError, match="no coordinate reference"):
        load_terrain(nowhere)
    empty = write(tmp_path / "nan.tif", np.full((4, 4), np.nan))
    with pytest.raises(InputError, match="must contain elevations"):
        load_terrain(empty)
    with pytest.raises(InputError, match="must be omitted"):
        load_terrain(write(tmp_path / "ok.tif", np.ones((4, 4))), posting=5.0)


def test_a_window_is_the_same_terrain():
    path = SCENARIOS / "data" / "moon_apollo15_nac_dtm_2m.tif"
    whole = load_terrain(path, posting=2.0)
    part = load_terrain(path, posting=2.0, window=(10, 60, 20, 100))
    assert part.grid.shape == (50, 80)
    flipped = whole.z[::-1][10:60, 20:100][::-1]
    assert np.allclose(part.z - part.z[0, 0], flipped - flipped[0, 0], atol=1e-4)
    for window in ((60, 10, 0, 5), (0, 5, 0, 300), (-1, 5, 0, 5)):
        with pytest.raises(InputError, match=r"terrain\.dtm_window"):
            load_terrain(path, posting=2.0, window=window)


def test_a_raster_in_degrees_becomes_metric(tmp_path):
    """A cone at 60 deg south on the Moon: it must be round in metres, where it is."""
    path = tmp_path / "cone.tif"
    step = 1e-3  # 30.3 m of latitude
    radius = 1_737_400.0
    rows, cols = 120, 240
    lat = -60.0 - step * (np.arange(rows) + 0.5 - rows / 2)
    lon = 30.0 + step * (np.arange(cols) + 0.5 - cols / 2)
    north = np.radians(lat + 60.0) * radius
    east = np.radians(lon - 30.0) * radius * np.cos(np.radians(60.0))
    z = 500.0 - 0.2 * np.hypot(east[None, :], north[:, None])
    with rasterio.open(
        path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="float32",
        crs="+proj=longlat +R=1737400 +no_defs",
        transform=from_origin(30.0 - 120 * step, -60.0 + 60 * step, step, step),
    ) as out:  # fmt: skip
        out.write(z.astype(np.float32), 1)
    relief = load_terrain(path, posting=25.0)
    assert relief.grid.posting == pytest.approx(25.0)
    peak = np.unravel_index(np.nanargmax(relief.z), relief.z.shape)
    top = relief.grid.centre_of(*peak)
    assert np.all(np.abs(top) < 40.0)
    distance = np.hypot(*(relief.grid.centres() - top).transpose(2, 0, 1))
    fall = np.nanmax(relief.z) - relief.z
    around = (distance > 200.0) & (distance < 1500.0) & np.isfinite(relief.z)
    assert np.allclose(fall[around], 0.2 * distance[around], atol=0.2 * 40.0)


def ridge_file(path, crs, transform, shape, to_ground):
    """Write a ridge that runs from south to north on the ground, and falls towards the north."""
    rows, cols = np.mgrid[: shape[0], : shape[1]] + 0.5
    x, y = transform @ (cols, rows)
    east, north = to_ground(x, y)
    z = 400.0 - 0.3 * np.abs(east) - 0.1 * north
    with rasterio.open(
        path, "w", driver="GTiff", height=shape[0], width=shape[1], count=1, dtype="float32",
        crs=crs, transform=transform,
    ) as out:  # fmt: skip
        out.write(z.astype(np.float32), 1)


def assert_ridge(relief):
    g = relief.grid
    middle = relief.z[g.rows // 2 - 20 : g.rows // 2 + 20, g.cols // 2 - 20 : g.cols // 2 + 20]
    crest = np.nanargmax(middle, axis=1)
    assert np.ptp(crest) <= 2  # runs from south to north
    fall = np.diff(np.nanmax(middle, axis=1)) / g.posting
    assert np.nanmedian(fall) == pytest.approx(-0.1, abs=0.02)


def test_a_polar_projection_is_turned_to_true_north(tmp_path):
    """At 88 deg south, 60 deg east, grid north of a polar stereographic map is not north."""
    path = tmp_path / "polar.tif"
    radius, lon = 1_737_400.0, np.radians(60.0)
    # South polar stereographic: x = rho sin(lon), y = rho cos(lon); north is away from the pole.
    rho = 2.0 * radius * np.tan(np.radians(1.0))
    x0, y0 = rho * np.sin(lon), rho * np.cos(lon)
    step = 20.0
    transform = from_origin(x0 - 80 * step, y0 + 80 * step, step, step)

    def to_ground(x, y):
        dx, dy = x - x0, y - y0
        return dx * np.cos(lon) - dy * np.sin(lon), dx * np.sin(lon) + dy * np.cos(lon)

    crs = "+proj=stere +lat_0=-90 +lon_0=0 +R=1737400 +units=m +no_defs"
    ridge_file(path, crs, transform, (160, 160), to_ground)
    relief = load_terrain(path)
    assert relief.grid.posting == pytest.approx(20.0, rel=0.05)
    assert_ridge(relief)
    info = read_info(path)
    assert info.column_direction_deg == pytest.approx(60.0, abs=0.1)
    west, east, south, north = relief.bounds
    assert info.extent == pytest.approx((east - west, north - south), abs=20.0)


def test_a_turned_raster_is_turned_back(tmp_path):
    path = tmp_path / "turned.tif"
    turn = np.radians(30.0)
    step = 5.0
    centre = np.array([0.0, 0.0])
    transform = (
        rasterio.Affine.translation(*centre)
        * rasterio.Affine.rotation(30.0)
        * rasterio.Affine.scale(step, -step)
        * rasterio.Affine.translation(-75, -75)
    )
    assert turn > 0.0
    crs = "+proj=eqc +R=1737400 +units=m +no_defs"
    ridge_file(path, crs, transform, (150, 150), lambda x, y: (x, y))
    relief = load_terrain(path, posting=5.0)
    assert_ridge(relief)


def test_info_describes_an_unnamed_reference_by_its_parameters(tmp_path):
    path = tmp_path / "a.tif"
    write(path, np.zeros((8, 8)), crs="+proj=eqc +R=1737400 +units=m")
    assert "+proj=eqc" in read_info(path).frame
