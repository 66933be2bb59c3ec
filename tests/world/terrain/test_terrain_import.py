"""Landing areas cut out of terrain products, against analytic terrain on a sphere."""

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from scipy import ndimage

import lunarsim
from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.world.terrain.terrain_import import import_area, quantization_step
from tests.world.terrain.raster_cases import CASES
from tests.world.terrain.rasters import COLS, RADIUS, Plane, terrain

USABLE = {name: case for name, case in CASES.items() if not case.refused}


def places(lat0, lon0, east, north, radius=RADIUS):
    """Latitudes and longitudes, rad, of points about a place by spherical trigonometry."""
    c, bearing = np.hypot(east, north) / radius, np.arctan2(east, north)
    if lat0 > np.radians(89.9999999):  # the north pole
        return lat0 - c, lon0 + np.pi - bearing
    sin_lat = np.sin(lat0) * np.cos(c) + np.cos(lat0) * np.sin(c) * np.cos(bearing)
    y = np.sin(bearing) * np.sin(c) * np.cos(lat0)
    x = np.cos(c) - np.sin(lat0) * sin_lat
    return np.arcsin(np.clip(sin_lat, -1.0, 1.0)), lon0 + np.arctan2(y, x)


def grid(area):
    n = len(area.heights)
    axis = (np.arange(n) - 0.5 * (n - 1)) * area.posting
    return np.meshgrid(axis, axis)


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize("case", USABLE.values(), ids=USABLE)
def test_every_product_gives_the_analytic_terrain(case, tmp_path):
    path, options = case.write(tmp_path), dict(case.options)
    is_plane, at = isinstance(case.map, Plane), None
    size = 0.5 * COLS * min(case.map.true_step)
    if not is_plane:
        lat, lon = places(*np.radians([case.map.lat, case.map.lon]), 0.1 * size, -0.06 * size)
        at = (float(np.degrees(lat)), float((np.degrees(lon) + 180.0) % 360.0 - 180.0))
    area = import_area(path, at, size, max_void=0, **options)
    east, north = grid(area)
    if not is_plane:
        lat, lon = places(*np.radians(at), east, north)
        # Longitudes near that of the centre of the map, as its formulas need them.
        lon0 = np.radians(case.map.lon)
        lon = lon0 + (lon - lon0 + np.pi) % (2.0 * np.pi) - np.pi
        east, north = case.map.local(*case.map.forward(lon, lat))
        assert (area.latitude, area.longitude) == pytest.approx(at)
    known = np.isfinite(area.heights)
    rounding = 0.5 * case.scale * case.metres if case.dtype.startswith(("int", "uint")) else 0.0
    inner = ndimage.binary_erosion(known, iterations=3, border_value=1)
    # The numbers of some files overflow: their heights have a constant error.
    error = area.heights - terrain(east, north, case.size)
    error -= np.median(error[known])
    assert np.abs(error[inner]).max() <= max(1e-3, 5e-7 * case.size) + 2.0 * rounding
    assert known.mean() > 0.9
    if rounding:
        assert area.step == pytest.approx(2.0 * rounding)


def small_moon(folder, *, west=0.0, polar=False, dtype="float32", scale=1.0):
    """A map of a complete body of 3 km radius, posts of 10 m."""
    radius, path = 3000.0, folder / "body.tif"
    if polar:
        n, step = 200, 10.0
        crs = f"+proj=stere +lat_0=90 +lon_0=0 +R={radius} +units=m"
        transform = Affine(step, 0, -n * step / 2, 0, -step, n * step / 2)
        x, y = transform @ (np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5))
        lat = np.pi / 2 - 2.0 * np.arctan(np.hypot(x, y) / (2.0 * radius))
        lon = np.arctan2(x, -y)
    else:
        crs, step = f"+proj=longlat +R={radius}", 0.2
        transform = Affine(step, 0, west, 0, -step, 90.0)
        col, row = np.meshgrid(np.arange(1800) + 0.5, np.arange(900) + 0.5)
        lon, lat = np.radians(west + step * col), np.radians(90.0 - step * row)
    z = surface(lat, lon) / scale
    z = np.round(z) if np.dtype(dtype).kind == "i" else z
    with rasterio.open(
        path, "w", driver="GTiff", width=z.shape[1], height=z.shape[0], count=1, dtype=dtype,
        crs=crs, transform=transform,
    ) as file:  # fmt: skip
        file.write(z.astype(dtype), 1)
        file.scales = (scale,)
    return path


def surface(lat, lon):
    """Smooth heights on the small body, different everywhere."""
    x, y, z = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    return 20.0 * np.sin(3.0 * x) + 15.0 * np.cos(4.0 * y) + 10.0 * np.sin(5.0 * z + x)


@pytest.mark.parametrize("west", [0.0, -180.0])
@pytest.mark.parametrize(
    "at", [(10.0, 179.9), (-35.0, -179.95), (5.0, 0.05), (60.0, 359.9), (20.0, 90.0)]
)
def test_a_map_of_the_complete_body_continues_beyond_its_edges(tmp_path, west, at):
    area = import_area(small_moon(tmp_path, west=west), at, 400.0)
    lat, lon = places(*np.radians(at), *grid(area), radius=3000.0)
    assert area.heights == pytest.approx(surface(lat, lon), abs=2e-3)
    assert area.missing == 0.0


def test_a_polar_map_across_the_pole(tmp_path):
    for at in ((90.0, 0.0), (89.0, 40.0), (87.0, -170.0)):
        area = import_area(small_moon(tmp_path, polar=True), at, 600.0, posting=7.0)
        lat, lon = places(*np.radians(at), *grid(area), radius=3000.0)
        assert area.heights == pytest.approx(surface(lat, lon), abs=2e-3)


def test_an_area_around_the_pole_of_a_map_in_degrees_lacks_only_the_pole(tmp_path):
    area = import_area(small_moon(tmp_path), (89.0, 20.0), 400.0)
    lat, lon = places(*np.radians([89.0, 20.0]), *grid(area), radius=3000.0)
    known = np.isfinite(area.heights)
    assert not known[lat > np.radians(89.91)].any()
    assert known[lat < np.radians(89.7)].all()
    assert area.heights[known] == pytest.approx(surface(lat, lon)[known], abs=2e-3)


def test_small_voids_are_filled_and_large_ones_stay(tmp_path):
    path = small_moon(tmp_path)
    with rasterio.open(path, "r+") as file:
        z = file.read(1)
        exact = z.copy()
        z[400:403, 900:904] = -9999.0  # 12 posts
        z[430:445, 910:925] = -9999.0  # 225 posts
        file.nodata = -9999.0
        file.write(z, 1)
    at = (90.0 - 0.2 * 415.0, 0.2 * 910.0)
    area = import_area(path, at, 700.0, max_void=100)
    assert (area.filled, area.largest_void) == (12, 225)
    lat, lon = places(*np.radians(at), *grid(area), radius=3000.0)
    known = np.isfinite(area.heights)
    assert 150 < (~known).sum() < 500
    # The relief within three posts is nearly a plane.
    assert np.abs(area.heights - surface(lat, lon))[known].max() < 0.3
    assert area.missing == pytest.approx(np.mean(~known))
    unfilled = import_area(path, at, 700.0, max_void=0)
    assert unfilled.filled == 0
    assert np.isfinite(unfilled.heights).sum() < known.sum()
    assert np.ptp(exact) > 20.0


def test_the_quantization_step_is_found(tmp_path):
    path = small_moon(tmp_path, dtype="int16", scale=0.25)
    assert import_area(path, (10.0, 30.0), 800.0).step == pytest.approx(0.25)
    rng = np.random.default_rng(1)
    z = 100.0 + np.cumsum(rng.normal(size=4000))
    assert quantization_step(z.astype(np.float32)) is None
    for step in (0.5, 0.1922, 1.0):
        assert quantization_step(
            (step * np.round(z / step) + 0.03).astype(np.float32)
        ) == pytest.approx(step, rel=1e-3)


def test_the_roughness_continues_the_spectrum(tmp_path):
    model = lunarsim.Scenario.from_dict({
        "terrain": {"size_m": 600.0, "posting_m": 1.0, "hurst": 0.7, "rms_slope_deg": 6.0},
        "rocks": {"cover": 0.0},
    })  # fmt: skip
    z = model.terrain.make().relief().z.astype(np.float64)
    path = tmp_path / "z.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=z.shape[1], height=z.shape[0], count=1, dtype="float32",
        crs="+proj=eqc +R=1737400 +units=m", transform=Affine(1, 0, -300, 0, -1, 300),
    ) as file:  # fmt: skip
        file.write(z[::-1], 1)
    area = import_area(path, None, 500.0)
    assert area.hurst == pytest.approx(0.7, abs=0.08)
    assert np.degrees(area.rms_slope) == pytest.approx(6.0, rel=0.15)


def test_heights_from_the_centre_of_the_body_keep_their_millimetres(tmp_path):
    path = small_moon(tmp_path, dtype="float64")
    with rasterio.open(path, "r+") as file:
        file.offsets = (1_737_400.0,)
    area = import_area(path, (10.0, 30.0), 400.0)
    area.write(tmp_path / "out.tif")
    with rasterio.open(tmp_path / "out.tif") as file:
        z = file.read(1).astype(np.float64) + file.offsets[0]
        assert file.transform @ (0.5, 0.5) == pytest.approx((-200.0, 200.0), abs=5.1)
        assert file.crs.to_dict()["proj"] == "aeqd"
    assert z[::-1] == pytest.approx(area.heights, abs=1e-3)


@pytest.mark.parametrize(
    ("at", "size", "more", "words"),
    [
        ((10.0, 400.0), 400.0, {}, "--at: must be a latitude up to 90"),
        ((95.0, 0.0), 400.0, {}, "--at: must be a latitude up to 90"),
        ((np.nan, 0.0), 400.0, {}, "--at: must be a latitude up to 90"),
        ((10.0, 30.0), 20.0, {}, "--size: must be at least"),
        ((10.0, 30.0), 1e6, {}, "--size: must be at most"),
        ((10.0, 30.0), 400.0, {"posting": 0.01}, "--size: must be at most 80 m"),
        ((10.0, 30.0), 400.0, {"unit": "parsec"}, "dtm_unit"),
    ],
)
def test_bad_requests_are_refused(tmp_path, at, size, more, words):
    with pytest.raises(InputError, match=words):
        import_area(small_moon(tmp_path), at, size, **more)


def run(*arguments):
    return CliRunner().invoke(main, ["terrain", "import", *map(str, arguments)])


def test_the_command_writes_a_scenario_that_flies(tmp_path):
    path, out = small_moon(tmp_path, dtype="int16", scale=0.1), tmp_path / 'my "own".toml'
    done = run(path, "--at", 10, 30, "--size", "0.4km", "--out", out)
    assert done.exit_code == 0, done.output
    assert "multiples of 0.1 m" in done.output
    scenario = lunarsim.Scenario.load(out)
    assert scenario.site.latitude_deg == 10.0
    assert (scenario.terrain.hurst, scenario.terrain.detail) == (
        pytest.approx(0.98, abs=0.05),
        True,
    )
    assert lunarsim.fly(scenario, policy="no-divert", seed=1).outcome.touchdown is not None
    scenario = scenario.changed(terrain={"detail": False}, rocks={"cover": 0.0})
    world = lunarsim.Simulation(scenario, 1, "no-divert").world
    at = np.array([[0.0, 0.0], [100.0, -50.0]])
    lat, lon = places(*np.radians([10.0, 30.0]), *at.T, radius=3000.0)
    difference = world.terrain.elevation(at) - surface(lat, lon)
    assert difference[0] == pytest.approx(difference[1], abs=0.1)


def test_bad_commands_write_nothing(tmp_path):
    path = small_moon(tmp_path)
    before = set(tmp_path.iterdir())
    for size, at, out in (("4 miles", (0, 0), "a.toml"), ("-4km", (0, 0), "a.toml"),
                          ("4km", (0, 0), "a.txt"), ("30km", (0, 0), "a.toml"),
                          ("0.4km", (0, 0), "no/a.toml")):  # fmt: skip
        done = run(path, "--at", *at, "--size", size, "--out", tmp_path / out)
        assert done.exit_code == 2
        assert "Traceback" not in done.output
    assert set(tmp_path.iterdir()) == before


def test_the_source_is_never_replaced(tmp_path):
    path = small_moon(tmp_path)
    before = path.read_bytes()
    (tmp_path / "link.tif").symlink_to(path)
    for out in ("body.toml", "link.toml"):
        done = run(path, "--at", 0, 0, "--size", "0.4km", "--out", tmp_path / out)
        assert done.exit_code == 2
        assert "--out: must have another name" in done.output
    assert path.read_bytes() == before
    assert not list(tmp_path.glob("*.toml"))


def test_names_cannot_add_lines_to_the_scenario(tmp_path):
    wkt = rasterio.CRS.from_proj4("+proj=longlat +R=3000").to_wkt()
    path = small_moon(tmp_path).rename(tmp_path / "b\n[simulation]\ncycle_s = 9 #.tif")
    with rasterio.open(path, "r+") as file:
        file.crs = rasterio.CRS.from_wkt(wkt.replace('"unknown"', '"c\n[dust]\n#"', 1))
    out = tmp_path / "d\ne.toml"
    assert run(path, "--at", 0, 0, "--size", "0.4km", "--out", out).exit_code == 0
    scenario = lunarsim.Scenario.load(out)
    assert scenario.name == "d\ne" and scenario.dust is None
    assert scenario.simulation == lunarsim.Scenario.from_dict({}).simulation
    assert scenario.terrain.path == tmp_path / "d\ne.tif"


def test_a_place_needs_a_reference_on_a_body(tmp_path):
    with rasterio.open(
        tmp_path / "z.tif", "w", driver="GTiff", width=50, height=50, count=1, dtype="float32",
        crs=rasterio.CRS.from_wkt('LOCAL_CS["plane",UNIT["metre",1.0]]'),
        transform=Affine(1, 0, 0, 0, -1, 50),
    ) as file:  # fmt: skip
        file.write(np.arange(2500, dtype="float32").reshape(50, 50), 1)
    with pytest.raises(InputError, match=r"--at: must be omitted.* no place on a body"):
        import_area(tmp_path / "z.tif", (10.0, 20.0), 20.0)
    assert import_area(tmp_path / "z.tif", None, 20.0).latitude is None


def test_a_place_on_the_other_side_of_a_polar_map(tmp_path):
    with pytest.raises(InputError, match="has a projection that excludes latitude -90"):
        import_area(small_moon(tmp_path, polar=True), (-90.0, 0.0), 400.0)


def test_places_on_a_flattened_body_are_planetocentric(tmp_path):
    """The heights of the file are its planetodetic latitudes."""
    a, b, step = 1_738_100.0, 1_736_000.0, 0.0005
    rows = 45.2 - step * (np.arange(800) + 0.5)
    z = np.repeat(1e4 * (rows[:, None] - 45.0), 60, axis=1)
    with rasterio.open(
        tmp_path / "z.tif", "w", driver="GTiff", width=60, height=800, count=1, dtype="float64",
        crs=f"+proj=longlat +a={a} +b={b}", transform=Affine(step, 0, 10, 0, -step, 45.2),
    ) as file:  # fmt: skip
        file.write(z, 1)
    area = import_area(tmp_path / "z.tif", (45.0, 10.015), 120.0, posting=10.0)
    middle = area.heights[6, 6]
    expected = np.degrees(np.arctan((a / b) ** 2 * np.tan(np.radians(45.0))))
    assert 45.0 + middle / 1e4 == pytest.approx(expected, abs=1e-7)
    assert (area.latitude, area.longitude) == pytest.approx((45.0, 10.015), abs=1e-12)
    area.write(tmp_path / "out.tif")
    again = import_area(tmp_path / "out.tif", None, 80.0)
    assert (again.latitude, again.longitude) == pytest.approx((45.0, 10.015), abs=1e-9)
    assert again.heights == pytest.approx(area.heights[2:-2, 2:-2], abs=1e-2)


@pytest.mark.parametrize("failing", [1, 2])
def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch, failing):
    path, calls = small_moon(tmp_path), []

    def fsync(_):
        calls.append(1)
        if len(calls) == failing:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fsync)
    done = run(path, "--at", 0, 0, "--size", "0.4km", "--out", tmp_path / "a.toml")
    assert done.exit_code != 0 and "No space left" in done.output
    assert {p.name for p in tmp_path.iterdir()} == {"body.tif"}
