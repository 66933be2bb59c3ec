"""Test the Gaussian DEM mapper: updates, settings and tilt correction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.domain import CalibrationDomain
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from lunarsim.onboard.calibration.scenario_calibration import (
    ScenarioCalibration,
    lander_safety_params,
)
from lunarsim.onboard.calibration.stage import CalibrationStage
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper, gaussian_dem
from lunarsim.onboard.hazards.gaussian_dem.samples import SamplePool
from lunarsim.onboard.hazards.map_tilt_correction import UnleveledScans
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper
from lunarsim.onboard.navigation import Estimate
from lunarsim.rocks.population import RockExpectation
from lunarsim.sensors.lidar import FlashLidar

GRID = Grid.centred((0.0, 0.0), 8.0, 0.5)
LIDAR = FlashLidar(rows=32, cols=32)
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def flash(
    mapper: GaussianDemMapper, east: float = 0.0, tilt_sigma: float = 1.0, up: float = 0.0
) -> None:
    """Scan flat terrain vertically from 50 m; the estimated height is too high by `up`, m."""
    down = LIDAR.directions()
    mount = np.diag([1.0, -1.0, -1.0])
    scan = LidarScan(0.0, 50.0 / down[:, 2], down, mount, np.full(len(down), 0.01), (32, 32))
    here = np.array([east, 0.0, 50.0 + up])
    own = np.diag([1.0] * 6 + [tilt_sigma**2] * 3)
    mapper.update(scan, Estimate(0.0, here, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, own))


def test_a_map_is_drawn_once_an_interval():
    mapper = GaussianDemMapper(GRID, Lander(), interval=1.0)
    flash(mapper)
    first = mapper.hazard_map()
    assert first.elevation is not None
    mapper.refresh(0.9)
    flash(mapper)
    assert mapper.hazard_map() is first, "not yet due"
    mapper.refresh(1.0)
    second = mapper.hazard_map()
    assert second is not first
    mapper.refresh(5.0)
    assert mapper.hazard_map() is second, "nothing new"


def test_without_a_time_a_map_is_drawn_at_every_measurement():
    mapper = GaussianDemMapper(GRID, Lander(), interval=1.0)
    known = []
    for east in (3.0, -3.0):
        flash(mapper, east)
        known.append(int(np.isfinite(mapper.hazard_map().elevation).sum()))
    assert known[1] > known[0] > 0
    mapper.refresh(0.5)
    before = mapper.hazard_map()
    flash(mapper)
    assert mapper.hazard_map() is before


def test_a_map_that_is_laid_elsewhere_is_due_at_once():
    mapper = GaussianDemMapper(GRID, Lander(), interval=10.0)
    mapper.refresh(0.0)
    flash(mapper)
    assert mapper.hazard_map().observed.shape == GRID.shape
    mapper.recentre(np.array([1.25, 0.0, 0.0]))
    assert mapper.hazard_map().grid == mapper.grid != GRID
    mapper.recentre(np.array([20.0, 0.0, 0.0]))
    assert not np.isfinite(mapper.hazard_map().elevation_at(np.array([20.0, 0.0])))
    flash(mapper, east=20.0)
    assert mapper.hazard_map().elevation_at(np.array([20.0, 0.0])) == pytest.approx(0.0, abs=0.05)


def test_a_map_that_is_laid_off_all_samples_is_blank_again():
    mapper = GaussianDemMapper(GRID, Lander())
    flash(mapper)
    assert mapper.hazard_map().observed.any()
    assert mapper.evidence() is not None
    mapper.recentre(np.array([100.0, 0.0, 0.0]))
    assert mapper.is_empty
    assert mapper.evidence() is None
    for drawn in (mapper.hazard_map(), mapper.terrain_surface()):
        assert drawn.grid == mapper.grid != GRID
        assert not drawn.observed.any()


def test_it_publishes_what_its_map_follows_from():
    refit = ScenarioCalibration(
        CalibrationStage(-3.0), CalibrationStage(-3.0),
        CalibrationDomain(10.0, 10.0, (0.0, 0.5), (0.01, 1.0)),
        lander_safety_params(Lander()), GAUSSIAN_DEM.packaged.digest,
    )  # fmt: skip
    mapper = GaussianDemMapper(GRID, Lander(), refit=refit)
    flash(mapper)
    told = mapper.evidence()
    assert told.scenario_calibration is refit
    assert np.array_equal(
        told.residual_heights, mapper.dem().sampling.residual_raster, equal_nan=True
    )
    assert told.surface is mapper.terrain_surface()
    assert told.hazard_map is mapper.hazard_map()
    p, known = calibrated_safety(told.site_evidence, refit=refit)
    assert np.array_equal(told.hazard_map.p_safe, p)
    assert np.array_equal(told.hazard_map.in_domain, known)
    # Earlier evidence is not modified.
    flash(mapper, east=1.0)
    assert mapper.hazard_map() is not told.hazard_map
    assert told.hazard_map.elevation is told.surface.elevation


def test_samples_stay_where_they_are_when_the_map_is_laid_again():
    mapper = GaussianDemMapper(GRID, Lander())
    flash(mapper, east=3.0)
    before = {tuple(np.round(p, 6)) for p in mapper.pool.vertices()[0]}
    mapper.recentre(np.array([0.3, 0.0, 0.0]))
    assert mapper.grid == GRID, "not worth it"
    side = GRID.cols * GRID.posting
    mapper.recentre(np.array([0.3 * side, -0.2 * side, 0.0]))
    after = {tuple(np.round(p, 6)) for p in mapper.pool.vertices()[0]}
    assert after <= before
    west, _, _, north = mapper.grid.extent
    gone = np.array(sorted(before - after)).reshape(-1, 3)
    assert ((gone[:, 0] < west) | (gone[:, 1] > north)).all()
    assert len(after) > 50


@pytest.mark.parametrize("safety", ["calibrated", "level", "planes"])
@pytest.mark.parametrize("beside", [0.1, 100.0])
def test_a_map_whose_returns_all_fell_beside_it_has_seen_nothing(beside, safety):
    mapper = GaussianDemMapper(GRID, Lander(), safety=safety)
    # The nearest row of returns lies on the outer half of the edge cells, or far off.
    down = LIDAR.directions()
    east = GRID.extent[1] + beside - 50.0 * (down[:, 0] / down[:, 2]).min()
    flash(mapper, east, tilt_sigma=np.deg2rad(1.0))
    assert not mapper.hazard_map().observed.any()
    mapper.correct_tilt(np.eye(3), np.zeros(3), np.deg2rad(1.0))
    after = mapper.hazard_map()
    assert not after.observed.any()
    assert (after.p_safe == 0.0).all()
    assert len(mapper.pool.vertices()[0]) == 0
    assert mapper.is_empty == (beside > 1.0)


@pytest.mark.parametrize("interval", [-1.0, np.nan, np.inf])
def test_impossible_intervals_are_refused(interval):
    with pytest.raises(InputError, match="interval"):
        GaussianDemMapper(GRID, Lander(), interval=interval)


@pytest.mark.parametrize("make", [GaussianDemMapper, QuadtreeMapper])
def test_what_is_no_expectation_of_rocks_is_refused(make):
    with pytest.raises(InputError, match=r"RockExpectation.* got 'many'"):
        make(GRID, lander=Lander(), rocks="many")
    for cover in (np.nan, 0.0, -1.0, 0.5):
        with pytest.raises(InputError, match=r"rocks\.cover: .*0\.2"):
            RockExpectation(cover=cover)


def test_a_lander_larger_than_any_map_is_refused_before_it_is_drawn():
    with pytest.raises(InputError, match="leg_radius"):
        GaussianDemMapper(GRID, replace(Lander(), leg_radius=1e4))


@pytest.mark.parametrize(
    "safety", ["typo", "", None, "Calibrated", ["calibrated"], np.array("level")]
)
def test_a_safety_that_there_is_not_is_refused(safety):
    with pytest.raises(InputError, match="'calibrated', 'level' or 'planes'"):
        GaussianDemMapper(GRID, Lander(), safety=safety)


def seen(mapper: GaussianDemMapper, ground, tilt: float, sigma: float, wrong: float) -> None:
    """Scan terrain of heights (east, north) from 30 m; the estimate has a tilt error."""
    nadir = LIDAR.directions()
    mount = np.diag([1.0, -1.0, -1.0])
    rays = nadir @ mount.T
    reach = np.full(len(rays), 30.0)
    for _ in range(30):
        at = reach[:, None] * rays + [0.0, 0.0, 30.0]
        reach = (30.0 - ground(at[:, 0], at[:, 1])) / -rays[:, 2]
    scan = LidarScan(0.0, reach, nadir, mount, np.full(len(rays), 0.01), (32, 32))
    # The pose is above the pivot, the origin: the rotation about it corrects the pose.
    here = np.array([30.0 * np.sin(wrong), 0.0, 30.0 * np.cos(wrong)])
    attitude = quat_from_rotation_vector([0.0, wrong, 0.0])
    own = np.diag([1.0] * 6 + [sigma**2] * 3)
    mapper.update(scan, Estimate(0.0, here, np.zeros(3), attitude, np.zeros(3), 1.0, own))


@pytest.mark.parametrize("tilt", [0.5, 1.5])
@pytest.mark.parametrize("aside", [False, True])
def test_terrain_seen_with_a_wrong_tilt_is_turned_and_what_came_later_stays(tilt, aside):
    def ground(east, north):
        return 0.15 * np.sin(1.3 * east) * np.cos(0.9 * north)

    wrong, doubtful, sure = np.deg2rad(tilt), np.deg2rad(1.0), np.deg2rad(0.01)
    turn = quat_to_matrix(quat_from_rotation_vector([0.0, -wrong, 0.0]))
    fine = Grid.centred((0.0, 0.0), 6.0, 0.2)
    mapper, right = (GaussianDemMapper(fine, Lander()) for _ in range(2))
    seen(mapper, ground, tilt, doubtful, wrong)
    seen(mapper, ground, tilt, sure, 0.0)
    seen(right, ground, tilt, sure, 0.0)
    if aside:
        for one in (mapper, right):
            one.recentre(np.array([0.5, 0.0, 0.0]))
    expected = right.dem().mean
    drawn = mapper.hazard_map()
    off = np.abs(drawn.elevation - expected)
    assert np.nanmax(off) > 0.2 * wrong
    mapper.correct_tilt(turn, np.zeros(3), sure)
    assert mapper.hazard_map() is not drawn
    off = np.abs(mapper.dem().mean - expected)
    assert np.nanmedian(off) < 0.003
    assert np.nanquantile(off, 0.99) < 0.02
    # Only samples that moved over the edge of the map are lost: each ray was used twice.
    ratio = mapper.pool.centroid[..., 0].sum() / right.pool.centroid[..., 0].sum()
    assert 1.9 < ratio < 2.05
    # The tilt is then known: another rotation moves neither earlier nor later samples.
    before = mapper.pool.centroid.copy()
    mapper.correct_tilt(turn, np.zeros(3), sure)
    assert np.array_equal(mapper.pool.centroid, before)
    seen(mapper, ground, tilt, doubtful, 0.0)
    before = mapper.pool.centroid.copy()
    mapper.correct_tilt(turn, np.zeros(3), sure)
    assert np.array_equal(mapper.pool.centroid, before)
    assert mapper.hazard_map().elevation is not None


def test_a_turn_by_nothing_leaves_samples_as_they_were():
    pool = SamplePool(GRID)
    rng = np.random.default_rng(1)
    points = np.column_stack((rng.uniform(-3.5, 3.5, (150, 2)), rng.normal(2.0, 0.2, 150)))
    pool.add(points, 0.02, rng.uniform(0.1, 0.6, 150))
    same = pool.rotated(np.eye(3), np.array([1.0, -2.0, 3.0]))
    assert same.base == pool.base
    assert np.array_equal(same.spacing, pool.spacing)
    assert same.centroid == pytest.approx(pool.centroid, abs=1e-6)
    assert same.splat == pytest.approx(pool.splat, abs=1e-6)
    # Merged cells are measured as well as the better of them.
    eighth = quat_to_matrix(quat_from_rotation_vector([0.0, 0.0, 0.25 * np.pi]))
    assert pool.rotated(eighth, np.zeros(3)).splat[..., 0].max() <= pool.splat[..., 0].max()


def test_corners_hit_by_two_pools_are_measured_no_better_than_by_the_better_of_them():
    # A return on the corner of four cells gives each a quarter of its weight, which is too little.
    one, other = SamplePool(GRID), SamplePool(GRID)
    x, y = GRID.centres()[4, 4] + 0.5 * GRID.posting
    near = np.array([[x, y, 0.0], [x + 1.5, y, 0.1], [x, y + 1.5, 0.2]])
    one.add(near, 0.01, 0.5)
    other.add(near + [0.0, 0.0, 0.01], 0.01, 0.5)
    both = one.union(other)
    assert both.splat[4, 4] == pytest.approx([0.25, 5000.0, both.splat[4, 4, 2], 1250.0])
    # Twice in one call gives half, which is just too little.
    one.add(np.repeat(near, 2, axis=0), 0.01, 0.5)
    assert one.splat[4, 4, 0] == pytest.approx(0.5)
    assert one.rotated(np.eye(3), np.zeros(3)).splat[4, 4, 0] == pytest.approx(0.5)


def test_masked_samples_are_none():
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (200, 3))
    mask = np.zeros(points.shape, bool)
    mask[:150] = True
    pool, plain = SamplePool(GRID), SamplePool(GRID)
    assert pool.add(np.ma.masked_array(points, mask), 0.01, 0.1) == 50
    plain.add(points[150:], 0.01, 0.1)
    assert np.array_equal(pool.centroid, plain.centroid)
    with pytest.raises(InputError, match="sigma"):
        pool.add(points, np.ma.masked_array(np.full(200, 0.01), mask[:, 0]), 0.1)
    with pytest.raises(InputError, match="points"):
        pool.add(points + 1j, 0.01, 0.1)
    everything = np.ma.masked_array(points, np.ones(points.shape, bool))
    assert not gaussian_dem(everything, GRID).observed.any()


@pytest.mark.parametrize(
    ("turn", "pivot", "field"),
    [
        (np.full((3, 3), np.nan), np.zeros(3), "turn"),
        (5.0 * np.eye(3), np.zeros(3), "turn"),
        (np.eye(3), np.array([0.0, 0.0, np.nan]), "pivot"),
    ],
)
def test_what_is_no_turn_is_refused(turn, pivot, field):
    with pytest.raises(InputError, match=field):
        SamplePool(GRID).rotated(turn, pivot)


def test_a_tilt_that_nobody_knows_is_not_taken_for_known():
    early = UnleveledScans()
    assert early.includes(np.nan)
    assert not early.is_tilt_known(np.nan)
    assert early.includes(1.0)
    assert not early.includes(0.0)
    assert not early.includes(1.0)


def test_scans_of_another_height_are_laid_on_each_other():
    mapper = GaussianDemMapper(GRID, Lander())
    for east, up in ((0.0, 0.0), (0.11, 0.3), (0.23, -0.2)):
        flash(mapper, east=east, up=up)
    drawn = mapper.hazard_map()
    seen = drawn.elevation[drawn.observed]
    assert seen == pytest.approx(-0.2, abs=1e-6)
    assert len(seen) > 20


def test_scans_of_the_same_height_leave_each_other_as_they_are():
    apart, both = GaussianDemMapper(GRID, Lander()), SamplePool(GRID)
    for east in (0.0, 0.11):
        flash(apart, east=east, up=0.004)
        flash(one := GaussianDemMapper(GRID, Lander()), east=east, up=0.004)
        both = both.union(one.pool)
    assert np.allclose(apart.pool.centroid, both.centroid, atol=1e-6)
    assert apart.pool.base == pytest.approx(both.base)


@pytest.mark.parametrize("early", [True, False])
def test_samples_of_a_tilt_that_is_not_known_are_raised_too(early):
    mapper = GaussianDemMapper(GRID, Lander())
    flash(mapper, tilt_sigma=1.0 if early else 1e-6)
    flash(mapper, east=0.11, tilt_sigma=1e-6, up=0.5)
    offset = mapper.pool.offset(np.array([[0.1 * k, 0.2, 0.5] for k in range(-30, 30)]))
    assert np.all(offset.shift == 0.0)
    assert offset.height_sigma < 1e-6


def test_the_height_offset_is_the_median_over_cells_that_have_samples():
    rng = np.random.default_rng(2)
    pool = SamplePool(GRID)
    assert pool.offset(rng.normal(size=(99, 3))) is None
    xy = rng.uniform(-3.5, 3.5, (4000, 2))
    pool.add(np.column_stack((xy, np.zeros(4000))), 0.01, 0.3)
    z = rng.normal(0.25, 0.02, 300)
    z[:60] += 3.0
    points = np.column_stack((rng.uniform(-3.5, 3.5, (300, 2)), z))
    offset = pool.offset(np.vstack((points, [[np.nan, 0.0, 0.0], [90.0, 0.0, 0.0]])))
    assert offset.shift == pytest.approx([0.0, 0.0, np.median(z)])
    assert offset.height_sigma == pytest.approx(1.2533 * 0.02 / np.sqrt(300), rel=0.7)
    assert pool.offset(points[:20]) is None
    moved = pool.shifted(np.array([0.3, -0.1, 0.2])).offset(points + [0.3, -0.1, 0.0])
    assert moved.shift == pytest.approx(offset.shift - [0.0, 0.0, 0.2])
