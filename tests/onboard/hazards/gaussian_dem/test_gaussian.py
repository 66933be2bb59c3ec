from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import (
    conventional_dem,
    fit_hyperparameters,
    full_regression,
    gaussian_dem,
)
from tests.chance import ratio_bounds
from tests.reference import dem as reference

GRID = Grid.centred((0.0, 0.0), 8.0, 0.5)


def cloud(seed: int, n: int = 60, spread: float = 3.9) -> np.ndarray:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-spread, spread, (n, 2))
    return np.column_stack((xy, np.sin(xy[:, 0]) + 0.1 * rng.standard_normal(n)))


def test_a_plane_is_registered_to_cell_centres():
    """A registration error of half a cell would be 0.05 m here."""
    x, y = np.meshgrid(np.linspace(-4, 4, 161), np.linspace(-4, 4, 161))
    points = np.column_stack((x.ravel(), y.ravel(), 0.2 * x.ravel()))
    inner = (slice(1, -1), slice(1, -1))
    expected = 0.2 * GRID.centres()[..., 0]
    assert np.allclose(conventional_dem(points, GRID).elevation[inner], expected[inner], atol=1e-3)
    dem = gaussian_dem(points, GRID, sigma_eps=0.01)
    assert np.allclose(dem.mean[inner], expected[inner], atol=1e-3)


@given(st.integers(0, 1000), st.floats(0.05, 1.0), st.floats(0.5, 40.0), st.floats(0.001, 0.05))
def test_interpolated_cells_agree_with_kriging_from_their_triangle(seed, sigma_f, length, eps):
    points = cloud(seed, 30)
    dem = gaussian_dem(points, GRID, sigma_f=sigma_f, length_scale=length, sigma_eps=eps)
    weight = conventional_dem(points, GRID).weight
    mesh = Delaunay(points[:, :2])
    rng = np.random.default_rng(seed)
    for _ in range(30):
        i, j = rng.integers(0, GRID.rows), rng.integers(0, GRID.cols)
        xy = GRID.centre_of(i, j)
        t = int(mesh.find_simplex(xy))
        if weight[i, j] > 0.5:
            assert dem.variance[i, j] == pytest.approx(eps**2, rel=1e-4)
        elif t < 0:
            assert np.isnan(dem.mean[i, j])
            assert dem.variance[i, j] == pytest.approx(sigma_f**2, rel=1e-4)
            assert not dem.observed[i, j]
        elif dem.observed[i, j]:
            mean, variance = reference.kriging(points[mesh.simplices[t]], xy, sigma_f, length, eps)
            assert dem.mean[i, j] == pytest.approx(mean, abs=1e-5)
            assert dem.variance[i, j] == pytest.approx(variance, rel=1e-3, abs=1e-7)


def test_a_gap_is_not_observed():
    points = cloud(1, 3000)
    points = points[np.abs(points[:, 0]) > 1.2]
    dem = gaussian_dem(points, GRID, sigma_f=0.3)
    middle = np.abs(GRID.x) < 0.6
    assert not dem.observed[:, middle].any()
    assert np.allclose(dem.variance[:, middle], 0.09)
    assert dem.observed[2:-2, 2].all()


def test_missing_returns_are_not_observed():
    x, y = np.meshgrid(np.linspace(-4, 4, 33), np.linspace(4, -4, 33))
    image = np.column_stack((x.ravel(), y.ravel(), np.zeros(33 * 33)))
    lost = (np.abs(image[:, 0] - 1.0) < 0.6) & (np.abs(image[:, 1]) < 0.6)
    image[lost] = np.nan
    grid = Grid.centred((0.0, 0.0), 7.0, 0.1)
    dem = gaussian_dem(image, grid, image_shape=(33, 33))
    row, col = grid.cell([1.0, 0.0])
    assert not dem.observed[row, col]
    row, col = grid.cell([-2.0, 0.0])
    assert dem.observed[row, col]
    with pytest.raises(ValueError, match="image_shape"):
        gaussian_dem(image, grid, image_shape=(10, 10))


def test_missing_returns_count_whatever_the_spacing():
    """Lost pixels of a detector are gaps at any sample spacing."""
    x, y = np.meshgrid(np.linspace(-4, 4, 33), np.linspace(4, -4, 33))
    image = np.column_stack((x.ravel(), y.ravel(), np.zeros(33 * 33)))
    image[(np.abs(image[:, :2]) < 0.3).all(axis=1)] = np.nan
    grid = Grid.centred((0.0, 0.0), 7.0, 0.1)
    middle = grid.cell([0.05, 0.05])
    assert not gaussian_dem(image, grid, image_shape=(33, 33), spacing=10.0).observed[middle]
    assert gaussian_dem(image, grid, spacing=10.0).observed[middle]


def hole(points, side):
    """Return the points outside a square hole at the origin."""
    return points[(np.abs(points[:, :2]) > 0.5 * side).any(axis=1)]


def test_a_hole_among_many_lost_returns_is_not_observed():
    """Four of five returns are missing, and all returns in a hole of 10 m."""
    rng = np.random.default_rng(5)
    line = np.linspace(-20.0, 20.0, 101)
    x, y = np.meshgrid(line, line[::-1])
    image = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    inside = (np.abs(image[:, :2]) < 5.0).all(axis=1)
    image[(rng.random(len(image)) < 0.8) | inside] = np.nan
    grid = Grid.centred((0.0, 0.0), 38.0, 0.5)
    middle = (np.abs(grid.centres()) < 4.0).all(axis=-1)
    for dem in (
        gaussian_dem(image, grid, image_shape=x.shape),
        gaussian_dem(image, grid, image_shape=x.shape, spacing=0.4),
        gaussian_dem(image, grid, spacing=0.4),
        gaussian_dem(image, grid),
    ):
        assert not dem.observed[middle].any()
    # Sparse samples are not a hole if only their distance is known.
    assert gaussian_dem(image, grid).observed[~middle].mean() > 0.5


def test_a_fine_patch_hides_no_coarse_terrain():
    rng = np.random.default_rng(6)
    coarse = np.column_stack((rng.uniform(-20.0, 20.0, (1600, 2)), np.zeros(1600)))
    fine = np.column_stack((rng.uniform(5.0, 15.0, (40_000, 2)), np.zeros(40_000)))
    grid = Grid.centred((0.0, 0.0), 36.0, 0.5)
    alone = gaussian_dem(coarse, grid).observed
    spacing = np.concatenate((np.full(1600, 1.0), np.full(40_000, 0.05)))
    for told in (None, spacing):
        both = gaussian_dem(np.concatenate((coarse, fine)), grid, spacing=told).observed
        assert alone.mean() > 0.9
        assert both.mean() > alone.mean() - 0.02


def test_a_gap_of_four_spacings_is_one_and_of_two_is_none():
    line = np.arange(-10.0, 10.01, 0.5)
    x, y = np.meshgrid(line, line)
    points = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    grid = Grid.centred((0.0, 0.0), 16.0, 0.2)
    middle = grid.cell([0.05, 0.05])
    assert gaussian_dem(hole(points, 1.0 - 1e-6), grid, spacing=0.5).observed[middle]
    assert not gaussian_dem(hole(points, 2.0 - 1e-6), grid, spacing=0.5).observed[middle]


@pytest.mark.parametrize(("spacing", "seen"), [(1.0, True), (0.999, False)])
def test_an_edge_of_three_spacings_is_the_longest_that_is_no_gap(spacing, seen):
    corners = np.array([[-1.5, -0.5, 0.0], [1.5, -0.5, 0.0], [0.0, 1.0, 0.0]])
    dem = gaussian_dem(corners, GRID, spacing=spacing)
    assert dem.observed[GRID.cell(np.array([0.0, 0.0]))] == seen


def test_image_order_changes_nothing_on_open_terrain():
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(-5, 5, 40), np.linspace(5, -5, 40))
    image = np.column_stack((x.ravel(), y.ravel(), rng.random(1600)))
    image[:, :2] += 0.03 * rng.standard_normal((1600, 2))
    grid = Grid.centred((0.0, 0.0), 7.0, 0.1)
    a = gaussian_dem(image, grid, image_shape=(40, 40))
    b = gaussian_dem(rng.permutation(image), grid)
    assert np.allclose(a.mean, b.mean, atol=1e-5)
    assert np.allclose(a.variance, b.variance, atol=1e-7)
    assert np.array_equal(a.observed, b.observed)


@given(st.floats(-500.0, 500.0), st.integers(-5, 5), st.integers(-5, 5))
def test_shift_invariance(dz, rows, cols):
    points = cloud(4, 80)
    moved = points + [0.5 * cols, 0.5 * rows, dz]
    grid = Grid(GRID.x0 + 0.5 * cols, GRID.y0 + 0.5 * rows, 0.5, GRID.rows, GRID.cols)
    a = gaussian_dem(points, GRID)
    b = gaussian_dem(moved, grid)
    assert np.allclose(a.mean + dz, b.mean, atol=2e-4, equal_nan=True)
    assert np.allclose(a.variance, b.variance, atol=1e-5)


def test_bad_clouds():
    with pytest.raises(ValueError, match="shape"):
        gaussian_dem(np.zeros((4, 2)), GRID)
    with pytest.raises(ValueError, match="must not be infinite"):
        gaussian_dem([[0.0, 0.0, np.inf]], GRID)
    with pytest.raises(ValueError, match="sigma_f"):
        gaussian_dem(cloud(1), GRID, sigma_f=0.0)
    with pytest.raises(ValueError, match="length_scale"):
        gaussian_dem(cloud(1), GRID, length_scale=-1.0)
    with pytest.raises(ValueError, match="sigma_eps"):
        gaussian_dem(cloud(1), GRID, sigma_eps=float("nan"))
    with pytest.raises(
        ValueError, match=r"points: heights must be between -8192 and 8192 m, got 173740"
    ):
        gaussian_dem(cloud(1) + [0.0, 0.0, 1_737_400.0], GRID)
    with pytest.raises(ValueError, match="heights must be between"):
        conventional_dem(cloud(1) + [0.0, 0.0, -9000.0], GRID)
    with pytest.raises(ValueError, match="must include a point on the grid"):
        conventional_dem([[100.0, 0.0, 0.0]], GRID)


@pytest.mark.parametrize("wrong", [-1.0, 1e200, np.nan, np.inf])
def test_a_random_field_has_a_spread_that_can_be(wrong):
    for name in ("sigma_f", "sigma_eps", "length_scale"):
        with pytest.raises(InputError, match=name):
            gaussian_dem(cloud(1), GRID, **{name: wrong})


def test_samples_without_noise_and_terrain_all_alike_still_give_a_map():
    """The matrix of a triangle is then nearly singular."""
    plane = cloud(1)
    plane[:, 2] = 0.3 + 0.1 * plane[:, 0]
    for length in (1e3, 1e6, 1e9):
        found = gaussian_dem(plane, GRID, sigma_eps=0.0, sigma_f=0.5, length_scale=length)
        seen = found.observed
        assert seen.any()
        x = GRID.centres()[..., 0]
        assert found.mean[seen] == pytest.approx((0.3 + 0.1 * x)[seen], abs=0.07)
        assert (found.variance[seen] >= 0.0).all()


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        [[0.1, 0.1, 1.0]],
        [[0.1, 0.1, 1.0], [0.2, 0.3, 2.0]],
        [[i * 0.1, i * 0.1, 1.0] for i in range(5)],
        [[np.nan, 0.0, 0.0]] * 4,
    ],
    ids=["none", "one", "two", "collinear", "nan"],
)
def test_too_few_points_leave_the_map_unobserved(points):
    dem = gaussian_dem(points, GRID)
    assert dem.observed.mean() < 0.05
    assert np.isfinite(dem.variance).all()


def test_coincident_points_are_merged():
    points = np.concatenate((cloud(3, 20), cloud(3, 20) + [0.0, 0.0, 1.0]))
    dem = gaussian_dem(points, GRID, sigma_eps=0.0)
    assert np.isfinite(dem.mean[dem.observed]).all()


def random_field(seed: int, n: int, sigma_f: float, length: float, eps: float) -> np.ndarray:
    """Return a draw of the model at random points."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 20.0, (n, 2))
    gram = sigma_f**2 * np.exp(-np.linalg.norm(xy[:, None] - xy[None], axis=2) / length)
    z = np.linalg.cholesky(gram + 1e-9 * np.eye(n)) @ rng.standard_normal(n)
    return np.column_stack((xy, z + eps * rng.standard_normal(n)))


def test_full_regression_on_three_points_is_the_local_one():
    points = cloud(2, 3)
    xy = points[:, :2].mean(axis=0)
    mean, variance = full_regression(
        points, xy[None], sigma_f=0.4, length_scale=9.0, sigma_eps=0.02
    )
    wanted = reference.kriging(points, xy, 0.4, 9.0, 0.02)
    assert (mean[0], variance[0]) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.statistical
def test_full_regression_is_consistent_with_its_own_model():
    """Normalized errors of held-out points have unit mean square."""
    points = random_field(4, 1500, 0.3, 6.0, 0.02)
    known, held = points[:1200], points[1200:]
    mean, variance = full_regression(
        known, held[:, :2], sigma_f=0.3, length_scale=6.0, sigma_eps=0.02
    )
    nees = np.mean((held[:, 2] - mean) ** 2 / (variance + 0.02**2))
    low, high = ratio_bounds(300)
    assert low < nees < high


def test_local_regression_approaches_the_full_one():
    points = random_field(5, 1500, 0.3, 6.0, 0.005)
    grid = Grid.centred((10.0, 10.0), 12.0, 0.5)
    dem = gaussian_dem(points, grid, sigma_f=0.3, length_scale=6.0, sigma_eps=0.005)
    weight = conventional_dem(points, grid).weight
    mean, variance = full_regression(
        points, grid.centres().reshape(-1, 2), sigma_f=0.3, length_scale=6.0, sigma_eps=0.005
    )
    use = (dem.observed & (weight <= 0.5)).ravel()
    gap = dem.mean.ravel()[use] - mean[use]
    # Three vertices hold less information than all points: the variance is larger, and the means
    # agree within it.
    assert np.all(dem.variance.ravel()[use] >= variance[use] - 1e-6)
    assert np.sqrt(np.mean(gap**2)) < 0.6 * np.sqrt(np.mean(dem.variance.ravel()[use]))


@pytest.mark.parametrize(("sigma_f", "length"), [(0.3, 4.0), (0.1, 20.0)])
def test_fit_recovers_the_growth_of_the_variogram(sigma_f, length):
    growth = [
        fit_hyperparameters(
            random_field(seed, 1500, sigma_f, length, 0.01), 0.01, np.random.default_rng(seed),
            largest_lag=4.0,
        ).growth
        for seed in range(5)
    ]  # fmt: skip
    assert np.median(growth) == pytest.approx(sigma_f**2 / length, rel=0.25)


def test_fit_and_full_regression_refuse_what_they_cannot_do():
    with pytest.raises(ValueError, match="at least 100"):
        fit_hyperparameters(cloud(1, 20), 0.01, np.random.default_rng(0))
    with pytest.raises(ValueError, match="singular"):
        twice = np.concatenate((cloud(1, 5), cloud(1, 5)))
        full_regression(twice, [[0.0, 0.0]], sigma_f=1.0, length_scale=1.0, sigma_eps=0.0)
    with pytest.raises(ValueError, match="at most 5000"):
        full_regression(
            np.zeros((6000, 3)), [[0.0, 0.0]], sigma_f=1.0, length_scale=1.0, sigma_eps=0.1
        )
