"""Test the correction of rock heights by measured terrain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.frames import quat_from_rotation_vector
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.navigation.terrain_heights import (
    COMMON_SIGMA_M,
    INDIVIDUAL_SIGMA_M,
    TERRAIN,
    TerrainPrior,
    intersect_lines,
    kriging_weights,
)
from lunarsim.sensors.camera import Camera
from tests.reference import laid

EYE = np.array([-300.0, 40.0, 250.0])
STARTS = StartSigmas(3.0, 0.05, 2e-4)


class Plane:
    """Measured terrain; unknown west of a limit."""

    def __init__(self, gradient=(0.0, 0.0), height=0.0, west=-np.inf):
        self.gradient, self.height, self.west = np.array(gradient), height, west

    def heights(self, xy):
        z = self.height + xy @ self.gradient
        return np.where(xy[:, 0] >= self.west, z, np.nan)


def rocks_seen(xyz, ground=None, seed=0, attitude=(0.02, -0.05, 0.3), sigma=3.0):
    """Return a filter with tracked rocks at estimated positions, and its camera."""
    level = quat_from_rotation_vector(np.array(attitude))
    inertial = StrapdownState(EYE, np.zeros(3), level, 1.622)
    rocks = RockFilter.of(inertial, STARTS, terrain_prior=TerrainPrior(0.0, sigma))
    rocks.measured_terrain = ground
    camera = replace(Camera.with_field_of_view(640, 480, 20.0), mount=gimbal_mount(level, -EYE))
    n = len(xyz)
    rocks.add(camera, xyz, np.tile(0.1 * np.eye(2), (n, 1, 1)), np.full(n, 0.4), np.full(n, 0.01))
    return rocks, camera


def places(count, seed=0, height=0.0):
    xy = np.random.default_rng(seed).uniform(-25.0, 25.0, (count, 2))
    return np.column_stack((xy, np.full(count, height)))


@pytest.mark.parametrize("gradient", [(0.0, 0.0), (0.15, -0.1)])
@pytest.mark.parametrize("off", [0.0, 1.5])
def test_height_correction_equals_plain_update(gradient, off):
    ground = Plane(gradient, off)
    rocks, _ = rocks_seen(places(9))
    before = rocks.covariance.copy()
    xyz, lander = rocks.xyz.copy(), rocks.inertial
    at = lander.position.copy(), lander.attitude.copy()
    rocks.measured_terrain = ground
    outcome = rocks.correct_heights_by_terrain()
    assert outcome.is_accepted and outcome.dof == 9
    columns = rocks.state_indices()
    error, after = laid.laid(
        before, xyz, *at, gradient, off, columns, INDIVIDUAL_SIGMA_M, COMMON_SIGMA_M
    )
    np.testing.assert_allclose(rocks.covariance, after, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(rocks.xyz - xyz, error[columns], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(lander.position - at[0], error[:3], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("wrong", [-3.0, 2.0])
def test_rocks_started_at_a_wrong_height_stand_where_lines_of_sight_meet_measured_terrain(wrong):
    """At 40 deg above the horizon, the horizontal errors are metres."""
    true = places(12, seed=3)
    away = true - EYE
    taken = EYE + away * ((wrong - EYE[2]) / away[:, 2])[:, None]
    rocks, _ = rocks_seen(taken)
    beside = np.linalg.norm((rocks.xyz - true)[:, :2], axis=1)
    assert beside.min() > 1.5
    rocks.measured_terrain = Plane()
    assert rocks.correct_heights_by_terrain().is_accepted
    off = rocks.xyz - rocks.inertial.position - (true - EYE)
    assert np.abs(off).max() < 0.15
    assert np.sqrt(rocks.relative_covariance()[:, 2, 2]).max() < 0.25


def test_well_known_rocks_are_not_corrected():
    rocks, _ = rocks_seen(places(6))
    rocks.measured_terrain = Plane()
    assert rocks.correct_heights_by_terrain().is_accepted
    before = rocks.covariance.copy()
    rocks.measured_terrain = Plane(height=0.3)
    outcome = rocks.correct_heights_by_terrain()
    assert not outcome.is_accepted and outcome.dof == 0
    np.testing.assert_array_equal(rocks.covariance, before)


class Crest(Plane):
    """Terrain that falls away from a south-north line."""

    def heights(self, xy):
        return -0.4 * np.abs(xy[:, 0])


def test_curvature_reduces_information():
    """A horizontal error causes a height error: two steps of 4 m down, 1.6 m."""
    xyz = np.array([[0.0, -3.0, 0.0], [0.0, 4.0, 0.0], [20.0, 1.0, -8.0]])
    rocks, _ = rocks_seen(xyz)
    rocks.measured_terrain = Crest()
    before = rocks.covariance.copy()
    lander, columns = rocks.inertial, rocks.state_indices()
    at = lander.position.copy(), lander.attitude.copy()
    assert rocks.correct_heights_by_terrain().is_accepted
    h = np.vstack([
        laid.jacobian(xyz[k : k + 1], *at, (g, 0.0), xyz[k, 2] - g * xyz[k, 0],
                      columns[k : k + 1], len(before))
        for k, g in enumerate((0.0, 0.0, -0.4))
    ])  # fmt: skip
    noise = np.diag(INDIVIDUAL_SIGMA_M**2 + np.array([1.6, 1.6, 0.0]) ** 2) + COMMON_SIGMA_M**2
    gain = before @ h.T @ np.linalg.inv(h @ before @ h.T + noise)
    np.testing.assert_allclose(rocks.covariance, before - gain @ h @ before, rtol=1e-4, atol=1e-4)


def test_inconsistent_terrain_is_rejected():
    rocks, _ = rocks_seen(places(6))
    rocks.measured_terrain = Plane(height=60.0)
    before = rocks.xyz.copy()
    assert not rocks.correct_heights_by_terrain().is_accepted
    np.testing.assert_array_equal(rocks.xyz, before)


@pytest.mark.parametrize("ground", [None, Plane(west=1e3)])
def test_no_correction_without_measured_terrain(ground):
    rocks, _ = rocks_seen(places(6))
    rocks.measured_terrain = ground
    assert not rocks.correct_heights_by_terrain().is_accepted


@pytest.mark.parametrize("gradient", [(0.0, 0.0), (0.3, -0.1)])
def test_new_rock_on_measured_terrain_has_its_error(gradient):
    """Height, lander and tilt apart: the first by what ground errs by, others as neighbours do.

    Ground and rock are seen from one pose, and turn and move with it as one, however it slopes.
    """
    ground = Plane(gradient)
    xyz = places(7, seed=5)
    xyz[:, 2] = ground.heights(xyz[:, :2])
    rocks, _ = rocks_seen(xyz, ground)
    lander, columns = rocks.inertial, rocks.state_indices()
    jacobian = np.vstack([
        laid.jacobian(xyz[k : k + 1], lander.position, lander.attitude, (0.0, 0.0), xyz[k, 2],
                      columns[k : k + 1], rocks.state.size)
        for k in range(7)
    ])  # fmt: skip
    errs = jacobian @ rocks.covariance @ jacobian.T
    assert errs[0, 0] == pytest.approx(INDIVIDUAL_SIGMA_M**2 + COMMON_SIGMA_M**2, rel=1e-3)
    assert errs[1, 1] == pytest.approx(2.0 * INDIVIDUAL_SIGMA_M**2 + COMMON_SIGMA_M**2, rel=0.1)
    # The common error is not averaged out.
    assert errs.mean() > 0.9 * COMMON_SIGMA_M**2
    west = xyz[:, 0] < 0.0
    assert 0 < west.sum() < 7
    beyond, _ = rocks_seen(xyz, Plane(west=0.0))
    sigma = np.sqrt(beyond.relative_covariance()[:, 2, 2])
    assert sigma[west].min() > 1.0 > sigma[~west].max()


def test_height_corrections_are_consistent():
    """Return normalised squared errors of rock positions over flights with random errors."""
    squares = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        rocks, _ = rocks_seen(places(8, seed))
        # Errors drawn from the filter's covariance.
        size = rocks.state.size
        drawn = rng.multivariate_normal(np.zeros(size), rocks.covariance, method="cholesky",
                                        check_valid="ignore")  # fmt: skip
        lander, columns = rocks.inertial, rocks.state_indices()
        jacobian = laid.jacobian(
            rocks.xyz, lander.position, lander.attitude, (0.0, 0.0), 0.0, columns, size
        )
        scatter = (
            INDIVIDUAL_SIGMA_M * rng.standard_normal(8) + COMMON_SIGMA_M * rng.standard_normal()
        )
        rocks.measured_terrain = Scattered(
            rocks.xy.copy(), rocks.xyz[:, 2] + jacobian @ drawn + scatter
        )
        true = rocks.xyz + drawn[columns] - (lander.position + drawn[:3])
        rocks.correct_heights_by_terrain()
        error = rocks.xyz - rocks.inertial.position - true
        covariance = rocks.relative_covariance()
        squares += [e @ np.linalg.solve(c, e) for e, c in zip(error, covariance, strict=True)]
    assert np.mean(squares) == pytest.approx(3.0, rel=0.25)


class Scattered:
    """Known heights at the rocks, flat elsewhere."""

    def __init__(self, xy, height):
        self.xy, self.height = xy, height

    def heights(self, xy):
        away = np.linalg.norm(xy[:, None] - self.xy, axis=2)
        return np.where(away.min(1) < 1e-6, self.height[away.argmin(1)], np.nan)


@pytest.mark.parametrize("spacing", [0.0, 4.0])
def test_a_new_rock_has_the_height_error_of_its_five_neighbours_and_of_the_terrain(spacing):
    """The five nearest, the first ones at equal distance; posts have equal distances."""
    rng = np.random.default_rng(3)
    xyz = places(30)
    if spacing:
        xyz[:, :2] = spacing * np.column_stack(np.divmod(rng.permutation(49)[:30], 7))
    rocks, camera = rocks_seen(xyz)
    told = rocks.covariance.copy()
    new = np.array([[4.0, 8.0, 0.0]]) if spacing else places(1, seed=1)
    away = np.hypot(*(xyz[:, :2] - new[0, :2]).T)
    near = np.argsort(away, kind="stable")[:5]
    at = np.vstack((rocks.inertial.position[:2], xyz[near, :2]))
    weights = kriging_weights(at[None], new[:, :2], rocks.prior_variance_growth)[0][0]
    heights = rocks.state_indices()[:, 2]
    ground = rocks.state.block(TERRAIN).start
    expected = weights[0] * told[ground] + weights[1:] @ told[heights[near]]
    rocks.add(camera, new, 0.1 * np.eye(2)[None], np.array([0.4]), np.array([0.01]))
    found = rocks.covariance[rocks.state_indices()[30, 2]]
    np.testing.assert_allclose(found[heights], expected[heights], rtol=1e-9)


class Unknown:
    """Measured terrain that is unknown everywhere."""

    def heights(self, xy):
        return np.full(len(xy), np.nan)


@pytest.mark.parametrize("rocks_told", [0, 1, 3, 400])
def test_lines_of_sight_meet_terrain_that_rocks_report_pass_by_pass(rocks_told):
    """The kernel for single lines equals the iteration over all lines."""
    rng = np.random.default_rng(rocks_told)
    xyz = places(rocks_told, seed=rocks_told)
    xyz[:, 2] = 0.4 * xyz[:, 0] + 3.0 * np.sin(xyz[:, 1])
    rocks, camera = rocks_seen(xyz)
    pixel = rng.uniform(-200.0, [840.0, 680.0], (300, 2))
    pixel[7] = np.nan
    found = rocks.terrain_points(camera, pixel)
    rocks.measured_terrain = Unknown()
    assert np.isfinite(found).all(1).sum() > 100
    assert not np.isfinite(found).all()
    np.testing.assert_array_equal(found, rocks.terrain_points(camera, pixel))


def test_a_line_of_sight_that_goes_nowhere_meets_nothing():
    """In the first iteration already, and with any memory contents."""
    known = np.zeros((9, 2)) + np.arange(9.0)[:, None], np.ones(9)
    per_drop = np.array([[np.nan, 0.0], [0.1, 0.2], [np.inf, 1.0]])
    met = intersect_lines(*known, EYE, per_drop, np.zeros(3), 1.0, (8, 0.01, 0.2, 3.0))
    assert np.isnan(met[[0, 2], 2]).all()
    assert met[1] == pytest.approx([EYE[0] + 24.9, EYE[1] + 49.8, 1.0])


def test_lines_of_sight_far_beside_a_region_are_left_out():
    rocks, camera = rocks_seen(places(5))
    pixel = np.random.default_rng(0).uniform(0.0, [640.0, 480.0], (200, 2))
    whole = rocks.terrain_points(camera, pixel)
    near = (-10.0, 20.0, -15.0, 5.0)
    found = rocks.terrain_points(camera, pixel, near)
    beside = np.maximum(
        np.maximum(near[0] - whole[:, 0], whole[:, 0] - near[1]),
        np.maximum(near[2] - whole[:, 1], whole[:, 1] - near[3]),
    )
    assert (beside < 8.0).sum() > 9
    np.testing.assert_allclose(found[beside < 8.0], whole[beside < 8.0], atol=0.02)
    assert (beside > 20.0).sum() > 9
    assert np.isnan(found[beside > 20.0]).all()


class Steps(Plane):
    """A slope in steps of 0.3 m."""

    def heights(self, xy):
        return 0.3 * np.floor(super().heights(xy) / 0.3)


def sight_lines(ground, depression, count=300):
    """Return rocks on terrain, a camera 1 km away that looks down on it, and points."""
    down = np.radians(depression)
    eye = np.array([-1000.0 * np.cos(down), 0.0, 1000.0 * np.sin(down)])
    level = np.array([0.0, 0.0, 0.0, 1.0])
    rocks = RockFilter.of(
        StrapdownState(eye, np.zeros(3), level, 1.622), STARTS, terrain_prior=TerrainPrior(0.0, 3.0)
    )
    rocks.measured_terrain = ground
    camera = replace(Camera.with_field_of_view(640, 480, 10.0), mount=gimbal_mount(level, -eye))
    xy = np.random.default_rng(0).uniform(-40.0, 40.0, (count, 2))
    return rocks, camera, eye, np.column_stack((xy, ground.heights(xy)))


@pytest.mark.parametrize("slope", [-0.6, -0.4, 0.4, 0.6])
def test_lines_of_sight_meet_terrain_that_is_steeper_than_they_are_long_to_find(slope):
    """Fixed-point iteration would leave decimetres after eight iterations."""
    rocks, camera, _, true = sight_lines(Plane((slope, 0.0)), 40.0)
    found = rocks.terrain_points(camera, rocks.project_rocks(camera, true).pixel)
    # Heights are correct to 1 cm along lines at 9 deg to the terrain.
    assert np.abs(found - true).max() < 0.05


@pytest.mark.parametrize("slope", [-0.5, 0.3, 0.5])
def test_lines_that_no_pass_brings_onto_steps_end_on_the_terrain_at_most_a_step_off(slope):
    ground = Steps((slope, 0.0))
    rocks, camera, eye, true = sight_lines(ground, 40.0, 2000)
    # Lines through points above the slope also pass between the steps.
    above = true + [0.0, 0.0, 1.0] * np.random.default_rng(1).uniform(0.0, 3.0, (2000, 1))
    found = rocks.terrain_points(camera, rocks.project_rocks(camera, above).pixel)
    np.testing.assert_array_equal(found[:, 2], ground.heights(found[:, :2]))
    way = (above - eye) / (eye[2] - above[:, 2:])
    along = np.linalg.norm(found[:, :2] - eye[:2], axis=1) / np.linalg.norm(way[:, :2], axis=1)
    off = np.abs(eye[2] - along - found[:, 2])
    assert off.max() < 0.31
    assert np.median(off) < 0.01


@pytest.mark.parametrize(
    ("slope", "depression"), [(0.0, 40.0), (0.27, 40.0), (-0.27, 40.0), (0.17, 25.0), (-0.17, 25.0)]
)
def test_lines_of_sight_meet_slopes_where_they_are(slope, depression):
    """No intersection within a region is missed, even in steep or low views."""
    rocks, camera, _, true = sight_lines(Plane((slope, 0.0)), depression)
    pixel = rocks.project_rocks(camera, true).pixel
    found = rocks.terrain_points(camera, pixel, (-43.0, 43.0, -43.0, 43.0))
    assert np.abs(found - true).max() < 0.03
