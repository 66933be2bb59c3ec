"""What a mapper of elevations has measured, as pictures are read by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.frames import direction_from_angles
from lunarsim.grid import Grid
from lunarsim.messages.measurements import CameraImage
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.shadows import HazardPrior, ProbabilityMap, ShadowMapper
from lunarsim.onboard.hazards.shadows.terrain_errors import MeasuredTerrain
from lunarsim.onboard.navigation.error_state import UpdateOutcome
from lunarsim.onboard.navigation.inertial import StrapdownState
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.terrain_heights import TerrainPrior
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockModel
from lunarsim.world.terrain import Heightfield, Terrain, place_rocks
from tests.shadow_scene import picture, tracker_at

GRID = Grid.centred((40.0, -30.0), 24.0, 0.5)


class Maps:
    """A mapper of elevations that shows what it is told to."""

    def __init__(self, drawn=None):
        self.drawn = HazardMap.unobserved(GRID) if drawn is None else drawn

    def terrain_surface(self):
        return self.drawn


def measured(elevation, grid=GRID):
    z = np.asarray(elevation, np.float32)
    return replace(HazardMap.unobserved(grid), observed=np.isfinite(z), elevation=z)


def sloping(gradient):
    x, y = np.meshgrid(GRID.x, GRID.y)
    return measured(7.0 + gradient[0] * x + gradient[1] * y)


def plain_mean(z, row, col, cells):
    """Return the mean of known elevations within so many cells of one, one by one."""
    total, count = 0.0, 0
    for i in range(max(row - cells, 0), min(row + cells + 1, z.shape[0])):
        for j in range(max(col - cells, 0), min(col + cells + 1, z.shape[1])):
            if np.isfinite(z[i, j]):
                total, count = total + float(z[i, j]), count + 1
    return total / count


@pytest.mark.parametrize("level", [0.0, -2600.0])
@pytest.mark.parametrize(("posting", "cells"), [(0.25, 4), (0.5, 2), (3.0, 1)])
def test_heights_are_means_of_what_is_known_about_a_point(posting, cells, level):
    rng = np.random.default_rng(4)
    grid = Grid.centred((5.0, 2.0), 30.0 * posting, posting)
    z = (level + rng.normal(0.0, 2.0, grid.shape)).astype(np.float32)
    z[rng.random(grid.shape) < 0.4] = np.nan
    z[3, 4] = np.inf
    xy = rng.uniform(-0.6, 0.6, (300, 2)) * 30.0 * posting + [5.0, 2.0]
    told = MeasuredTerrain(Maps(measured(z, grid))).heights(xy)
    for point, height in zip(xy, told, strict=True):
        row, col = (int(k) for k in grid.cell(point))
        if grid.contains(point) and np.isfinite(z[row, col]):
            assert height == pytest.approx(plain_mean(z, row, col, cells), abs=1e-5)
        else:
            assert np.isnan(height)
    assert np.isfinite(told).any()
    assert np.isnan(told).any()


def test_nothing_is_known_of_points_that_are_none_nor_of_terrain_that_nobody_measured():
    points = np.array([[40.0, -30.0], [np.nan, 0.0], [np.inf, -30.0]])
    assert np.isnan(MeasuredTerrain(None).heights(points)).all()
    assert np.isnan(MeasuredTerrain(Maps()).heights(points)).all()
    assert np.isnan(
        MeasuredTerrain(Maps(measured(np.full(GRID.shape, np.nan)))).heights(points)
    ).all()
    told = MeasuredTerrain(Maps(sloping((0.0, 0.0)))).heights(points)
    np.testing.assert_array_equal(np.isfinite(told), [True, False, False])
    assert MeasuredTerrain(Maps(sloping((0.0, 0.0)))).heights(np.empty((0, 2))).shape == (0,)


def test_plane_and_heights_follow_the_map():
    maps, there = Maps(), np.array([[44.0, -30.0]])
    told = MeasuredTerrain(maps)
    assert told.plane() is None
    maps.drawn = sloping((0.05, 0.0))
    assert told.heights(there)[0] == pytest.approx(7.0 + 0.05 * 44.0, abs=0.03)
    assert told.plane().gradient == pytest.approx((0.05, 0.0), abs=1e-4)
    assert told.plane() is told.plane()
    maps.drawn = sloping((0.0, -0.1))
    assert told.plane().gradient == pytest.approx((0.0, -0.1), abs=1e-4)
    assert told.heights(there)[0] == pytest.approx(10.0, abs=0.05)
    # A map that was laid about another point has seen nothing yet.
    maps.drawn = HazardMap.unobserved(GRID)
    assert told.plane() is None
    assert np.isnan(told.heights(there)).all()
    assert MeasuredTerrain(None).plane() is None


# --- on a terrace -----------------------------------------------------------------------------

PLACE, RISE = (0.0, -60.0, 70.0), 5.0
AZIMUTH, ELEVATION = 3.67, np.radians(20.0)
SUN, MODEL = direction_from_angles(AZIMUTH, ELEVATION), ShadowModel(ELEVATION)


def terrace(size, posting):
    """Return ground that rises by 5 m to a terrace of 24 m, and falls again behind it."""
    grid = Grid.centred((0.0, 0.0), size, posting)
    north = np.broadcast_to(grid.y[:, None], grid.shape)
    share = np.clip((18.0 - abs(north)) / 6.0, 0.0, 1.0)
    return Heightfield(grid, (RISE * share**2 * (3.0 - 2.0 * share)).astype(np.float32))


@pytest.fixture(scope="module")
def terrain():
    rng = np.random.default_rng(3)
    relief = terrace(1500.0, 2.0)
    near = terrace(60.0, 1.0)
    sizes = rng.uniform(0.8, 2.0, 60)
    rocks = place_rocks(near, sizes, rng, model=RockModel("hemisphere", burial=(0.0, 0.0)))
    return Terrain(relief, rocks)


def tracked(terrain, relief):
    """Return rocks begun by one picture and the mapper of it."""
    _, camera, counts = picture(terrain, PLACE, (AZIMUTH, np.degrees(ELEVATION)))
    tracker = tracker_at(PLACE, MODEL)
    grid = Grid.centred((0.0, 0.0), 50.0, 0.5)
    mapper = ShadowMapper(
        tracker,
        ProbabilityMap(grid, MODEL, HazardPrior(0.05, 0.5)),
        SUN,
        1.0,
        terrain_mapper=relief,
    )
    rocks = tracker.filter
    estimate = rocks.inertial.estimate(rocks.covariance, 0.0, 1.0)
    mapper.update(CameraImage(0.0, counts, camera.model), estimate)
    return rocks.xyz, mapper


def places(terrain):
    return np.column_stack((terrain.rocks.x, terrain.rocks.y))


def nearest(xyz, terrain):
    """Return how far rocks stand from the nearest true one, level (n,), m."""
    return np.hypot(*np.moveaxis(xyz[:, None, :2] - places(terrain), -1, 0)).min(1)


def test_rocks_on_a_terrace_stand_where_they_are(terrain):
    """The plane of all of the ground, half way up, puts them metres aside."""
    seen = terrace(60.0, 0.5)
    drawn = measured(seen.z, seen.grid)
    xyz, _ = tracked(terrain, Maps(drawn))
    assert len(xyz) > 15
    assert np.median(nearest(xyz, terrain)) < 0.4
    north = abs(xyz[:, 1])
    for part, height in ((north < 11.0, RISE), (north > 19.0, 0.0)):
        assert part.any()
        assert np.median(xyz[part, 2]) == pytest.approx(height, abs=0.05)


def share_dark(mapper, terrain):
    """Return of how many places in the shadows of rocks the sharpest look was dark."""
    evidence, rocks = mapper.probability.evidence, terrain.rocks
    shadow = places(terrain) - 1.5 * rocks.a[:, None] * SUN[:2] / np.hypot(*SUN[:2])
    shadow = shadow[evidence.grid.contains(shadow) & (abs(shadow[:, 1]) < 11.0)]
    row, col = evidence.grid.cell(shadow)
    lit, dark = evidence.lit[0][row, col], evidence.dark[0][row, col]
    looked = (lit > 0.0) | (dark > 0.0)
    assert looked.sum() > 10
    return float((dark[looked] > lit[looked]).mean())


def test_observations_of_a_terrace_fall_on_its_terrain(terrain):
    seen = terrace(60.0, 0.5)
    drawn = measured(seen.z, seen.grid)
    assert share_dark(tracked(terrain, Maps(drawn))[1], terrain) > 0.8
    # Nobody doubts the height of ground that was measured to be level.
    level = measured(np.zeros(seen.grid.shape), seen.grid)
    assert share_dark(tracked(terrain, Maps(level))[1], terrain) < 0.5


def test_heights_are_uncertain_without_measurements(terrain):
    """Ahead of the rocks that tell it, the height of the ground is anything."""
    seen = terrace(60.0, 0.5)
    z = seen.z.copy()
    z[:, : z.shape[1] // 2] = np.nan
    lit = tracked(terrain, Maps(measured(z, seen.grid)))[1].probability.evidence.lit[0] > 0.0
    whole = tracked(terrain, Maps(measured(seen.z, seen.grid)))[1].probability.evidence.lit[0] > 0.0
    west, east = np.array_split(np.arange(lit.shape[1]), 2)
    np.testing.assert_array_equal(lit[:, east[5:]], whole[:, east[5:]])
    assert lit[:, west].sum() < 0.9 * whole[:, west].sum()


def rocks_on(ground, xy):
    """Return a filter of rocks that stand on ground somebody has measured."""
    inertial = StrapdownState(np.array(PLACE), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1.622)
    rocks = RockFilter.of(inertial, terrain_prior=TerrainPrior(0.0, 2.0))
    rocks.measured_terrain = MeasuredTerrain(Maps(ground))
    n = len(xy)
    rocks.add_known(xy, np.full(n, 0.1), np.full(n, 0.5), np.full(n, 0.01))
    return rocks


def test_rocks_give_the_height_where_nobody_has_measured_it():
    rocks = rocks_on(measured(np.full(GRID.shape, 5.0)), [[42.0, -30.0], [38.0, -28.0]])
    np.testing.assert_allclose(rocks.xyz[:, 2], 5.0)
    at = np.array([[43.0, -29.0], [37.0, -29.0]])
    rocks.measured_terrain = None
    by_rocks = rocks.terrain_height_at(at)
    assert (by_rocks > 4.0).all()
    z = np.full(GRID.shape, 3.0)
    z[:, GRID.x < 40.0] = np.nan
    rocks.measured_terrain = MeasuredTerrain(Maps(measured(z)))
    np.testing.assert_allclose(rocks.terrain_height_at(at), [3.0, by_rocks[1]])


@pytest.mark.parametrize(("count", "laid"), [(4, 0.0), (5, 1.2), (9, 1.2)])
def test_the_shape_of_measured_terrain_is_laid_on_the_rocks(count, laid):
    """As many as tell it; one of them that stands elsewhere does not move the ground."""
    slope = sloping((0.1, 0.0))
    higher = replace(slope, elevation=slope.elevation + np.float32(1.2))
    rng = np.random.default_rng(6)
    places = np.array([40.0, -30.0]) + rng.uniform(-8.0, 8.0, (count - 1, 2))
    rocks = rocks_on(higher, [*places.tolist(), [41.0, -31.0]])
    error = np.zeros(rocks.state.size)
    error[rocks.state_indices(np.array([count - 1]))[0, 2]] = 30.0
    rocks.state.correct(error)
    assert rocks.xyz[-1, 2] == pytest.approx(7.0 + 4.1 + 1.2 + 30.0, abs=0.05)
    rocks.measured_terrain = MeasuredTerrain(Maps(slope))
    at = np.array([[36.0, -34.0], [44.0, -25.0]])
    np.testing.assert_allclose(rocks.terrain_height_at(at), 7.0 + 0.1 * at[:, 0] + laid, atol=0.03)
    # Rocks beyond what was measured do not tell how high that lies.
    far = sloping((0.1, 0.0))
    far.elevation[:, GRID.x < 45.0] = np.nan
    rocks.measured_terrain = MeasuredTerrain(Maps(far))
    np.testing.assert_allclose(rocks.terrain_height_at([[50.0, -25.0]]), 12.0, atol=0.03)


def test_rocks_are_laid_on_terrain_once_each_time_that_it_is_measured(terrain, monkeypatch):
    """The error of one scan is the same however many pictures follow it."""
    calls = []
    plain = RockFilter.correct_heights_by_terrain
    monkeypatch.setattr(
        RockFilter,
        "correct_heights_by_terrain",
        lambda rocks: (calls.append(rocks.count), plain(rocks))[1],
    )
    seen = terrace(60.0, 0.5)
    maps = Maps(measured(seen.z, seen.grid))
    _, mapper = tracked(terrain, maps)
    assert calls == [0]
    _, camera, counts = picture(terrain, PLACE, (AZIMUTH, np.degrees(ELEVATION)))
    rocks = mapper.tracker.filter
    estimate = rocks.inertial.estimate(rocks.covariance, 0.5, 1.0)
    black = np.zeros_like(counts)
    for time in (0.5, 1.0):
        mapper.update(CameraImage(time, black, camera.model), estimate)
    assert calls == [0]
    maps.drawn = measured(seen.z + np.float32(0.1), seen.grid)
    # Even if the picture is none, or none comes.
    mapper.update(CameraImage(1.5, black, camera.model), estimate)
    assert calls == [0, rocks.count] and rocks.count > 15
    maps.drawn = measured(seen.z, seen.grid)
    mapper.refresh(1.6)
    mapper.refresh(1.7)
    assert len(calls) == 3


def test_terrain_that_cannot_be_under_the_rocks_is_reported(terrain, monkeypatch):
    seen = terrace(60.0, 0.5)
    maps = Maps(measured(seen.z, seen.grid))
    _, mapper = tracked(terrain, maps)
    refused = UpdateOutcome(90.0, 4, False)
    monkeypatch.setattr(RockFilter, "correct_heights_by_terrain", lambda _: refused)
    mapper.refresh(2.0)
    assert not mapper.tracker.filter.events
    maps.drawn = measured(seen.z, seen.grid)
    mapper.refresh(2.5)
    (event,) = mapper.tracker.filter.events
    assert (event.name, event.time) == ("measured-terrain-rejected", 2.5)
    assert event.details == {"rocks": 4, "nis": 90.0}
