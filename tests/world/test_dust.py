"""Dust under the engine, and what the sensors see through it."""

from dataclasses import replace

import numpy as np
import pytest

import lunarsim
from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector
from lunarsim.grid import Grid
from lunarsim.sensors.altimeter import RadarAltimeter
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.sensors.velocimeter import DopplerVelocimeter
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.dust import Dust
from lunarsim.world.light import Light
from lunarsim.world.terrain import Heightfield, Terrain
from tests.chance import proportion_bounds
from tests.reference.dust import optical_depth
from tests.worlds import TINY_FLIGHT

GRID = Grid.centred((0.0, 0.0), 400.0, 2.0)
FLAT = Terrain(Heightfield(GRID, np.zeros(GRID.shape, np.float32)))
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
DUST = Dust(onset_height=20.0, onset_thrust=4000.0, optical_depth=0.5)


def state(height, thrust=4000.0, attitude=UPRIGHT):
    return State(
        np.array([3.0, -2.0, height]),
        np.array([0.5, 0.0, -1.0]),
        attitude,
        np.zeros(3),
        1e3,
        thrust,
    )


def sheet(height, thrust=4000.0, attitude=UPRIGHT, dust=DUST):
    s = state(height, thrust, attitude)
    return dust.sheet(FLAT, s.position, s.attitude, s.thrust)


def world(dust=DUST):
    return World(FLAT, 1.62, Light(1.0, 0.5), dust=dust)


def rng(seed=1):
    return np.random.default_rng(seed)


def test_the_onset_is_proportional_to_the_root_of_the_thrust():
    assert sheet(20.01) is None
    assert sheet(19.99).depth == pytest.approx(0.0, abs=1e-3)
    assert sheet(10.01, 1000.0) is None
    assert sheet(9.99, 1000.0) is not None
    assert sheet(5.0, 0.0) is None
    # Four times the pressure: an excess of three.
    assert sheet(10.0).depth == pytest.approx(1.5)
    assert sheet(10.0, 16000.0).depth == pytest.approx(7.5)


def test_the_dust_is_where_the_plume_meets_the_terrain():
    tilted = quat_from_rotation_vector(np.array([0.0, np.radians(30.0), 0.0]))
    found = sheet(10.0, attitude=tilted)
    # The thrust points to +x, the plume to -x; the plume is longer than the height.
    np.testing.assert_allclose(
        found.foot, [3.0 - 10.0 * np.tan(np.radians(30.0)), -2.0, 0.0], atol=1e-6
    )
    slant = 10.0 / np.cos(np.radians(30.0))
    assert found.depth == pytest.approx(0.5 * ((20.0 / slant) ** 2 - 1.0))


def test_more_thrust_and_less_height_never_lift_less():
    depths = [[s.depth if (s := sheet(h, f)) else 0.0 for h in np.arange(30.0, 1.0, -1.0)]
              for f in np.arange(500.0, 9000.0, 500.0)]  # fmt: skip
    assert (np.diff(depths, axis=0) >= 0.0).all()
    assert (np.diff(depths, axis=1) >= 0.0).all()


@pytest.mark.parametrize("height", [8.0, 15.0])
@pytest.mark.parametrize("below", [25.0, 45.0, 90.0])
@pytest.mark.parametrize("azimuth", [0.0, 200.0])
def test_the_optical_depth_is_that_of_an_exponential_sheet(height, below, azimuth):
    found = sheet(height)
    e, a = np.radians([below, azimuth])
    ray = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])
    depth, scale = (float(v) for v in found.along(state(height).position, ray))
    wanted = optical_depth(found.depth, 5.0, DUST.ejection_angle, np.array([0.0, 0.0, height]), ray)
    assert depth == pytest.approx(wanted, rel=0.12)
    distance = height / np.tan(e)
    assert scale == pytest.approx(np.tan(DUST.ejection_angle) * np.hypot(5.0, distance))


def test_a_thin_sheet_has_the_exact_optical_depth():
    thin = replace(DUST, ejection_angle=np.radians(0.01))
    found = sheet(10.0, dust=thin)
    ray = np.array([0.6, 0.0, -0.8])
    depth = float(found.along(state(10.0).position, ray)[0])
    exact = optical_depth(
        found.depth, 5.0, thin.ejection_angle, np.array([0.0, 0.0, 10.0]), ray, 10**6
    )
    assert depth == pytest.approx(exact, rel=2e-3)


def test_rays_that_do_not_descend_are_clear():
    rays = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    assert (sheet(5.0).along(state(5.0).position, rays)[0] == 0.0).all()


@pytest.mark.parametrize(
    "sensor",
    [
        FlashLidar(32, 32),
        RadarAltimeter(),
        DopplerVelocimeter(),
        Camera.with_field_of_view(64, 48, 30.0),
    ],
)
def test_above_the_onset_nothing_changes(sensor):
    clear, dusty = (sensor.measure(w, state(20.5), 1.0, rng()) for w in (world(None), world()))
    for name, value in vars(clear).items():
        np.testing.assert_array_equal(getattr(dusty, name), value)


def test_lidar_returns_are_lost_or_come_from_the_dust():
    lidar = FlashLidar(200, 200, 0.02)
    clear, dusty = (lidar.measure(w, state(10.0), 1.0, rng()) for w in (world(None), world()))
    n = clear.range.size
    assert np.isfinite(clear.range).all()
    transmission = np.exp(-2.0 * 1.5)  # nearly vertical rays
    low, high = proportion_bounds(transmission, n)
    same = dusty.range == clear.range
    assert low - 2e-3 < same.mean() < high + 2e-3
    false = np.isfinite(dusty.range) & ~same
    low, high = proportion_bounds(0.3 * (1.0 - transmission), n)
    assert low - 2e-3 < false.mean() < high + 2e-3
    above = (clear.range - dusty.range)[false]
    assert (above > 0.0).all()
    # Half of the light that does not return from the terrain returns from above this height.
    half = -0.5 * np.log(1.0 - 0.5 * (1.0 - transmission)) / 1.5
    median = -np.tan(DUST.ejection_angle) * 5.0 * np.log(half)
    low, high = proportion_bounds(0.5, int(false.sum()))
    assert low - 5e-3 < (above < median).mean() < high + 5e-3
    np.testing.assert_allclose(dusty.sigma[false], lidar.stated_sigma(dusty.range)[false])
    assert np.isnan(dusty.sigma[np.isnan(dusty.range)]).all()


def test_radar_and_laser_beams_drop_out():
    dust = replace(DUST, radar_ratio=0.2)
    generator, n = rng(), 3000
    seen = [
        np.isfinite(RadarAltimeter().measure(world(dust), state(10.0), 1.0, generator).range)
        for _ in range(n)
    ]
    low, high = proportion_bounds(np.exp(-2.0 * 0.2 * 1.5), n)
    assert low < np.mean(seen) < high
    meter = DopplerVelocimeter()
    readings = [meter.measure(world(dust), state(10.0), 1.0, generator) for _ in range(n)]
    radius = 10.0 * np.tan(meter.cone)
    depth = 1.5 / np.hypot(1.0, radius / 5.0) / np.cos(meter.cone)
    low, high = proportion_bounds(np.exp(-2.0 * depth), 3 * n)
    assert low < np.mean([np.isfinite(r.speed) for r in readings]) < high
    for r in readings[:50]:
        np.testing.assert_array_equal(np.isfinite(r.speed), np.isfinite(r.range))


def test_the_contrast_of_an_image_falls_with_the_optical_depth():
    relief = Heightfield(
        GRID, (0.3 * np.sin(GRID.x[None, :] / 3.0) + 0.0 * GRID.y[:, None]).astype(np.float32)
    )
    light = Light(1.0, 0.5, photometry="lambert")
    clean = {"shot_noise": False, "read_noise": 0.0, "blur_sigma": 0.0, "bits": 14}
    camera = Camera.with_field_of_view(64, 48, 4.0, **clean)
    found = {}
    for dust in (None, DUST):
        w = World(Terrain(relief), 1.62, light, dust=dust)
        found[dust] = camera.measure(w, state(10.0), 1.0, rng()).counts.astype(float)
    clear, dusty = found[None], found[DUST]
    slope, offset = np.polyfit(clear.ravel(), dusty.ravel(), 1)
    s = DUST.sheet(Terrain(relief), state(10.0).position, UPRIGHT, 4000.0)
    through = np.exp(-s.depth)
    assert slope == pytest.approx(through, abs=0.02)
    # A dense sheet is as bright as horizontal terrain.
    flat = camera.measure(World(FLAT, 1.62, light), state(10.0), 1.0, rng()).counts.mean()
    assert offset == pytest.approx((1.0 - through) * flat, rel=0.05)


def test_a_flight_ends_in_the_dust_and_rejects_scans():
    table = {"onset_height_m": 60.0, "onset_thrust_n": 2000.0}
    tasking = {"flash": {"kind": "periodic", "rate_hz": 2.0, "first_altitude_m": 300.0}}
    scenario = lunarsim.Scenario.from_dict(TINY_FLIGHT).changed(tasking=tasking)
    flights = [
        lunarsim.fly(s, policy="no-divert", seed=3)
        for s in (scenario, scenario.changed(dust=table))
    ]
    assert all(f.outcome.safe for f in flights)
    maps = [f.hazard_map for f in flights]
    claims = [np.sum((m.p_safe > 0.95) & m.in_domain) for m in maps]
    assert claims[1] <= claims[0]
    times = [np.unique(f.scans[:, 3], return_counts=True) for f in flights]
    shared = min(len(t) for t, _ in times)
    more = [(t[:shared], n[:shared]) for t, n in times]
    assert more[0][1][0] == more[1][1][0]
    assert (more[1][1] < more[0][1]).sum() >= 2


@pytest.mark.parametrize(
    ("key", "value"),
    [("onset_height_m", 0.0), ("optical_depth", -1.0), ("radar_ratio", 2.0), ("onset", 1.0)],
)
def test_bad_values_name_their_key(key, value):
    with pytest.raises(InputError, match=f"^dust.*{key}|{key}"):
        lunarsim.Scenario.from_dict(TINY_FLIGHT | {"dust": {key: value}})
