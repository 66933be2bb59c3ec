"""Rasters as users have them: orientation, scale, unit, label, frame, undeclared no-data."""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from rasterio.windows import Window

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.models.gravity import CentralGravity
from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.world.far_terrain import FarTerrainSettings
from lunarsim.world.terrain import Terrain
from lunarsim.world.terrain.dtm import load_terrain, read_info
from lunarsim.world.terrain.raster_heights import HeightStatistics, metres_in
from tests.world.terrain.rasters import COLS, ROWS, SPHERE, Case, degrees, equirectangular
from tests.worlds import SCENARIOS

pytestmark = [
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
]

METRIC = f"+proj=eqc +units=m {SPHERE}"
LOCAL = 'LOCAL_CS["Arbitrary (m)",UNIT["metre",1]]'
N = 200
ROW, COL = np.mgrid[:N, :N]
NORTH, EAST = N / 2 - ROW - 0.5, COL + 0.5 - N / 2
HILL = 0.05 * NORTH + 15.0 * np.exp(-((EAST - 40) ** 2 + (NORTH - 40) ** 2) / 400.0)
NORTH_UP = Affine(1, 0, -N / 2, 0, -1, N / 2)


def write(path, z, *, crs=METRIC, transform=NORTH_UP, dtype="float32", unit=None, scale=None, **kw):
    with rasterio.open(
        path, "w", driver="GTiff", height=z.shape[0], width=z.shape[1], count=1, dtype=dtype,
        crs=crs, transform=transform, **kw,
    ) as file:  # fmt: skip
        file.write(z.astype(dtype), 1)
        if scale is not None:
            file.scales, file.offsets = (scale[0],), (scale[1],)
        if unit is not None:
            file.units = (unit,)
    return path


def relief(heightfield):
    low, high = heightfield.z_range
    return high - low


@pytest.mark.parametrize(
    ("z", "transform"),
    [
        (HILL, NORTH_UP),
        (HILL[::-1], Affine(1, 0, -N / 2, 0, 1, -N / 2)),
        (HILL[:, ::-1], Affine(-1, 0, N / 2, 0, -1, N / 2)),
        (np.rot90(HILL), Affine(0, -1, N / 2, -1, 0, N / 2)),
    ],
    ids=["north-up", "south-up", "east-first", "quarter-turn"],
)
@pytest.mark.parametrize("crs", [METRIC, LOCAL, None], ids=["projected", "local", "none"])
def test_a_hill_in_the_north_east_is_there_in_every_orientation(tmp_path, z, transform, crs):
    path = write(tmp_path / "z.tif", z, transform=transform, crs=crs)
    loaded = load_terrain(path, posting=None if crs else 1.0)
    top = loaded.grid.centre_of(*np.unravel_index(loaded.z.argmax(), loaded.z.shape))
    assert top == pytest.approx([40.0, 40.0], abs=0.51)
    # Re-indexed, not interpolated.
    assert not read_info(path).resampled
    assert np.allclose(loaded.z[::-1], HILL - HILL.mean(), rtol=0.0, atol=1e-5)


def test_a_window_is_counted_in_the_order_of_the_file(tmp_path):
    path = write(tmp_path / "z.tif", HILL[::-1], transform=Affine(1, 0, -N / 2, 0, 1, -N / 2))
    part = load_terrain(path, window=(120, 160, 110, 170))
    assert part.grid.shape == (40, 60)
    assert np.allclose(np.diff(part.z), np.diff(HILL[::-1][120:160, 110:170]), atol=1e-4)


def test_scale_and_offset_of_a_band(tmp_path):
    path = write(tmp_path / "z.tif", np.round(HILL / 0.01), dtype="int16", scale=(0.01, -1900.0))
    assert relief(load_terrain(path)) == pytest.approx(np.ptp(HILL), abs=0.011)
    assert read_info(path).z_range == pytest.approx((-1905.0, -1883.0), abs=0.1)
    assert read_info(path).statistics.mean == pytest.approx(HILL.mean() - 1900.0, abs=0.01)


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("km", 1e3), ("foot", 0.3048), ("US survey foot", 1200 / 3937), ("Foot_US", 1200 / 3937),
     ("Metre", 1.0), ("centimeters", 0.01), ("N/A", 1.0)],
)  # fmt: skip
def test_units_of_height(tmp_path, unit, metres):
    path = write(tmp_path / "z.tif", HILL / metres, unit=unit)
    assert relief(load_terrain(path)) == pytest.approx(np.ptp(HILL), abs=1e-3)


def test_an_unknown_unit_is_refused_and_can_be_replaced(tmp_path):
    path = write(tmp_path / "z.tif", HILL, unit="furlong")
    with pytest.raises(InputError, match=r"'furlong'.*terrain\.dtm_unit"):
        load_terrain(path)
    assert relief(load_terrain(path, unit="km")) == pytest.approx(1e3 * np.ptp(HILL), rel=1e-6)
    with pytest.raises(InputError, match=r"terrain\.dtm_unit: .*'furlong'"):
        load_terrain(path, unit="furlong")
    assert metres_in("US_Survey_Foot") == metres_in("us-ft") != metres_in("ft")


@pytest.mark.parametrize(
    "crs",
    ["EPSG:32633+6360",
     "+proj=utm +zone=33 +datum=WGS84 +geoidgrids=egm96_15.gtx +vunits=us-ft"],
)  # fmt: skip
def test_the_unit_of_a_vertical_reference_counts(tmp_path, crs):
    path = write(tmp_path / "z.tif", HILL / 0.3048006096, crs=crs,
                 transform=Affine(1, 0, 5e5, 0, -1, 5e6))  # fmt: skip
    assert relief(load_terrain(path)) == pytest.approx(np.ptp(HILL), abs=1e-3)


def test_two_units_are_refused(tmp_path):
    case = Case("PDS", equirectangular(0.0), dtype="float32", unit="KILOMETER")
    label = case.write(tmp_path).with_suffix(".lbl")
    text = label.read_text().replace("OFFSET = 0.0", "OFFSET = 0.0 <METER>")
    label.write_text(text)
    with pytest.raises(InputError, match=r"several units.*KILOMETER.*dtm_unit"):
        load_terrain(label)


def test_a_label_in_another_alphabet_is_read_or_refused(tmp_path):
    label = Case("PDS", equirectangular(0.0), dtype="float32").write(tmp_path).with_suffix(".lbl")
    label.write_bytes(label.read_bytes().replace(b"MOON", b'"\xff\xfeOON"'))
    try:
        load_terrain(label)
    except InputError as error:
        assert str(label) in str(error)


def test_a_data_file_is_opened_by_the_label_beside_it(tmp_path):
    case = Case("PDS", equirectangular(0.0), dtype="int16", scale=0.005, offset=1737400.0)
    data = case.write(tmp_path)
    assert data.suffix == ".img"
    assert np.array_equal(load_terrain(data).z, load_terrain(data.with_suffix(".lbl")).z)
    assert read_info(data).height_scale.scale == 0.005
    label = data.with_suffix(".lbl").rename(tmp_path / "other.lbl")
    with pytest.raises(InputError, match=r"z\.lbl.*z\.img"):
        load_terrain(data)
    label.rename(tmp_path / "z.lbl").write_text(label_of("another.img"))
    (tmp_path / "another.img").write_bytes(data.read_bytes())
    with pytest.raises(InputError, match=r"z\.lbl that names another file"):
        load_terrain(data)


def label_of(name):
    return (
        f'PDS_VERSION_ID = PDS3\nRECORD_TYPE = FIXED_LENGTH\nRECORD_BYTES = 8\n^IMAGE = "{name}"\n'
        "OBJECT = IMAGE\n LINES = 4\n LINE_SAMPLES = 4\n SAMPLE_TYPE = LSB_INTEGER\n"
        " SAMPLE_BITS = 16\nEND_OBJECT = IMAGE\nEND\n"
    )


def test_hexadecimal_no_data_of_a_label(tmp_path):
    """GDAL reads 16#FF7FFFFB# as the height 16."""
    z = np.linspace(0.0, 31.0, 32 * 16, dtype="<f4").reshape(32, 16)
    z[3, 3], z[20, 5] = np.frombuffer(bytes.fromhex("fbff7fff"), "<f4")[0], 16.0
    z.tofile(tmp_path / "z.img")
    text = label_of("z.img").replace("LSB_INTEGER", "PC_REAL").replace("BITS = 16", "BITS = 32")
    text = text.replace("LINES = 4", "LINES = 32").replace("SAMPLES = 4", "SAMPLES = 16")
    (tmp_path / "z.lbl").write_text(
        text.replace("END_OBJECT", " MISSING_CONSTANT = 16#FF7FFFFB#\nEND_OBJECT")
    )
    loaded = load_terrain(tmp_path / "z.lbl", posting=1.0)
    assert np.argwhere(~np.isfinite(loaded.z[::-1])).tolist() == [[3, 3]]


@pytest.mark.parametrize(
    ("kind", "dtype", "special"),
    [("SignedWord", "<i2", [-32768, -32767, -32766, -32765, -32764]),
     ("UnsignedWord", "<u2", [0, 1, 2, 65534, 65535]), ("UnsignedByte", "u1", [0, 255])],
)  # fmt: skip
def test_special_pixels_of_a_cube(tmp_path, kind, dtype, special):
    path = Case("ISIS3", equirectangular(0.0), dtype="int16", scale=0.01).write(tmp_path)
    z = np.full((ROWS, COLS), 100, dtype)
    z[0, : len(special)] = special
    label = path.read_bytes()[:4096].replace(b"SignedWord", kind.encode()).ljust(4096, b"\0")
    path.write_bytes(label[:4096] + z.tobytes())
    assert np.isnan(load_terrain(path).z).sum() == len(special)


def test_heights_from_the_centre_of_the_moon_keep_their_millimetres(tmp_path):
    path = write(tmp_path / "z.tif", HILL + 1_737_400.0, dtype="float64")
    loaded = load_terrain(path)
    assert np.abs(np.diff(loaded.z[::-1]) - np.diff(HILL)).max() < 1e-5


def test_a_local_reference_is_a_metric_frame(tmp_path):
    path = write(tmp_path / "local.tif", HILL, crs=LOCAL, transform=Affine(2, 0, 5e3, 0, -2, 5e3))
    assert load_terrain(path).grid.posting == 2.0
    done = CliRunner().invoke(main, ["terrain", "info", str(path)])
    assert "Arbitrary (m)" in done.output
    assert "degrees" not in done.output
    scenario = tmp_path / "local.toml"
    scenario.write_text('name = "local"\n[terrain]\nkind = "dtm"\npath = "local.tif"\n')
    assert CliRunner().invoke(main, ["scenario", "check", str(scenario)]).exit_code == 0


@pytest.mark.parametrize(
    ("variable", "command"),
    [("PROJ_LIB", ["scenario", "check"]),
     pytest.param("PROJ_DATA", ["fly"], marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_wrong_folder_of_proj_is_named(tmp_path, variable, command):
    words = [sys.executable, "-m", "lunarsim.cli", *command, "hirise"]
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PROJ_")}
    done = subprocess.run(
        words, env=clean | {variable: str(tmp_path)}, check=False, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert f"`unset {variable}`" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("value", "dtype"),
    [(-9999.0, "float32"), (-32768, "int16"), (32767, "int16"), (3.4028234663852886e38, "float32"),
     (-99999.0, "float64"), (1e10, "float32"), (-(2**31), "int32"), (-1234.5678, "float64"),
     (0.0, "float32"), (-999.0, "float32")],
)  # fmt: skip
def test_undeclared_no_data_is_refused_and_can_be_declared(tmp_path, value, dtype):
    z = 10.0 * HILL + 900.0
    z[10:14, 20] = value
    path = write(tmp_path / "z.tif", z, dtype=dtype)
    with pytest.raises(InputError, match=r"dtm_nodata") as caught:
        load_terrain(path)
    declared = re.search(r"terrain\.dtm_nodata = (\S+),", str(caught.value))
    if declared:  # as it is proposed
        assert np.isnan(load_terrain(path, nodata=float(declared.group(1))).z).sum() == 4
    assert np.isnan(load_terrain(path, nodata=value).z).sum() == 4
    with pytest.raises(InputError, match="dtm_nodata"):
        read_info(path)


@pytest.mark.parametrize("markers", [(-32768, -32767), (-9999, -9998), (32766, 32767)])
def test_several_undeclared_no_data_values_are_refused_together(tmp_path, markers):
    z = 10.0 * HILL + 900.0
    z[10, 20:22] = markers
    path = write(tmp_path / "z.tif", z, dtype="int16")
    with pytest.raises(InputError, match=r"2 points.*dtm_nodata = \[.*,.*\]"):
        load_terrain(path)
    assert np.isnan(load_terrain(path, nodata=markers).z).sum() == 2


def test_a_margin_of_zeros_is_refused(tmp_path):
    z = HILL + 300.0
    z[:4] = 0.0
    with pytest.raises(InputError, match=r"the value 0 at 800 points, .*dtm_nodata = 0,"):
        load_terrain(write(tmp_path / "z.tif", z))


def test_a_reference_without_a_transform_is_no_frame(tmp_path):
    """GDAL returns the identity, by which row 0 would be the southern one at steps of 1 m."""
    path = write(tmp_path / "z.tif", HILL, transform=Affine.identity())
    with pytest.raises(InputError, match="a coordinate reference system but no transform"):
        load_terrain(path)
    assert read_info(path).posting is None
    loaded = load_terrain(path, posting=2.0)
    top = loaded.grid.centre_of(*np.unravel_index(loaded.z.argmax(), loaded.z.shape))
    assert top == pytest.approx([80.0, 80.0], abs=1.01)


def test_depths_are_refused(tmp_path):
    path = write(tmp_path / "z.tif", HILL, crs="EPSG:32633+5715",
                 transform=Affine(1, 0, 5e5, 0, -1, 5e6))  # fmt: skip
    with pytest.raises(InputError, match="increase upwards, not depths"):
        load_terrain(path)


def test_a_raster_of_the_whole_body_is_refused(tmp_path):
    z = np.add.outer(np.arange(90.0), np.zeros(180))
    path = write(tmp_path / "z.tif", z, crs=f"+proj=longlat {SPHERE}",
                 transform=Affine(2, 0, -180, 0, -2, 90))  # fmt: skip
    with pytest.raises(InputError, match=r"beyond the edge.*terrain\.dtm_window"):
        load_terrain(path)
    assert load_terrain(path, window=(40, 50, 80, 100)).grid.posting > 5e4


@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_infinite_heights_are_none(tmp_path, value):
    z = HILL.copy()
    z[7, 7] = value
    assert np.isnan(load_terrain(write(tmp_path / "z.tif", z)).z).sum() == 1


def test_a_no_data_value_is_rounded_to_the_type_of_the_file(tmp_path):
    z = HILL.copy()
    z[7, 7] = -9999.1
    assert np.isnan(load_terrain(write(tmp_path / "z.tif", z), nodata=-9999.1).z).sum() == 1


def test_a_relief_that_no_body_has_is_refused(tmp_path):
    path = write(tmp_path / "z.tif", 2000.0 * EAST)
    with pytest.raises(InputError, match=r"from -199000 to 199000 m"):
        load_terrain(path)


def test_extremes_are_counted_across_blocks():
    found = HeightStatistics()
    found.add(np.arange(20.0))
    found.add(np.array([7.0, 12.0, np.nan, -1.0]))
    assert found.lowest == [(-1.0, 1), *((float(v), 1) for v in range(7))]
    found.add(np.array([6.0, 12.0, 19.0]))
    assert found.lowest[-1] == (6.0, 2)
    assert found.highest[:2] == [(19.0, 2), (18.0, 1)]
    assert (found.posts, found.known) == (27, 26)


def test_the_scale_of_a_projection_is_found_to_a_tenth_of_a_percent(tmp_path):
    crs = f"+proj=tmerc +lon_0=0 +k=0.998 +units=m {SPHERE}"
    path = write(tmp_path / "z.tif", HILL, crs=crs)
    assert load_terrain(path).grid.posting == pytest.approx(1.0 / 0.998, rel=1e-5)
    with pytest.raises(InputError, match="must be omitted"):
        load_terrain(write(tmp_path / "z.tif", HILL), posting=1.005)


@pytest.mark.parametrize("step", [0.05, 0.25, 1.0, 1000.0])
def test_steps_are_measured_whatever_their_length(tmp_path, step):
    """With a centre on the equator, PROJ rounds azimuthal equidistant places to centimetres."""
    transform = Affine(step, 0, 1e5, 0, -1.2 * step, 1.2 * step * N / 2)
    crs = f"+proj=tmerc +lon_0=0 +k=0.998 +units=m {SPHERE}"
    along, across = read_info(write(tmp_path / "z.tif", HILL, crs=crs, transform=transform)).spacing
    scale = 0.998 * (1.0 + 0.5 * (1e5 + 100 * step) ** 2 / 1_737_400.0**2)
    assert along == pytest.approx(step / scale, rel=1e-4)
    assert across == pytest.approx(1.2 * step / scale, rel=1e-4)


def test_unequal_steps_need_a_reference(tmp_path):
    path = write(tmp_path / "z.tif", HILL, crs=None, transform=Affine(1, 0, 5, 0, -1.05, 5))
    with pytest.raises(InputError, match="unequal steps"):
        load_terrain(path, posting=1.0)


def test_coordinates_that_count_south_are_refused(tmp_path):
    path = write(tmp_path / "z.tif", HILL, crs="EPSG:2053",
                 transform=Affine(1, 0, 1e3, 0, -1, 2.9e6))  # fmt: skip
    with pytest.raises(InputError, match="increase to the west or south"):
        load_terrain(path)


@pytest.mark.parametrize(
    "name", ["US survey foot", "us-ft", "Foot_US", "US feet", "ftUS", "foot (US survey)"]
)
def test_names_of_the_survey_foot(name):
    assert metres_in(name) == 1200 / 3937


@pytest.mark.parametrize("keyword", ["UNIT", "UNITS"])
def test_keywords_of_the_unit_in_a_label(tmp_path, keyword):
    case = Case("PDS", equirectangular(0.0), dtype="float32", unit="KILOMETER", metres=1e3)
    label = case.write(tmp_path).with_suffix(".lbl")
    label.write_text(label.read_text().replace("  UNIT =", f"  {keyword} ="))
    assert read_info(label).height_scale.metres == 1e3


@pytest.mark.parametrize(("unit", "metres"), [("FEET", 0.3048), ("METERS", 1.0), ("NO", 1.0)])
def test_the_unit_beside_an_ascii_grid(tmp_path, unit, metres):
    path = Case("AAIGrid", degrees(10.0, 20.0), unit=unit).write(tmp_path)
    assert read_info(path).height_scale.metres == metres


def test_heights_that_look_like_no_data_can_be_kept(tmp_path):
    z = HILL.copy()
    z[5, 5] = -9999.0
    path = write(tmp_path / "z.tif", z)
    assert load_terrain(path, nodata=[]).z_range[0] < -9000.0


def steep_terrains():
    rng = np.random.default_rng(5)
    rough = rng.normal(0.0, 1.0, HILL.shape)
    yield "cliff of 400 m", np.where(EAST > 0.0, 400.0, 0.0)
    yield "cliff and rough plain", np.where(EAST > 0.0, 450.0, 0.0) + rough
    yield "crater wall", 3000.0 * np.tanh((np.hypot(EAST, NORTH) - 50.0) / 8.0)
    yield "lone peak", 2000.0 * np.exp(-np.hypot(EAST, NORTH) / 3.0)
    yield "plain at zero", np.where(np.hypot(EAST, NORTH) < 5.0, 40.0, 0.0)
    yield "flat", np.zeros(HILL.shape)
    yield "deep basin", -9050.0 + rough
    yield "scarp through 9999", np.clip(9999.0 + 30.0 * EAST + rough, 8000.0, 9999.0)


@pytest.mark.parametrize(("name", "z"), steep_terrains(), ids=lambda v: v if type(v) is str else "")
def test_steep_terrain_is_not_refused(tmp_path, name, z):
    assert np.isfinite(load_terrain(write(tmp_path / "z.tif", z)).z).all()


def test_shipped_rasters_are_not_refused():
    for path in sorted((SCENARIOS / "data").glob("*.tif")):
        placed = path.name.startswith("hirise")
        loaded = load_terrain(path, posting=None if placed else 2.0)
        with rasterio.open(path) as source:
            z = source.read(1, masked=True).astype(np.float32).filled(np.nan)[::-1]
        mean = np.float32(np.nanmean(z.astype(np.float64)))
        assert np.array_equal(loaded.z, z - mean, equal_nan=True)


def test_control_points_and_bad_transforms_are_refused(tmp_path):
    path = write(tmp_path / "z.tif", HILL, transform=Affine(1, 1, 0, 1, 1, 0))
    with pytest.raises(InputError, match="singular"):
        load_terrain(path)
    path = write(tmp_path / "n.tif", HILL, transform=Affine(1, 0, np.nan, 0, -1, 0))
    with pytest.raises(InputError, match=r"n\.tif"):
        load_terrain(path)
    point = rasterio.control.GroundControlPoint
    corners = [point(0, 0, 0, 9), point(0, N, 9, 9), point(N, 0, 0, 0), point(N, N, 9, 0)]
    with rasterio.open(
        tmp_path / "g.tif", "w", driver="GTiff", height=N, width=N, count=1, dtype="float32",
    ) as file:  # fmt: skip
        file.gcps = (corners, rasterio.crs.CRS.from_string(METRIC))
    with pytest.raises(InputError, match="control points"):
        load_terrain(tmp_path / "g.tif", posting=1.0)


def test_a_large_raster_is_described_by_its_header(tmp_path):
    path = tmp_path / "large.tif"
    with rasterio.open(
        path, "w", driver="GTiff", height=30_000, width=30_000, count=1, dtype="float32",
        crs=METRIC, transform=NORTH_UP, tiled=True, blockxsize=256, blockysize=256, sparse_ok=True,
    ) as file:  # fmt: skip
        file.write(np.full((256, 256), 7.0, np.float32), 1, window=Window(512, 256, 256, 256))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    done = CliRunner().invoke(main, ["terrain", "info", str(path)])
    assert "30000 x 30000" in done.output
    assert "use --window" in done.output
    info = read_info(path, window=(0, 600, 0, 30_000))
    assert info.z_range == (0.0, 7.0)
    assert info.statistics.posts == 600 * 30_000
    assert info.statistics.mean == pytest.approx(7.0 * 256**2 / (600 * 30_000), rel=1e-9)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


def test_info_says_how_a_raster_lies(tmp_path):
    case = Case(map=equirectangular(60.0), orientation="south-up", unit="km", metres=1e3)
    path = case.write(tmp_path)
    words = " ".join(CliRunner().invoke(main, ["terrain", "info", str(path)]).output.split())
    assert "rows from south to north, columns from west to east" in words
    assert "1 m of terrain is 2.0000 m of map along rows, 1.0000 m along columns" in words
    assert "resampled to 7.07" in words
    assert "km (1000 m)" in words
    part = CliRunner().invoke(main, ["terrain", "info", str(path), "--window", "0", "9", "0", "8"])
    assert "9 x 8" in part.output


def test_keys_of_a_scenario(tmp_path):
    z = HILL.copy()
    z[100:103, 100] = -9999.0
    path = write(tmp_path / "z.tif", z, unit="furlong")
    table = {"kind": "dtm", "path": str(path), "detail": False}

    def ground(**keys):
        return Scenario.from_dict({"terrain": table | keys}).terrain.make()

    with pytest.raises(InputError, match="dtm_unit"):
        ground().check_files()
    with pytest.raises(InputError, match="dtm_nodata"):
        ground(dtm_unit="m").check_files()
    for nodata in (-9999, [-9999, -1]):
        assert np.isnan(ground(dtm_unit="m", dtm_nodata=nodata, posting_m=1.0).relief().z).any()


def test_keys_of_the_surroundings(tmp_path):
    path = write(tmp_path / "z.tif", np.where(EAST > 99, -9999.0, HILL), unit="furlong")
    flat = Terrain(load_terrain(SCENARIOS / "data" / "hirise_dteec_010228_1490_crop.tif"))

    def first(**keys):
        around = FarTerrainSettings(
            sizes=(8e3,), postings=(40.0,), rms_slopes=(0.0,), path=path, **keys
        )
        moon = CentralGravity(1.622, 1_737_400.0, np.zeros(3))
        return around.build(flat, moon, RandomStreams(1)).level(0)

    with pytest.raises(InputError, match=r"far_terrain\.path.*far_terrain\.dtm_unit"):
        first()
    with pytest.raises(InputError, match=r"far_terrain\.dtm_nodata"):
        first(dtm_unit="m")
    with pytest.raises(InputError, match="without gaps"):
        first(dtm_unit="m", dtm_nodata=-9999.0)
    assert first(dtm_unit="m", dtm_nodata=()).grid.shape == (N, N)
