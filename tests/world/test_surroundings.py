"""Ground beyond the map: no step from level to level, the sphere beyond, rays by bisection."""

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.models.gravity import RoundMoon
from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.world import World
from lunarsim.world.far_terrain import FarTerrainSettings
from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief

MOON = RoundMoon().gravity(1.622)
R = MOON.radius


def _map(seed=2, size=400.0):
    grid = Grid.centred((0.0, 0.0), size, 4.0)
    return Terrain(fractal_relief(grid, np.random.default_rng(seed), hurst=0.7, rms_slope=0.15))


def _about(**more):
    given = {"sizes": (8_000.0, 200_000.0), "postings": (40.0, 1_000.0), "rms_slopes": (0.1, 0.05)}
    return FarTerrainSettings(**{**given, **more}).build(_map(), MOON, RandomStreams(5))


@pytest.fixture(scope="module")
def ground():
    return _about()


def _line(ground, reach, n, turn=0.3):
    way = np.linspace(-reach, reach, n)[:, None] * np.array([np.cos(turn), np.sin(turn)])
    return way, ground.elevation(way)


def test_no_step_from_level_to_level(ground):
    for reach in (260.0, 5_000.0, 120_000.0):
        _, coarse = _line(ground, reach, 4_001)
        _, fine = _line(ground, reach, 40_001)
        # A step would stay as large on points ten times closer; a slope's rise shrinks with them.
        rise, least = np.abs(np.diff(fine)).max(), np.abs(np.diff(coarse)).max()
        assert rise < 0.45 * least
    assert np.isfinite(_line(ground, 120_000.0, 4_001)[1]).all()


def test_over_the_map_it_is_the_map(ground):
    west, east, south, north = ground.terrain.bounds
    xy = np.random.default_rng(1).uniform((west, south), (east, north), (200, 2))
    over = ground.elevation(xy) - (xy**2).sum(axis=1) / (2.0 * R)
    assert over == pytest.approx(ground.terrain.elevation(xy), abs=1e-9)


def test_far_off_it_is_the_sphere(ground):
    far = np.array([[150_000.0, 0.0], [0.0, -400_000.0]])
    assert ground.elevation(far) == pytest.approx([0.0, 0.0], abs=1e-12)
    away = np.array([300_000.0, 0.0, np.sqrt(R**2 - 300_000.0**2) - R + 7_000.0])
    height = np.hypot(300_000.0, away[2] + R) - R
    assert ground.clearance(away) == pytest.approx(height, abs=1e-6)
    assert ground.surface_arc(away) == pytest.approx([R * np.arctan2(300_000.0, away[2] + R), 0.0])


def test_levels_are_built_when_they_are_looked_at(monkeypatch):
    import lunarsim.world.far_terrain as module

    made = []
    monkeypatch.setattr(
        module,
        "fractal_relief",
        lambda *a, **k: made.append(k["baseline"]) or fractal_relief(*a, **k),
    )
    ground = _about()
    ground.elevation([[10.0, 20.0], [0.0, 0.0]])
    assert made == []
    ground.elevation([[90_000.0, 0.0]])
    assert made == [1_000.0]
    ground.elevation([[1_000.0, 0.0]])
    ground.elevation([[1_500.0, 0.0]])
    assert made == [1_000.0, 40.0]


def test_rays_meet_the_terrain_where_small_steps_do(ground):
    rng = np.random.default_rng(7)
    for _ in range(12):
        origin = np.array([*rng.uniform(-30_000.0, 30_000.0, 2), rng.uniform(2_000.0, 9_000.0)])
        ray = rng.normal(0.0, 0.5, 3) - np.array([0.0, 0.0, 1.5])
        ray /= np.linalg.norm(ray)
        hit = ground.cast(origin, ray[None, :])
        # Marched in steps of a metre, written out.
        t = np.arange(0.0, 40_000.0, 1.0)
        p = origin + t[:, None] * ray
        aside = np.hypot(p[:, 0], p[:, 1])
        down = np.sqrt(aside**2 + (p[:, 2] + R) ** 2) - R
        arc = R * np.arctan2(aside, p[:, 2] + R)
        z = ground.elevation(p[:, :2] / aside[:, None] * arc[:, None])
        first = np.flatnonzero(down <= z)[0]
        assert t[first - 1] - 30.0 <= hit.range[0] <= t[first] + 1e-6
        assert ground.clearance(origin + hit.range[0] * ray) == pytest.approx(0.0, abs=1e-3)
        assert np.linalg.norm(hit.normal[0]) == pytest.approx(1.0)
        assert hit.normal[0] @ MOON.up(origin) > 0.9


def test_a_level_sphere_reflects_straight_up():
    ground = _about(sizes=(8_000.0,), postings=(40.0,), rms_slopes=(0.0,))
    origin = np.array([200_000.0, 50_000.0, 0.0])
    origin[2] = np.sqrt((R + 9_000.0) ** 2 - origin[0] ** 2 - origin[1] ** 2) - R
    up = MOON.up(origin)
    hit = ground.cast(origin, -up[None, :])
    assert hit.range[0] == pytest.approx(9_000.0, abs=1e-3)
    assert hit.normal[0] == pytest.approx(up, abs=1e-6)
    assert np.isnan(ground.cast(origin, up[None, :]).range[0])
    assert np.isnan(ground.cast(origin, -up[None, :], 8_000.0).range[0])


def test_the_world_casts_onto_the_map_first(ground):
    world = World(ground.terrain, 1.622, moon=MOON, far_terrain=ground)
    down = np.array([[0.0, 0.0, -1.0]])
    over = world.cast([20.0, 30.0, 500.0], down)
    assert over.range == ground.terrain.cast([20.0, 30.0, 500.0], down).range
    beyond = world.cast([5_000.0, 30.0, 500.0], down)
    assert np.isfinite(beyond.range[0])
    assert np.isnan(ground.terrain.cast([5_000.0, 30.0, 500.0], down).range[0])
    assert World(ground.terrain, 1.622).cast([5_000.0, 30.0, 500.0], down).rock[0] == -2


def test_a_raster_is_the_first_level():
    path = "scenarios/data/moon_shackleton_ridge_lola_40m.tif"
    ground = _about(path=__import__("pathlib").Path(path), dtm_posting=40.0)
    from lunarsim.world.terrain.dtm import load_terrain

    raw = load_terrain(path, posting=40.0)
    rows, cols = raw.z.shape
    # 25 posts east and 10 south of its middle, before it fades out.
    post = raw.grid.posting
    way = [(cols // 2 + 25 - 0.5 * (cols - 1)) * post, (rows // 2 - 10 - 0.5 * (rows - 1)) * post]
    rise = raw.z[rows // 2 - 10, cols // 2 + 25] - raw.z[rows // 2, cols // 2]
    flat = _about(sizes=(8_000.0,), postings=(40.0,), rms_slopes=(0.0,))
    both = _about(
        path=ground.settings.path, dtm_posting=40.0, sizes=(8_000.0,), postings=(40.0,),
        rms_slopes=(0.0,),
    )  # fmt: skip
    assert both.elevation([way])[0] - flat.elevation([way])[0] == pytest.approx(rise, abs=0.01)
    assert isinstance(both.level(0), Heightfield)


def test_what_does_not_fit_is_refused():
    with pytest.raises(InputError, match="postings"):
        FarTerrainSettings(postings=(40.0,))
    with pytest.raises(InputError, match=r"far_terrain\.centre_m: places the raster"):
        Scenario.from_dict({"far_terrain": {"centre_m": [1.0, 2.0]}})
