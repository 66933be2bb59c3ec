"""Far terrain for all sensors: ranges, places and heights of rasters, shadows on the map."""

import math

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from lunarsim.errors import InputError
from lunarsim.frames import attitude_from_thrust, quat_from_rotation_vector
from lunarsim.grid import Grid
from lunarsim.models.gravity import RoundMoon
from lunarsim.models.lander import Lander
from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.sensors.altimeter import RadarAltimeter
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.sensors.velocimeter import DopplerVelocimeter
from lunarsim.simulation.worlds import build_world
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.far_shadow import FarShadow
from lunarsim.world.far_terrain import FarTerrain, FarTerrainSettings
from lunarsim.world.horizon import terrain_horizon
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield, Terrain
from lunarsim.world.truth_products import TruthProducts
from tests.reference.far_terrain import Cone, sphere_range

MOON = RoundMoon().gravity(1.622)
R = MOON.radius
CONE = Cone(300.0, 5_000.0, 900.0, 2_500.0)
DEG = math.pi / 180.0


def _state(position, attitude=None):
    up = attitude_from_thrust([0.0, 0.0, 1.0], 0.0) if attitude is None else attitude
    return State(np.array(position, float), np.zeros(3), up, np.zeros(3), 1_000.0, 1_000.0)


def _world(moon=None, cone=CONE, side=20_000.0, posting=10.0, **light):
    """Return a flat map of 800 m in a square with a cone."""
    grid = Grid.centred((0.0, 0.0), 800.0, 2.0)
    terrain = Terrain(Heightfield(grid, np.zeros(grid.shape, np.float32)))
    g = Grid.centred((0.0, 0.0), side, posting)
    around = Heightfield(g, cone.z(*np.meshgrid(g.x, g.y)).astype(np.float32))
    settings = FarTerrainSettings(sizes=(side,), postings=(posting,), rms_slopes=(0.0,))
    far = FarTerrain(terrain, moon, settings, lambda n: around)
    return World(terrain, 1.622, moon=moon, light=Light(**light), far_terrain=far)


@pytest.mark.parametrize("moon", [None, MOON])
def test_all_range_sensors_see_beyond_the_map(moon):
    scenario = Scenario.from_dict(
        {
            "terrain": {"kind": "fractal", "size_m": 100.0, "rms_slope_deg": 0.0},
            "rocks": {"cover": 0.0}, "far_terrain": {"rms_slopes_deg": [0.0, 0.0]},
            **({} if moon is None else {"moon": {}}),
        }
    )  # fmt: skip
    world = build_world(scenario, RandomStreams(1))
    rng = np.random.default_rng(0)
    angle = 0.3
    tilted = quat_from_rotation_vector(np.array([angle, 0.0, 0.0]))
    for height in (1_000.0, 4_000.0):
        for place in ((0.0, 0.0), (900.0, -2_000.0)):
            level = height
            if moon is not None:
                level = math.sqrt((R + height) ** 2 - np.dot(place, place)) - R
            state = _state((*place, level), tilted)
            quiet = RadarAltimeter(noise_ratio=0.0, noise_floor=1e-9, max_range=1e5)
            seen = quiet.measure(world, state, 0.0, rng).range
            beam = np.array([0.0, math.sin(angle), -math.cos(angle)])
            up = np.array([0.0, 0.0, 1.0]) if moon is None else MOON.up(state.position)
            off = math.acos(-float(beam @ up))
            wanted = height / math.cos(off) if moon is None else sphere_range(height, off, R)
            assert seen == pytest.approx(wanted, abs=2e-3)
    state = _state((900.0, -2_000.0, 800.0))
    speeds = DopplerVelocimeter(range_noise=1e-9).measure(world, state, 0.0, rng)
    assert speeds.range == pytest.approx(3 * [800.0 / math.cos(22.5 * DEG)], rel=5e-3)
    scan = FlashLidar(rows=8, cols=8).measure(world, state, 0.0, rng)
    assert np.isfinite(scan.range).all()
    bare = World(world.terrain, 1.622, moon=moon)
    assert not np.isfinite(FlashLidar(rows=8, cols=8).measure(bare, state, 0.0, rng).range).any()


def test_rays_hit_a_cone_where_it_is():
    world = _world(posting=5.0)
    rng = np.random.default_rng(3)
    origin = rng.uniform((-3_000.0, -3_000.0, 1_000.0), (3_000.0, 7_000.0, 3_000.0), (400, 3))
    ray = rng.normal(0.0, 0.5, (400, 3)) - np.array([0.0, 0.0, 0.6])
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    wanted = np.array([CONE.hit(o, d) for o, d in zip(origin, ray, strict=True)])
    hits = world.cast(origin, ray)
    at = origin + wanted[:, None] * ray
    known = np.abs(at[:, :2]).max(1) < 9_000.0
    steep = ray[:, 2] < -0.3
    assert (known & steep & (CONE.z(at[:, 0], at[:, 1]) > 1.0)).sum() > 30
    assert hits.range[known & steep] == pytest.approx(wanted[known & steep], abs=8.0)
    assert np.isnan(hits.range[np.isnan(wanted)]).all()
    on_slope = known & steep & (CONE.z(at[:, 0], at[:, 1]) > 50.0)
    on_slope &= np.hypot(at[:, 0] - CONE.x, at[:, 1] - CONE.y) > 50.0
    lean = np.rad2deg(np.arccos(hits.normal[on_slope, 2]))
    assert lean == pytest.approx(np.rad2deg(math.atan(900.0 / 2_500.0)), abs=1.0)


def test_a_ridge_beyond_the_map_hides_the_map_behind_it():
    world = _world(cone=Cone(1_500.0, 0.0, 400.0, 800.0))
    origin = np.array([3_000.0, 0.0, 300.0])
    ray = np.array([0.0, 0.0, 0.0]) - origin
    ray /= np.linalg.norm(ray)
    assert np.isfinite(world.terrain.cast(origin, ray[None]).range[0])
    wanted = Cone(1_500.0, 0.0, 400.0, 800.0).hit(origin, ray)
    assert world.cast(origin, ray[None]).range[0] == pytest.approx(wanted, abs=2.0)
    assert wanted < 1_500.0


def test_missing_heights_of_the_map_do_not_hide_terrain_beyond_it():
    grid = Grid.centred((0.0, 0.0), 400.0, 4.0)
    z = np.zeros(grid.shape, np.float32)
    z[:, -20:] = np.nan
    terrain = Terrain(Heightfield(grid, z))
    settings = FarTerrainSettings(sizes=(8_000.0,), postings=(40.0,), rms_slopes=(0.05,))
    far = settings.build(terrain, None, RandomStreams(2))
    assert np.isfinite(far.elevation([[210.0, 0.0], [2_000.0, 5.0]])).all()
    world = World(terrain, 1.622, far_terrain=far)
    down = np.array([[0.0, 0.0, -1.0]])
    assert np.isfinite(world.cast([210.0, 0.0, 500.0], down).range[0])
    assert np.isnan(world.cast([180.0, 0.0, 500.0], down).range[0])
    # From below the map, rays come out of the ground: they hit nothing.
    through = np.array([0.6, 0.0, -0.8])
    assert np.isnan(world.cast([180.0, 0.0, 20.0], through[None]).range[0])


# --- rasters ------------------------------------------------------------------------------------

POLAR = "+proj=stere +lat_0=-90 +lat_ts=-90 +lon_0=0 +R=1737400 +units=m +no_defs"


def _height(x, y):
    """Return absolute heights at coordinates of the polar map: a wide slope with hills."""
    return 1_200.0 + 0.02 * x + 0.05 * y + 60.0 * np.sin(x / 900.0) * np.cos(y / 700.0)


def _write(path, west, north, side, posting, offset=0.0, crs=POLAR):
    n = round(side / posting)
    x = west + (np.arange(n) + 0.5) * posting
    y = north - (np.arange(n) + 0.5) * posting
    z = (_height(*np.meshgrid(x, y)) + offset).astype(np.float32)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=n,
        height=n,
        count=1,
        dtype="float32",
        crs=crs,
        transform=from_origin(west, north, posting, posting),
    ) as out:
        out.write(z, 1)  # fmt: skip
    return path


def _raster_scenario(tmp_path, centre=None, far_crs=POLAR, offset=250.0, **more):
    # The map's centre is (20,000; 12,000) m from the pole: its north is not the map's y.
    _write(tmp_path / "map.tif", 19_800.0, 12_200.0, 400.0, 4.0)
    _write(tmp_path / "far.tif", 15_000.0, 16_000.0, 9_000.0, 40.0, offset, far_crs)
    far = {"path": "far.tif", "sizes_m": [8_000.0], "postings_m": [40.0], "rms_slopes_deg": [0.0]}
    if centre is not None:
        far["centre_m"] = centre
    if far_crs is None:
        far["dtm_posting_m"] = 40.0
    terrain = {"kind": "dtm", "path": "map.tif", "detail": False, "posting_m": 4.0}
    tables = {"terrain": terrain, "rocks": {"cover": 0.0}, "far_terrain": far | more}
    return Scenario.from_dict(tables, tmp_path)


def _north_at(x, y):
    """Return unit vectors east and north (2, 2) at a point of the polar map.

    Around the south pole, y = r cos(longitude) and x = r sin(longitude), and north is outwards.
    """
    out = np.array([x, y]) / math.hypot(x, y)
    return np.array([[out[1], -out[0]], out])


@pytest.mark.parametrize("moon", [{}, {"moon": {}}])
def test_georeferenced_rasters_fit_in_place_and_height(tmp_path, moon):
    scenario = _raster_scenario(tmp_path).changed(**moon)
    world = build_world(scenario, RandomStreams(1))
    far = world.far_terrain
    axes = _north_at(20_000.0, 12_000.0)
    xy = np.random.default_rng(2).uniform(-1_800.0, 1_800.0, (200, 2))
    xy = xy[np.hypot(*xy.T) > 400.0]
    x, y = (np.array([20_000.0, 12_000.0]) + xy @ axes).T
    ys, xs = np.mgrid[-198.0:199.0:4.0, -198.0:199.0:4.0]
    base = _height(20_000.0 + xs, 12_000.0 + ys).mean()
    wanted = _height(x, y) - base
    # Interpolation of 40 m posts, and 1e-4 of the distance by the projection's scale.
    assert far.elevation(xy) == pytest.approx(wanted, abs=0.6)


def test_a_raster_without_georeferencing_lies_where_its_centre_is_given(tmp_path):
    scenario = _raster_scenario(tmp_path, centre=[700.0, -400.0], far_crs=None)
    far = build_world(scenario, RandomStreams(1)).far_terrain
    # The centre of the raster, at (19,500; 11,500) of the file, is at (700, -400) of the map.
    xy = np.random.default_rng(4).uniform(-1_500.0, 1_500.0, (100, 2))
    xy = xy[np.abs(xy).max(1) > 300.0]
    found = far.elevation(xy)
    wanted = _height(*(xy - [700.0, -400.0] + [19_500.0, 11_500.0]).T)
    assert np.std(found - wanted) < 0.2
    over = np.random.default_rng(5).uniform(-190.0, 190.0, (4_000, 2))
    # Over the map, both have the same mean.
    shift = (found - wanted).mean()
    raster = _height(*(over - [700.0, -400.0] + [19_500.0, 11_500.0]).T) + shift
    height = far.terrain.elevation(over)  # the map's corners are unknown: its north is not up
    assert np.nanmean(raster - height) == pytest.approx(0.0, abs=0.5)
    # It fades out at its own edges.
    assert far.elevation([[3_999.0, 0.0]]) == pytest.approx([0.0], abs=0.5)


def test_a_raster_may_lie_beside_the_map(tmp_path):
    scenario = _raster_scenario(tmp_path, centre=[6_000.0, 0.0], far_crs=None, sizes_m=[30_000.0])
    far = build_world(scenario, RandomStreams(1)).far_terrain
    assert far.elevation([[-2_000.0, 0.0]]) == pytest.approx([0.0])
    xy = np.random.default_rng(4).uniform(4_500.0, 7_500.0, (60, 2)) * [1.0, 0.0]
    wanted = _height(*(xy - [6_000.0, 0.0] + [19_500.0, 11_500.0]).T)
    assert np.std(far.elevation(xy) - wanted) < 0.2


def test_a_raster_of_another_place_is_refused(tmp_path):
    _write(tmp_path / "map.tif", 19_800.0, 12_200.0, 400.0, 4.0)
    scenario = _raster_scenario(tmp_path)
    _write(tmp_path / "far.tif", -80_000.0, 16_000.0, 9_000.0, 40.0)
    with pytest.raises(InputError, match=r"far_terrain\.path.*cover the origin.*centre_m"):
        build_world(scenario, RandomStreams(1)).far_terrain.elevation([[900.0, 0.0]])
    moved = scenario.changed(far_terrain={"centre_m": [0.0, 0.0]})
    assert np.isfinite(build_world(moved, RandomStreams(1)).far_terrain.elevation([[900.0, 0.0]]))
    away = scenario.changed(far_terrain={"centre_m": [90_000.0, 0.0]})
    with pytest.raises(InputError, match=r"far_terrain\.centre_m.*square of 8000 m"):
        build_world(away, RandomStreams(1)).far_terrain.elevation([[900.0, 0.0]])
    with pytest.raises(InputError, match=r"far_terrain\.centre_m: places the raster"):
        Scenario.from_dict({"far_terrain": {"centre_m": [1.0, 2.0]}})


# --- shadows ------------------------------------------------------------------------------------


def _points(n=40, seed=6, top=60.0):
    rng = np.random.default_rng(seed)
    return np.column_stack((rng.uniform(-395.0, 395.0, (n, 2)), rng.uniform(0.0, top, n)))


@pytest.mark.parametrize("azimuth", [0.02, 0.06, 0.1])
def test_the_shadow_of_a_cone_ends_where_its_horizon_is(azimuth):
    light = {"azimuth": azimuth, "elevation": 9.5 * DEG}
    world = _world(**light, posting=5.0)
    found = FarShadow.of(world.far_terrain, world.light).sunlight(_points(300))
    ray = world.light.direction
    wanted = [float(math.isnan(CONE.hit(p, ray))) for p in _points(300)]
    # The summit is cut off by half a post, 2 m: 20 m on the map.
    assert 20 < sum(wanted) < 280
    assert np.abs(found - wanted).sum() <= 12


def test_the_penumbra_of_a_cone_is_that_of_rays_over_the_disc():
    light = {"azimuth": 0.06, "elevation": 9.7 * DEG, "diameter": 0.53 * DEG}
    world = _world(**light, posting=5.0)
    points = _points(150)
    found = FarShadow.of(world.far_terrain, world.light).sunlight(points)
    wanted = np.array([CONE.visible(p, 0.06, 9.7 * DEG, 0.53 * DEG) for p in points])
    assert ((wanted > 0.05) & (wanted < 0.95)).sum() > 15
    assert found == pytest.approx(wanted, abs=0.08)


def test_shadows_on_a_round_moon_agree_with_the_horizon_of_each_point():
    light = {"azimuth": 0.012, "elevation": 4.6 * DEG, "diameter": 0.53 * DEG}
    cone = Cone(400.0, 40_000.0, 3_700.0, 12_000.0)
    world = _world(MOON, cone=cone, side=120_000.0, posting=50.0, **light)
    far, sun = world.far_terrain, world.light
    points = np.array(
        [[x, y, 0.0] for x in (-390.0, -100.0, 200.0, 390.0) for y in (-350.0, 350.0)]
    )
    found = FarShadow.of(far, sun).sunlight(points)
    wanted = [
        terrain_horizon(
            lambda arc: cone.z(*arc.T), p[:2], height=0.0, radius=R, posting=2_000.0,
            max_range=60_000.0, azimuths=2_880,
        ).visible_fraction(sun.azimuth, sun.elevation, sun.diameter)
        for p in points
    ]  # fmt: skip
    assert np.ptp(wanted) > 0.2
    assert found == pytest.approx(np.array(wanted), abs=0.04)
    # Without the curvature, the summit is 0.66 deg higher: all points are in full shadow.
    flat = _world(None, cone=cone, side=120_000.0, posting=50.0, **light)
    assert FarShadow.of(flat.far_terrain, sun).sunlight(points).max() == 0.0


def test_true_shadow_maps_include_shadows_of_far_terrain():
    world = _world(azimuth=0.06, elevation=9.5 * DEG, posting=5.0)
    grid = Grid.centred((0.0, 0.0), 700.0, 10.0)
    shadow = TruthProducts.of(world, Lander(), grid).shadow
    ray = world.light.direction
    points = np.dstack((grid.centres(), np.zeros(grid.shape))).reshape(-1, 3)
    wanted = np.array([not math.isnan(CONE.hit(p, ray)) for p in points]).reshape(grid.shape)
    assert 0.05 < wanted.mean() < 0.95
    assert (shadow != wanted).mean() < 0.03
    bare = World(world.terrain, 1.622, light=world.light)
    assert not TruthProducts.of(bare, Lander(), grid).shadow.any()
