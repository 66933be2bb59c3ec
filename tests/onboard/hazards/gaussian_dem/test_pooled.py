"""Test the pooled Gaussian DEM: sums, regression and consistency of its variance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.evaluation.consistency import Consistency
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, pooled_dem
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief, place_rocks
from tests.reference import dem as reference

GRID = Grid.centred((0.0, 0.0), 5.0, 0.5)


def samples(seed: int, n: int = 120):
    rng = np.random.default_rng(seed)
    points = np.column_stack((rng.uniform(-3.0, 3.0, (n, 2)), rng.normal(0.0, 0.5, n)))
    points[rng.random(n) < 0.05] = np.nan
    return points, rng.uniform(0.01, 0.1, n)


@settings(max_examples=5)
@given(st.integers(0, 1000), st.sampled_from([0.0, -700.0, 4000.0]))
def test_sums_are_those_of_a_plain_loop(seed, level):
    scans = []
    pool = SamplePool(GRID)
    for n in range(3):
        points, sigma = samples(seed + 7 * n)
        points[:, 2] += level
        scans.append((points, sigma))
        pool.add(points, sigma, 0.5)
    near, about = reference.pooled_sums(scans, GRID)
    vertices, noise, spacing = pool.vertices()
    wanted = near[np.isfinite(near[..., 0])]
    assert vertices == pytest.approx(wanted[:, :3], abs=1e-9)
    assert noise == pytest.approx(wanted[:, 3], rel=1e-9)
    assert (spacing == 0.5).all()
    dem = pooled_dem(pool)
    measured = np.nan_to_num(about[..., 2]) > 0.5
    assert dem.mean[measured] == pytest.approx(about[measured][:, 0], abs=1e-3)
    # Noise is the minimum error of a measured cell.
    assert (dem.variance[measured] >= about[measured][:, 1] * (1.0 - 1e-5)).all()


def peaks(scans) -> np.ndarray:
    """Maximum of height minus four standard deviations over the samples of each cell."""
    out = np.full(GRID.shape, -np.inf)
    for points, sigma in scans:
        for (x, y, z), s in zip(points, sigma, strict=True):
            if np.isfinite(z) and GRID.contains((x, y)):
                i, j = GRID.cell((x, y))
                out[i, j] = max(out[i, j], z - 4.0 * s)
    return out


@pytest.mark.parametrize("level", [0.0, -700.0])
def test_the_peak_exceeds_the_highest_sample_by_no_more_than_this_exceeds_its_neighbours(level):
    pool, scans = SamplePool(GRID), []
    for n in range(3):
        points, sigma = samples(7 * n)
        points[:, 2] += level
        scans.append((points, sigma))
        pool.add(points, sigma, 0.5)
    dem, found = pooled_dem(pool), peaks(scans)
    known = np.isfinite(dem.mean)
    assert np.isnan(dem.peak[~known]).all()
    mean = np.pad(np.where(known, dem.mean, -np.inf), 1, constant_values=-np.inf)
    for i, j in zip(*np.nonzero(known), strict=True):
        around = mean[i : i + 3, j : j + 3].max()
        highest = max(float(dem.mean[i, j]), found[i, j])
        most = highest + max(highest - around, 0.0)
        assert dem.mean[i, j] <= dem.peak[i, j] <= most + 2e-7 * abs(level) + 1e-4
    assert (dem.peak > dem.mean + 0.1)[known].mean() > 0.3


def test_peaks_move_with_the_samples_of_a_pool():
    points, sigma = samples(1)
    points = points[np.isfinite(points[:, 2])]
    sigma = sigma[: len(points)]
    pool = SamplePool(GRID)
    pool.add(points, sigma, 0.5)
    whole = pool.peak + pool.base
    raised = pool.shifted(np.array([0.5, 0.0, 2.0]))
    np.testing.assert_allclose(raised.peak + raised.base, whole + 2.0)
    moved = pool.on_shifted_grid(GRID.moved((GRID.posting, 0.0)))
    np.testing.assert_array_equal(moved.peak[:, :-1], pool.peak[:, 1:])
    first, second = SamplePool(GRID), SamplePool(GRID)
    first.add(points[:40], sigma[:40], 0.5)
    second.add(points[40:] + [0.0, 0.0, 30.0], sigma[40:], 0.5)
    both = first.union(second)
    wanted = peaks([(points[:40], sigma[:40]), (points[40:] + [0.0, 0.0, 30.0], sigma[40:])])
    np.testing.assert_allclose(both.peak + both.base, wanted)


def test_peaks_turn_with_their_samples():
    """One sample per cell, near its centre: the rotated pool is the pool of rotated samples."""
    rng = np.random.default_rng(3)
    points = np.column_stack(
        (GRID.centres().reshape(-1, 2), rng.normal(0.0, 0.3, GRID.rows * GRID.cols))
    )
    points = points[(np.abs(points[:, :2]) < 2.2).all(axis=1)]
    tilt = np.deg2rad(2.0)
    turn = np.array([
        [np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)],
    ])  # fmt: skip
    pool, wanted = SamplePool(GRID), SamplePool(GRID)
    pool.add(points, 0.05, 0.5)
    wanted.add(points @ turn.T, 0.05, 0.5)
    turned = pool.rotated(turn, np.zeros(3))
    np.testing.assert_allclose(turned.peak + turned.base, wanted.peak + wanted.base, atol=1e-9)


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_a_rock_narrower_than_a_cell_raises_the_peak_and_not_the_mean(slope):
    grid = Grid.centred((0.0, 0.0), 4.0, 0.2)
    x, y = np.meshgrid(np.arange(-2.0, 2.0, 0.05), np.arange(-2.0, 2.0, 0.05))
    found = {}
    for radius in (0.08, 0.3):
        z = np.where(np.hypot(x - 0.1, y - 0.1) < radius, 0.3, 0.0) + slope * x
        pool = SamplePool(grid)
        pool.add(np.column_stack((x.ravel(), y.ravel(), z.ravel())), 0.001, 0.05)
        dem = pooled_dem(pool)
        level = slope * grid.centres()[..., 0]
        found[radius] = dem.mean - level, dem.peak - level
        # Without rocks, the slope explains the highest samples.
        away = np.hypot(*np.moveaxis(grid.centres() - 0.1, -1, 0)) > radius + 0.3
        np.testing.assert_allclose(dem.peak[away], dem.mean[away], atol=2e-6)
        # The density is that of the scan, not of the cells.
        assert np.median(dem.sampling.density) == pytest.approx(400.0)
    mean, peak = found[0.08]
    assert mean.max() < 0.2
    # Four standard deviations below the highest sample, plus its excess over the mean.
    assert peak.max() == pytest.approx(2.0 * 0.296 - mean.max(), abs=0.15 * slope + 1e-6)
    # The neighbouring cells show a wide rock.
    assert found[0.3][1].max() == pytest.approx(0.3, abs=0.03)


def rough(seed: int, slope_deg: float = 5.0) -> Terrain:
    grid = Grid.centred((0.0, 0.0), 60.0, 0.25)
    rng = np.random.default_rng(seed)
    relief = fractal_relief(grid, rng, hurst=0.85, rms_slope=np.deg2rad(slope_deg))
    diameters = rng.uniform(0.4, 1.2, 60)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("ellipsoid")))


def scan(terrain: Terrain, spacing: float, sigma: float, rng, jitter: float = 0.5):
    """Return samples from vertically above, `spacing` m apart."""
    line = np.arange(-15.9, 16.0, spacing)
    x, y = np.meshgrid(line, line)
    xy = np.column_stack((x.ravel(), y.ravel())) + jitter * spacing * rng.uniform(-0.5, 0.5, 2)
    return np.column_stack((xy, terrain.elevation(xy) + sigma * rng.standard_normal(len(xy))))


def strata(dem, pool: SamplePool, terrain: Terrain) -> dict[str, np.ndarray]:
    """Return squared normalized errors of measured, interpolated and rock cells.

    A cell counts as a rock if the map shows one. Rocks without a sample are part of the terrain
    between samples and of its variance.
    """
    square = (dem.mean - terrain.raster(dem.grid)) ** 2 / dem.variance
    shown = dem.mean - Terrain(terrain.relief, RockField.empty()).raster(dem.grid) > 0.12
    measured = pool.splat[..., 0] > 0.5
    return {
        "measured": square[dem.observed & measured & ~shown],
        "interpolated": square[dem.observed & ~measured & ~shown],
        "rocks": square[dem.observed & shown],
    }


@pytest.mark.parametrize(("seed", "slope_deg"), [(1, 5.0), (2, 5.0), (3, 12.0), (3, 1.0)])
def test_over_a_descent_it_has_the_stated_error(seed, slope_deg):
    terrain, grid = rough(seed, slope_deg), Grid.centred((0.0, 0.0), 24.0, 0.2)
    rng = np.random.default_rng(seed)
    pool = SamplePool(grid)
    total = {name: Consistency() for name in ("measured", "interpolated", "rocks")}
    for spacing, sigma in ((0.8, 0.03), (0.6, 0.025), (0.45, 0.02), (0.3, 0.012)):
        pool.add(scan(terrain, spacing, sigma, rng), sigma, spacing)
        for name, squares in strata(pooled_dem(pool), pool, terrain).items():
            total[name] = total[name].plus(float(squares.sum()), len(squares))
    for name, (low, high) in {
        "measured": (0.7, 1.5), "interpolated": (0.65, 1.5), "rocks": (0.65, 1.5)
    }.items():  # fmt: skip
        assert low < total[name].ratio < high, name


def test_the_same_view_again_contains_nothing_about_what_lies_between():
    terrain, grid = rough(3), Grid.centred((0.0, 0.0), 24.0, 0.2)
    rng = np.random.default_rng(0)
    once, often = SamplePool(grid), SamplePool(grid)
    once.add(scan(terrain, 0.8, 0.03, rng, jitter=0.0), 0.03, 0.8)
    for _ in range(20):
        often.add(scan(terrain, 0.8, 0.03, rng, jitter=0.0), 0.03, 0.8)
    a, b = pooled_dem(once), pooled_dem(often)
    assert np.array_equal(a.observed, b.observed)
    # Twenty independent maps would state a twentieth.
    between = a.observed & (once.splat[..., 0] <= 0.5)
    assert np.median(b.variance[between] / a.variance[between]) > 0.4
    assert np.median(b.sampling.density) == pytest.approx(np.median(a.sampling.density))
    assert np.mean(strata(b, often, terrain)["interpolated"]) < 1.6
    # Noise averages out where it is the only error.
    assert np.median(b.variance[~between & a.observed]) < 0.5 * np.median(
        a.variance[~between & a.observed]
    )


def test_slopes_buried_in_noise_stay_slopes():
    """A regression on three corners only would flatten each triangle."""
    grid = Grid.centred((0.0, 0.0), 30.0, 0.25)
    plane = Heightfield(
        Grid.centred((0.0, 0.0), 60.0, 1.0),
        (0.2 * Grid.centred((0.0, 0.0), 60.0, 1.0).centres()[..., 0]).astype(np.float32),
    )
    pool = SamplePool(grid)
    terrain = Terrain(plane, place_rocks(plane, [], np.random.default_rng(0)))
    pool.add(scan(terrain, 0.7, 0.05, np.random.default_rng(1)), 0.05, 0.7)
    dem = pooled_dem(pool)
    error = dem.mean - 0.2 * grid.centres()[..., 0]
    assert np.sqrt(np.mean(error[dem.observed] ** 2)) < 0.04
    assert np.mean(error[dem.observed] ** 2 / dem.variance[dem.observed]) == pytest.approx(
        1.0, abs=0.3
    )


def test_samples_of_a_bird_or_a_planet_away_are_refused():
    points, sigma = samples(1)
    pool = SamplePool(GRID)
    with pytest.raises(InputError, match="heights must be between -8192 and 8192 m"):
        pool.add(points + [0.0, 0.0, 1_737_000.0], sigma, 0.5)
    with pytest.raises(InputError, match="must not be infinite"):
        pool.add([[0.0, 0.0, np.inf]], 0.1, 0.5)
    with pytest.raises(InputError, match="shape"):
        pool.add(np.zeros((3, 2)), 0.1, 0.5)
    for text in (points.astype(str), points > 0.0):
        with pytest.raises(InputError, match="must be real numbers"):
            pool.add(text, sigma, 0.5)
    for wrong in (0.0, -1.0, np.nan, np.inf, 1e300):
        with pytest.raises(InputError, match="sigma"):
            pool.add(points, wrong, 0.5)
        with pytest.raises(InputError, match="spacing"):
            pool.add(points, sigma, wrong)
    assert pool.base is None
    assert pool.add(np.full((4, 3), np.nan), 0.1, 0.5) == 0
    assert not pooled_dem(pool).observed.any()
    # A single sample, or collinear samples, give no map between them.
    pool.add([[0.0, 0.0, 1.0]], 0.1, 0.5)
    assert pooled_dem(pool).observed.mean() < 0.05
