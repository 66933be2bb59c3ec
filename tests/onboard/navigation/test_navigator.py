"""Test LiDAR navigation on a map: lock, loss, consistency and wrong maps."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from lunarsim.evaluation.consistency import Consistency, normalised_squared_error
from lunarsim.frames import (
    quat_conjugate,
    quat_from_rotation_vector,
    quat_rotate,
)
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation import map_matcher
from lunarsim.onboard.navigation.error_state import MAP, REFERENCE_POSE, UpdateOutcome
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.navigator import Navigator
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.world import World
from lunarsim.world.terrain import Heightfield, Terrain, hazard_field
from tests.chance import CHANCE, ratio_bounds, sample_sizes
from tests.lidar_descent import KEEP, LIDAR, START, VELOCITY, Descent, mapped, names


@pytest.fixture(scope="module")
def world():
    return World(hazard_field(np.random.default_rng(4), surround=280.0, posting=0.5), 9.81)


@pytest.fixture(scope="module")
def flown(world):
    """A descent of 3 s."""
    return Descent(world, 1).fly(3.0)


@pytest.fixture
def locked(world, flown):
    """A copy of a descent of 3 s, which has found its map."""
    descent = copy.deepcopy(flown, {id(world): world})
    assert descent.filter.locked
    return descent


@pytest.mark.statistical
@sample_sizes(4, 14)
def test_filter_is_consistent_after_lock(world, count):
    nees, errors = Consistency(), []
    for seed in range(count):
        descent = Descent(world, seed).fly(6.0)
        assert names(descent) in (["lock"], [])
        # A lock bounds the position error: velocity errors no longer accumulate.
        assert descent.filter.is_drifting == (not descent.filter.locked)
        if descent.filter.locked:
            nees = nees.plus(descent.nees(), 6)
            errors.append(descent.error())
    # A lander that starts three sigma off sweeps flat terrain beside the field.
    assert len(errors) >= 0.85 * count
    # Repeated uses of a post count less than they could: the filter may be conservative only.
    assert 1.0 / 6.0 < nees.ratio < ratio_bounds(nees.degrees)[1]
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms[:3] < 0.3).all()
    assert (np.rad2deg(rms[3:]) < 0.1).all()


@pytest.mark.statistical
@sample_sizes(4, 12)
def test_filter_is_consistent_before_lock(world, count):
    nees = Consistency()
    for seed in range(count):
        # Flat terrain far from the field: no match is possible.
        descent = Descent(world, seed).fly(2.0, aim=np.array([0.0, 105.0, 0.0]))
        assert names(descent) == []
        nees = nees.plus(descent.nees(), 6)
    assert nees.ratio < ratio_bounds(nees.degrees)[1]


def test_map_level_is_used_once(world):
    """Every search gives the same result with the same error."""
    descent = Descent(world, 3).fly(5.0, aim=np.array([0.0, 105.0, 0.0]))
    assert names(descent) == []
    known = np.sqrt(descent.estimate().covariance[2, 2])
    assert 0.5 < known < 1.0


def test_tracked_rocks_bound_the_position_error(world):
    f = Navigator(Descent(world, 8).inertial, StartSigmas(), rocks=True)
    assert f.is_drifting
    f.rocks.add_known(np.array([[5.0, 2.0]]), np.array([0.3]), np.array([0.5]), np.array([0.01]))
    assert not f.is_drifting
    f.rocks.remove(np.array([0]))
    assert f.is_drifting


def test_rocks_hang_on_the_terrain_of_the_first_scan_with_the_lander(world):
    descent = Descent(world, 8)
    f = descent.filter = Navigator(descent.inertial, StartSigmas(5.0, 0.1, 0.01), rocks=True)
    f.rocks.add_known(np.array([[3.0, 4.0], [-20.0, 9.0]]), np.full(2, 0.2), np.ones(2), np.ones(2))
    before, sigma = f.rocks.relative_covariance(), f.covariance.diagonal()[:3].copy()
    f.take("flash", descent.scan(np.zeros(3)), 0.0)
    assert (np.abs(f.covariance.diagonal()[:3] - sigma) > 0.1).any(), "its anchor has changed"
    np.testing.assert_allclose(f.rocks.relative_covariance(), before, atol=1e-9)


def test_an_estimate_reports_tilts_about_the_axes_of_the_frame():
    # An error about body x only, which points north.
    north = quat_from_rotation_vector([0.0, 0.0, np.pi / 2])
    f = Navigator(StrapdownState(START, VELOCITY, north, 9.81), StartSigmas())
    f.state.add_process_noise([9], [[0.04]])
    turned = f.estimate(0.0, 1.0).covariance[6:, 6:]
    assert np.argmax(turned.diagonal()) == 1
    assert turned[1, 1] == pytest.approx(0.04, rel=0.05)


def test_wrong_shadow_direction_loses_navigation(world):
    f = Navigator(Descent(world, 8).inertial, StartSigmas(), rocks=True)
    for k in range(60):
        assert f.lost == f.rocks.image_monitor.lost
        f.rocks.monitor_image("shadows", 0.1 * k, UpdateOutcome(900.0, 1, False))
    assert f.lost


def test_an_azimuth_that_is_corrected_turns_no_terrain(world):
    descent = Descent(world, 8)
    f = descent.filter
    f.take("flash", descent.scan(np.zeros(3)), 0.0)
    up = np.zeros(f.state.size)
    up[9:12] = quat_rotate(quat_conjugate(f.inertial.attitude), [0.0, 0.0, 1e-2])
    f.state.correct(up)
    assert f.map_rotation.rotation == pytest.approx(np.eye(3), abs=1e-12)
    tilt = np.zeros(f.state.size)
    tilt[9] = 1e-2
    f.state.correct(tilt)
    assert np.abs(f.map_rotation.rotation - np.eye(3)).max() > 0.009


@pytest.mark.statistical
@sample_sizes(4, 12)
def test_odometry_slows_the_drift(world, count):
    grown = {}
    inflated = 0
    nees = Consistency()
    for scans in (True, False):
        gaps = []
        for seed in range(count):
            errors = StartSigmas(0.2, 0.3, np.deg2rad(0.02))
            nowhere = PriorMap(Grid(1e5, 1e5, 1.0, 4, 4), np.zeros((4, 4)), 0.1)
            descent = Descent(world, seed, nowhere, errors)
            first = descent.error()
            descent.fly(4.0, aim=np.zeros(3), scans=scans)
            gaps.append(np.linalg.norm((descent.error() - first)[:3]))
            if not scans:
                assert names(descent) == []
            else:
                assert {(e.name, e.details["measurement"]) for e in descent.filter.events} <= {
                    ("covariance-inflated", "scans")
                }
                inflated += len(descent.filter.events)
                found = descent.estimate()
                off, velocity_covariance = VELOCITY - found.velocity, found.covariance[3:6, 3:6]
                nees = nees.plus(normalised_squared_error(off, velocity_covariance), 3)
        grown[scans] = np.sqrt(np.mean(np.square(gaps)))
    # The first comparisons use the same scan and share its error: in 3 of 420 flights of other
    # draws the monitor inflated the covariance. The bound holds at 1 % of the flights.
    assert inflated <= binom.ppf(1.0 - CHANCE, count, 0.01)
    assert grown[True] < 0.5 * grown[False]
    assert nees.ratio < ratio_bounds(nees.degrees)[1]


@pytest.mark.statistical
@pytest.mark.parametrize("relief", [0.0, 0.005])
def test_flat_terrain_gives_no_motion_information(relief):
    """On flat terrain all slopes are noise, which once counted as information.

    Velocities were off by 19 deviations then.
    """
    grid = Grid.centred((0.0, 0.0), 300.0, 1.0)
    x, y = np.meshgrid(grid.x, grid.y)
    waves = World(Terrain(Heightfield(grid, 2.0 * relief * np.sin(x / 2) * np.cos(y / 2))), 9.81)
    nowhere = PriorMap(Grid(1e5, 1e5, 1.0, 4, 4), np.zeros((4, 4)), 0.1)
    nees = Consistency()
    for seed in range(4):
        errors = StartSigmas(30.0, 0.3, np.deg2rad(0.5))
        descent = Descent(waves, seed, nowhere, errors).fly(4.0, aim=np.zeros(3))
        found = descent.estimate()
        off, velocity_covariance = VELOCITY - found.velocity, found.covariance[3:6, 3:6]
        assert (np.abs(off) < 4.5 * np.sqrt(velocity_covariance.diagonal())).all()
        nees = nees.plus(normalised_squared_error(off, velocity_covariance), 3)
    # On very flat terrain, errors are up to twice the estimated ones.
    assert nees.ratio < ratio_bounds(nees.degrees, 2.0**2 if relief == 0.0 else 1.0)[1]


def test_odometry_does_not_change_unobservable_errors(world):
    """A range bias is hardly visible in a comparison of two scans.

    Each of some hundred comparisons once moved the bias by a dozen deviations of what it told.
    """
    moved = []
    for seed in range(4):
        errors = StartSigmas(30.0, 0.1, np.deg2rad(0.5))
        nowhere = PriorMap(Grid(1e5, 1e5, 1.0, 4, 4), np.zeros((4, 4)), 0.1)
        descent = Descent(world, seed, nowhere, errors).fly(5.0)
        state = descent.filter.state
        block = state.block("lidar flash")
        sigma = np.sqrt(state.covariance.diagonal()[block])
        moved.append(state.value("lidar flash") / sigma)
        information_variance = max(0.1**2 - sigma[0] ** 2, 0.0)
        assert abs(state.value("lidar flash")[0]) < 4.0 * np.sqrt(information_variance) + 0.01
    assert np.abs(moved).max() < 4.0


@pytest.mark.parametrize("step", [(0.04, 0.0), (-0.03, 0.05)])
def test_reference_scan_follows_corrections(step):
    """Many small corrections of both leave the next scan as it would have been.

    Carried on by its slopes alone the scan kept would not fit curved ground any more; what is left
    then moved the lander, which made it larger (12 deviations in one of 50 descents).
    """
    grid = Grid.centred((0.0, 0.0), 120.0, 0.25)
    x, y = np.meshgrid(grid.x, grid.y)
    waves = World(Terrain(Heightfield(grid, 0.25 * np.sin(1.5 * x) * np.cos(1.2 * y))), 9.81)
    errors = StartSigmas(0.5, 0.3, np.deg2rad(0.02))
    descent = Descent(waves, 2, errors=errors)
    f = descent.filter = Navigator(
        descent.inertial, errors, instruments={"flash": LIDAR.calibration()}
    )
    descent.fly(0.6, aim=np.zeros(3))
    for _ in range(25):
        error = np.zeros(f.state.size)
        error[:2] = error[f.state.block(REFERENCE_POSE).start :][:2] = step
        f.state.correct(error)
    taken = f.monitors["flash scans"].dof
    descent.fly(0.1, aim=np.append(25.0 * np.array(step), 0.0))
    assert f.monitors["flash scans"].dof > taken


def test_lost_and_found_again_are_events(locked):
    descent = locked
    hidden = descent.filter.matcher.prior
    # The terrain is another one for a while.
    wrong = np.random.default_rng(0).normal(0.0, 3.0, hidden.elevation.shape)
    descent.filter.matcher.prior = PriorMap(hidden.grid, hidden.elevation + wrong, hidden.sigma)
    descent.fly(3.0)
    assert names(descent) == ["lock", "lock-lost"]
    assert not descent.filter.locked
    descent.filter.matcher.prior = hidden
    descent.fly(2.0)
    assert names(descent) == ["lock", "lock-lost", "relock"]
    assert np.linalg.norm(descent.error()[:3]) < 1.0


def test_small_scans_do_not_end_lock(locked):
    descent = locked
    # One metre wide: too small for evidence for or against the lock.
    descent.lidar = FlashLidar(24, 24, 0.003, 5e-5).build(descent.rng, 0.01)
    descent.fly(5.0, aim=np.zeros(3))
    assert names(descent) == ["lock"]
    assert descent.filter.locked
    assert descent.nees() < 40.0


def measure_height_information(descent, scans):
    """Return the height information of repeated scans from one position, 1/m^2."""
    state, place, height_information = descent.filter.state, descent.filter.frame.columns[2], []
    update_with_information = state.update_with_information

    def noted(part, information, *args, **options):
        if place in part:
            at = list(part).index(place)
            height_information.append(information[at, at])
        return update_with_information(part, information, *args, **options)

    state.update_with_information = noted
    for _ in range(scans):
        descent.filter.take("flash", descent.scan(np.zeros(3)), descent.time)
    assert len(height_information) == scans
    return np.array(height_information)


def test_a_post_counts_once_however_often_it_is_seen(locked):
    """The k-th use has the weight 1 / (k (k + 1))."""
    height_information = measure_height_information(locked, 4)
    use = np.arange(1.0, 5.0)
    expected = 1.0 / (0.1**2 * use * (use + 1.0) + 0.03**2)
    assert height_information / height_information[0] == pytest.approx(
        expected / expected[0], rel=0.25
    )


def test_model_noise_reduces_information(world, locked, monkeypatch):
    height_information = []
    for sigma in (0.03, 1.0):
        descent = copy.deepcopy(locked, {id(world): world})
        matcher = descent.filter.matcher
        monkeypatch.setattr(map_matcher, "MODEL_SIGMA_M", sigma)
        matcher.prior = matcher.prior
        height_information.append(measure_height_information(descent, 1)[0])
    # A first use: twice the variance of posts, and that of a scan's mean.
    expected = (2.0 * 0.1**2 + 1.0) / (2.0 * 0.1**2 + 0.03**2)
    assert height_information[0] / height_information[1] == pytest.approx(expected, rel=0.2)


@sample_sizes(3, 6)
@pytest.mark.parametrize(("share", "least"), [(0.05, 5 / 6), (0.2, 2 / 6)])
def test_patches_out_of_date_do_not_mislead(world, share, least, count):
    errors = []
    for seed in range(count):
        rng = np.random.default_rng(100 + seed)
        descent = Descent(world, seed, mapped(world, rng, outdated_fraction=share)).fly(7.0)
        if descent.filter.locked:
            errors.append(np.abs(descent.error()[:3]).max())
    # No match is better than a wrong one.
    assert len(errors) >= least * count
    assert np.median(errors) < 0.4
    assert max(errors) < 1.0


def test_a_map_wrong_by_100_m_gives_no_lock(world):
    rng = np.random.default_rng(5)
    right = mapped(world, rng)
    g = right.grid
    for shift in ((100.0, 0.0, 0.0), (0.0, 0.0, 100.0)):
        grid = Grid(g.x0 + shift[0], g.y0, g.posting, g.rows, g.cols)
        prior = PriorMap(grid, right.elevation + shift[2], 0.1)
        descent = Descent(world, 1, prior, StartSigmas(5.0, 0.1, np.deg2rad(0.3)))
        first = descent.error()
        descent.fly(4.0)
        assert names(descent) == []
        # The estimate has moved by no more than its drift.
        assert np.linalg.norm((descent.error() - first)[:3]) < 6.0


def test_a_map_that_does_not_cover_the_terrain_gives_no_lock(world):
    prior = PriorMap(Grid(400.0, 400.0, 0.5, 100, 100), np.zeros((100, 100)), 0.1)
    descent = Descent(world, 1, prior).fly(2.0)
    assert names(descent) == []
    assert np.isfinite(descent.filter.covariance).all()


def test_empty_scans_change_nothing(world):
    descent = Descent(world, 2).fly(1.0)
    before = descent.filter.covariance.copy(), descent.inertial.position.copy()
    n = 128 * 128
    for scan in (
        LidarScan(0.0, np.full(n, np.nan), LIDAR.directions(), np.eye(3), np.ones(n),
                  (128, 128)),
        LidarScan(0.0, np.zeros(0), np.zeros((0, 3)), np.eye(3), np.zeros(0), (0, 0)),
        LidarScan(0.0, np.full(n, 1e9), LIDAR.directions(), np.eye(3), np.ones(n), (128, 128)),
    ):  # fmt: skip
        descent.filter.take("flash", scan, descent.time)
    assert np.array_equal(descent.filter.covariance, before[0])
    assert np.array_equal(descent.inertial.position, before[1])


def test_the_same_seed_gives_the_same_bits(world):
    a, b = (Descent(world, 6).fly(2.0) for _ in range(2))
    assert np.array_equal(a.inertial.position, b.inertial.position)
    assert np.array_equal(a.filter.covariance, b.filter.covariance)


STATED = replace(LIDAR, range_sigma=0.3, boresight_sigma=np.deg2rad(0.2), latency_sigma=0.02)


def test_without_a_map_scans_contain_nothing_about_position_and_azimuth(world):
    # Speed told in the site's azimuth and measured in the lander's would tell of it, rightly.
    errors = StartSigmas(15.0, 1.0, np.deg2rad(0.3))
    descent = Descent(world, 3, errors=errors)
    descent.filter = Navigator(descent.inertial, errors, instruments={"flash": LIDAR.calibration()})
    before = descent.estimate().covariance
    state, taken = descent.filter.state, 0
    block = state.covariance[state.block(MAP), state.block(MAP)].copy()
    for _ in range(6):
        descent.fly(0.5)
        taken = descent.filter.monitors["flash scans"].dof
        p = descent.estimate().covariance
        # Azimuth and position of the site: as uncertain as the briefing.
        assert p[8, 8] >= (1.0 - 2e-3) * before[8, 8]
        assert (np.diag(p)[:2] >= (1.0 - 2e-3) * np.diag(before)[:2]).all()
        assert p[6, 6] < before[6, 6]
    assert taken > 100
    now = state.covariance[state.block(MAP), state.block(MAP)]

    assert now[3, 3] > 0.998 * block[3, 3]
    assert np.linalg.norm(descent.filter.site_to_local.offset) < 1.5


@pytest.mark.parametrize(("speed", "turn"), [(3.0, 0.5), (3.0, 2.0)])
def test_from_a_start_that_is_far_off_scans_contain_nothing_about_place_and_yaw(world, speed, turn):
    errors = StartSigmas(15.0, speed, np.deg2rad(turn))
    descent = Descent(world, 0, errors=errors)
    descent.filter = Navigator(descent.inertial, errors, instruments={"flash": LIDAR.calibration()})
    before = np.diag(descent.estimate().covariance)
    # All that can be had: the way that the told velocity points.
    way = np.linalg.norm(descent.inertial.velocity[:2]) * np.deg2rad(turn) / speed
    for _ in range(8):
        descent.fly(0.5)
        now = np.diag(descent.estimate().covariance)
        assert (now[:2] > 0.998 * before[:2]).all()
        assert now[8] > 0.998 * before[8] / (1.0 + way**2)
    assert descent.filter.monitors["flash scans"].dof > 100
    assert now[3:6].max() < 0.3**2
    assert now[6:8].max() < 1.02 * before[6:8].max()


def test_map_rotates_when_tilt_is_corrected(world):
    """Points of the first scans, rotated by the map rotation, lie on the true terrain."""
    off = {}
    descent = Descent(world, 2, errors=StartSigmas(5.0, 0.05, np.deg2rad(0.5)))
    seen = []
    for _ in range(3):
        before = descent.filter.map_rotation
        scan = descent.scan(np.array([25.0, 10.0 * len(seen), 0.0]))
        descent.filter.take("flash", scan, descent.time)
        now = descent.filter.estimate(descent.time, 1.0)
        seen.append(scan.points(now.position, now.attitude)[::37])
        descent.fly(0.1, scans=False)
    assert before is not None
    turn = descent.filter.map_rotation.rotation
    descent.fly(5.0)
    assert descent.filter.locked
    after = descent.filter.map_rotation
    learnt, angle = after.rotation_since(turn)
    assert angle > np.deg2rad(0.2)
    points = np.vstack(seen)
    for name, local in (
        ("as seen", points), ("turned", (points - after.pivot) @ learnt.T + after.pivot)
    ):  # fmt: skip
        site = descent.filter.frame.to_site(local)
        height = site[:, 2] - np.array([descent.world.terrain.elevation(p) for p in site[:, :2]])
        off[name] = float(np.nanstd(height))
    assert off["turned"] < 0.5 * off["as seen"]


@pytest.mark.statistical
@sample_sizes(2, 6)
def test_scanner_errors_are_estimated(world, count):
    nees, values = Consistency(), Consistency()
    for seed in range(count):
        descent = Descent(world, seed, lidar=STATED).fly(6.0)
        if not descent.filter.locked:
            continue
        nees = nees.plus(descent.nees(), 6)
        state, truth = descent.filter.state, descent.lidar
        true = np.array([-truth.range_bias, *truth.boresight, truth.latency])
        block = state.block("lidar flash")
        off = true - state.value("lidar flash")
        values = values.plus(normalised_squared_error(off, state.covariance[block, block]), 5)
        assert np.sqrt(state.covariance[block, block][1, 1]) < 0.6 * STATED.boresight_sigma
        assert "covariance-inflated" not in names(descent)
    assert nees.degrees >= 5 * count
    assert 0.2 < nees.ratio < ratio_bounds(nees.degrees)[1]
    assert 0.2 < values.ratio < ratio_bounds(values.degrees)[1]


@pytest.mark.parametrize(
    "fault",
    [{"range_bias": 0.3}, {"boresight_bias": np.deg2rad(0.5)}, {"latency_bias": 0.02}],
    ids=lambda fault: next(iter(fault)),
)
def test_unspecified_scanner_error_is_detected(world, fault):
    for seed in (0, 1):
        descent = Descent(world, seed, lidar=replace(LIDAR, **fault)).fly(5.0)
        sigma = np.sqrt(np.diag(descent.estimate().covariance))[KEEP]
        assert descent.estimate().lost or (np.abs(descent.error()) < 5.0 * sigma).all()
        assert descent.filter.has_located
