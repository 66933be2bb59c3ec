"""Terrain horizon: shapes with a known horizon, discs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from lunarsim.errors import InputError
from lunarsim.frames import direction_from_angles
from lunarsim.grid import Grid
from lunarsim.models.gravity import CentralGravity
from lunarsim.rng import RandomStreams
from lunarsim.world.far_terrain import FarTerrainSettings
from lunarsim.world.horizon import Horizon, terrain_horizon
from lunarsim.world.terrain import Heightfield, fractal_relief
from tests.reference import horizon as reference
from tests.worlds import flat_terrain

R = 1_737_400.0
TOLERANCE_DEG = 0.05


def _deg(angles):
    return np.rad2deg(angles)


def test_a_cone_has_a_known_horizon():
    """Seen from the origin, a cone's flanks and summit follow from its height and distance."""
    summit, foot, at = 1_500.0, 4_000.0, np.array([12_000.0, 9_000.0])

    def cone(arc):
        return np.maximum(summit * (1.0 - np.hypot(*(arc - at).T) / foot), 0.0)

    found = terrain_horizon(cone, height=0.0, radius=R, posting=40.0, max_range=30_000.0)
    towards = math.atan2(*at)
    distance = float(np.hypot(*at))
    top = math.degrees(reference.elevation_angle(0.0, distance, summit, R))
    assert _deg(found.elevation_at(towards)) == pytest.approx(top, abs=TOLERANCE_DEG)
    for off in np.deg2rad([-10.0, -5.0, 3.0, 12.0]):
        wanted = reference.dense_horizon(
            lambda x, y: float(cone(np.array([[x, y]]))[0]), towards + off, 0.0, R, 20_000.0, 5.0
        )
        assert _deg(found.elevation_at(towards + off)) == pytest.approx(
            math.degrees(wanted), abs=TOLERANCE_DEG
        )
    behind = found.elevation_at(towards + np.pi)
    assert abs(_deg(behind)) < TOLERANCE_DEG  # a sphere seen from its surface


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, 90.0])
def test_a_ridge_has_a_known_horizon(turn_deg):
    """The crest of a straight ridge lies at d / cos(angle from its normal)."""
    crest, away, width = 800.0, 6_000.0, 500.0
    normal = np.array([math.sin(math.radians(turn_deg)), math.cos(math.radians(turn_deg))])

    def ridge(arc):
        return np.maximum(crest * (1.0 - np.abs(arc @ normal - away) / width), 0.0)

    found = terrain_horizon(ridge, height=2.0, radius=R, posting=40.0, max_range=40_000.0)
    for off_deg in (-60.0, -20.0, 0.0, 45.0):
        distance = away / math.cos(math.radians(off_deg))
        wanted = math.degrees(reference.elevation_angle(2.0, distance, crest, R))
        got = _deg(found.elevation_at(math.radians(turn_deg + off_deg)))
        assert got == pytest.approx(wanted, abs=TOLERANCE_DEG)


def test_curvature_lowers_a_distant_wall():
    """A wall of 1 km, 80 km away, stands above a plane, but below the eye's horizontal plane."""

    def wall(arc):
        return np.where(arc[:, 0] > 80_000.0, 1_000.0, 0.0)

    found = terrain_horizon(wall, height=500.0, radius=R, posting=100.0, max_range=90_000.0)
    east = _deg(found.elevation_at(np.pi / 2))
    plane = math.degrees(math.atan2(500.0, 80_000.0))
    assert east == pytest.approx(plane - math.degrees(80_000.0 / R / 2.0), abs=0.02)
    assert _deg(found.elevation_at(0.0)) < east < 0.0 < plane


def test_heightfields_and_far_terrain_agree_with_small_steps():
    """Random terrain, as heightfields and as the levels of `[far_terrain]`."""
    grid = Grid.centred((0.0, 0.0), 20_000.0, 50.0)
    relief = fractal_relief(grid, np.random.default_rng(4), hurst=0.8, rms_slope=0.2, baseline=50.0)
    coarse = Heightfield(Grid.centred((0.0, 0.0), 60_000.0, 1_000.0), np.zeros((60, 60)))
    found = terrain_horizon(
        [relief, coarse], (300.0, -200.0), height=5.0, radius=R, posting=50.0, max_range=25_000.0
    )
    surface = RegularGridInterpolator((grid.y, grid.x), relief.z.astype(float))

    def height_at(x, y):
        x, y = x + 300.0, y - 200.0
        inside = max(abs(x), abs(y)) < 9_974.0
        return float(surface((y, x))) if inside else 0.0

    base = height_at(0.0, 0.0)
    for azimuth_deg in (10.0, 117.0, 290.0):
        azimuth = math.radians(azimuth_deg)
        wanted = reference.dense_horizon(height_at, azimuth, base + 5.0, R, 12_000.0, 4.0)
        got = _deg(found.elevation_at(azimuth))
        assert got == pytest.approx(math.degrees(wanted), abs=TOLERANCE_DEG)
    assert (found.reach > 24_000.0).all()


def test_a_far_terrain_is_a_height_function():
    """Rays just below the horizon of a `FarTerrain` enter it, and rays above it do not."""
    settings = FarTerrainSettings(sizes=(20_480.0,), postings=(40.0,), rms_slopes=(0.2,))
    moon = CentralGravity(1.622, R, np.zeros(3))
    far = settings.build(flat_terrain(200.0), moon, RandomStreams(3))
    found = terrain_horizon(far.elevation, height=30.0, radius=R, posting=40.0, max_range=9_000.0)
    eye = np.array([0.0, 0.0, 30.0 + float(far.elevation([0.0, 0.0]))])
    for azimuth_deg in (40.0, 200.0, 310.0):
        azimuth = math.radians(azimuth_deg)
        edge = float(found.elevation_at(azimuth))
        for off_deg, enters in ((-TOLERANCE_DEG, True), (TOLERANCE_DEG, False)):
            ray = direction_from_angles(azimuth, edge + math.radians(off_deg))
            along = np.linspace(10.0, 9_000.0, 20_000)[:, None] * ray
            assert (far.clearance(eye + along).min() < 0.0) == enters


def test_unknown_terrain_is_reported():
    """Azimuths without terrain have the horizon of a sphere and no reach."""
    field = Heightfield(Grid.centred((0.0, 0.0), 4_000.0, 100.0), np.zeros((40, 40)))
    field.z[20:, :] = np.nan  # the northern half
    found = terrain_horizon(
        field, (0.0, -300.0), height=10.0, radius=R, posting=100.0, max_range=5_000.0
    )
    assert found.reach[0] == pytest.approx(250.0, abs=51.0)
    assert found.reach[found.reach.size // 2] == pytest.approx(1_650.0, abs=51.0)
    dip = -math.acos(R / (R + 10.0))
    assert found.elevation_at(0.0) == pytest.approx(dip, abs=1e-9)
    with pytest.raises(InputError, match=r"horizon\.position: must be on terrain"):
        terrain_horizon(
            field, (0.0, 1_000.0), height=1.0, radius=R, posting=100.0, max_range=5_000.0
        )


@pytest.mark.parametrize(
    ("name", "value"), [("radius", 0.0), ("posting", -1.0), ("max_range", np.nan), ("height", -1.0)]
)
def test_lengths_are_checked(name, value):
    lengths = {"radius": R, "posting": 10.0, "max_range": 1_000.0, "height": 0.0}
    with pytest.raises(InputError, match=rf"horizon\.{name}"):
        terrain_horizon(lambda arc: np.zeros(len(arc)), **(lengths | {name: value}))


def test_the_visible_fraction_is_the_area_above_the_horizon():
    level = Horizon(np.zeros(360), np.zeros(360))
    diameter = math.radians(0.53)
    for over in (-1.2, -1.0, -0.4, 0.0, 0.7, 1.0, 3.0):
        x = min(max(over, -1.0), 1.0)
        area = (math.acos(-x) + x * math.sqrt(1.0 - x * x)) / math.pi  # circular segment
        found = level.visible_fraction(1.0, 0.5 * over * diameter, diameter)
        assert found == pytest.approx(area, abs=0.01)
    # The left half of the disc is behind a wall that begins at the azimuth of its centre.
    wall = Horizon(np.where(np.arange(3600) < 900, 0.3, -0.3), np.zeros(3600))
    half = wall.visible_fraction(np.deg2rad(89.95), 0.0, diameter)
    assert half == pytest.approx(0.5, abs=0.1)
