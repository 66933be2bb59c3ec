"""The reference posterior draws from the prior without returns, and is calibrated with them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.evaluation.patch_posterior import (
    PatchPrior,
    draw_patches,
    effective_samples,
    posterior_safety,
)
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.rocks.field import RockField
from lunarsim.rocks.size_distribution import golombek_number
from lunarsim.world.terrain import Heightfield, Terrain, fractal_relief

PRIOR = PatchPrior(
    cover=0.06, min_diameter=0.2, max_diameter=0.8, rms_slope=np.deg2rad(2.0)
)  # fmt: skip
HALF = 1.5
NO_RETURNS = np.zeros((0, 3))


@cache
def tables(prior: PatchPrior, half: float):
    """Return grid, factor of the relief's covariance, diameters and numbers of rocks."""
    grid = Grid.centred((0.0, 0.0), 2.0 * half + 2.0 * prior.posting, prior.posting)
    sizes = np.linspace(prior.min_diameter, prior.max_diameter, 20_000)
    factor = np.linalg.cholesky(prior.relief_covariance(grid))
    return grid, factor, sizes, golombek_number(sizes, prior.cover)


def world(prior: PatchPrior, half: float, rng: np.random.Generator) -> Terrain:
    """Draw a patch from the prior, independently of the chain."""
    grid, factor, sizes, number = tables(prior, half)
    relief = (factor @ rng.standard_normal(len(factor))).reshape(grid.shape)
    field = Heightfield(grid, relief.astype(np.float32))
    count = rng.poisson((number[0] - number[-1]) * 4.0 * half**2)
    drawn = number[-1] + rng.random(count) * (number[0] - number[-1])
    radius = 0.5 * np.interp(-drawn, -number, sizes)
    xy = rng.uniform(-half, half, (count, 2))
    base = Terrain(field, RockField.empty()).elevation(xy) if count else np.zeros(0)
    return Terrain(field, RockField.hemispheres(*xy.T, base, radius))


def returns(terrain: Terrain, half: float, spacing: float, sigma: float, rng) -> np.ndarray:
    """Return a scan from above, with returns at the nodes of a shifted grid."""
    axis = np.arange(-half + spacing * rng.random(), half, spacing)
    xy = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    z = terrain.elevation(xy) + sigma * rng.standard_normal(len(xy))
    return np.column_stack((xy, z))


def large_rocks(rocks: RockField) -> int:
    """Return the number of rocks more than 0.3 m wide."""
    return int((rocks.a > 0.15).sum())


def test_without_returns_the_chain_draws_from_the_prior():
    rng = np.random.default_rng(1)
    patches = [
        draw
        for _ in range(6)
        for draw in draw_patches(NO_RETURNS, 0.1, PRIOR, HALF, rng, 400, 100, 5)
    ]
    count = np.array([len(rocks) for _, rocks in patches])
    mean = PRIOR.rock_density() * 4.0 * HALF**2
    # Patches of one chain are 100 moves apart, many times the number of rocks.
    error = np.sqrt(mean / len(patches))
    assert abs(count.mean() - mean) < 4.0 * error
    assert count.var() == pytest.approx(mean, rel=0.3)
    diameter = 2.0 * np.concatenate([rocks.a for _, rocks in patches])
    assert diameter.min() >= 0.2 and diameter.max() <= 0.8
    for d in (0.25, 0.3, 0.5):
        expected = golombek_number([d, PRIOR.min_diameter, PRIOR.max_diameter], PRIOR.cover)
        share = (expected[0] - expected[2]) / (expected[1] - expected[2])
        assert (diameter > d).mean() == pytest.approx(share, abs=0.02)
    # With few moves, most rocks stay, and their bases follow the relief.
    for relief, rocks in draw_patches(NO_RETURNS, 0.1, PRIOR, HALF, rng, 5, 5, 40):
        assert len(rocks) > 0
        on = Terrain(relief, RockField.empty()).elevation(np.column_stack((rocks.x, rocks.y)))
        np.testing.assert_allclose(rocks.base, on, atol=1e-5)
    rise = [relief.z[:, 2:] - relief.z[:, :-2] for relief, _ in patches]
    slope = np.sqrt(2.0 * np.mean(np.square(rise)))  # both directions, 1 m apart
    assert slope == pytest.approx(np.tan(PRIOR.rms_slope), rel=0.15)


def test_the_covariance_is_that_of_fractal_relief():
    prior = PatchPrior(cover=0.0, rms_slope=np.deg2rad(4.0), terrain_size=40.0)
    grid = Grid.centred((0.0, 0.0), 4.0, prior.posting)
    covariance = prior.relief_covariance(grid)
    rng, whole = np.random.default_rng(8), Grid.centred((0.0, 0.0), 40.0, prior.posting)
    drawn = [
        fractal_relief(whole, rng, hurst=prior.hurst, rms_slope=prior.rms_slope).z
        for _ in range(60)
    ]
    for lag in (1, 2, 4, 7):
        found = np.mean([(z[:, lag:] - z[:, :-lag]).astype(float).var() for z in drawn])
        expected = 2.0 * (covariance[0, 0] - covariance[0, lag])
        assert found == pytest.approx(expected, rel=0.1), lag


def test_without_rocks_the_relief_has_the_mean_and_variance_of_kriging():
    rng = np.random.default_rng(7)
    prior = PatchPrior(cover=0.0, rms_slope=np.deg2rad(5.0), posting=0.5)
    grid = Grid.centred((0.0, 0.0), 2.0 * HALF + 1.0, 0.5)
    covariance = prior.relief_covariance(grid)
    inside = np.flatnonzero((np.abs(grid.centres()) < HALF).all(axis=-1).ravel())
    known = rng.choice(inside, 6, replace=False)
    z = rng.normal(0.0, 0.3, 6)
    points = np.column_stack((grid.centres().reshape(-1, 2)[known], z - np.median(z)))
    gain = np.linalg.solve(
        covariance[np.ix_(known, known)] + 0.05**2 * np.eye(6), covariance[known]
    ).T
    mean, variance = gain @ points[:, 2], np.diag(covariance - gain @ covariance[known])
    drawn = np.array(
        [relief.z.ravel() for relief, _ in draw_patches(points, 0.05, prior, HALF, rng, 2000, 0, 1)]
    )
    error = np.sqrt(variance / len(drawn))
    assert (np.abs(drawn.mean(axis=0) - mean) < 5.0 * error + 1e-4).all()
    assert drawn.var(axis=0) == pytest.approx(variance, rel=0.2)


def test_few_returns_agree_with_importance_sampling():
    """The probability of a large rock, given three returns with a noise of 0.1 m."""
    rng = np.random.default_rng(2)
    prior = PatchPrior(cover=0.2, min_diameter=0.3, max_diameter=1.5, posting=1.0)
    half = 0.75
    points = np.array([[-0.2, 0.0, 0.4], [0.3, 0.2, 0.0], [0.0, -0.5, 0.05]])
    weights, large = [], []
    for _ in range(10_000):
        terrain = world(prior, half, rng)
        z = terrain.elevation(points[:, :2])
        residual = points[:, 2] - z
        # The mean elevation is unknown: the likelihood of the differences remains.
        weights.append(np.exp(-0.5 * ((residual - residual.mean()) ** 2).sum() / 0.1**2))
        large.append(len(terrain.rocks) > 0)
    expected = np.average(large, weights=weights)
    drawn = [
        len(rocks) > 0
        for _ in range(8)
        for _, rocks in draw_patches(points, 0.1, prior, half, rng, 500, 200, 20)
    ]
    assert np.mean(large) < expected - 0.05
    assert np.mean(drawn) == pytest.approx(expected, abs=0.02)


def test_true_numbers_of_rocks_have_uniform_ranks_among_posterior_draws():
    """Simulation-based calibration (Talts et al. 2018) with hidden and with visible rocks."""
    ranks, spread = [], []
    for n in range(40):
        rng = np.random.default_rng([3, n])
        terrain = world(PRIOR, HALF, rng)
        scan = returns(terrain, HALF, 0.15 if n % 2 else 0.4, 0.02, rng)
        drawn = np.array(
            [
                large_rocks(rocks)
                for _, rocks in draw_patches(scan, 0.02, PRIOR, HALF, rng, 20, 1500, 40)
            ]
        )
        true = large_rocks(terrain.rocks)
        ranks.append((drawn < true).mean() + 0.5 * (drawn == true).mean())
        spread.append(drawn.std())
    # Uniform ranks have a standard deviation of at most 0.29; ties reduce it.
    assert abs(np.mean(ranks) - 0.5) < 3.0 * 0.29 / np.sqrt(len(ranks))
    assert np.std(ranks) < 0.33
    # Dense scans determine the number of large rocks more closely.
    assert np.mean(spread[1::2]) < 0.7 * np.mean(spread[::2])


def test_safety_of_a_flat_site_and_of_one_with_a_rock():
    lander, rng = Lander(), np.random.default_rng(4)
    prior = PatchPrior(cover=0.01, rms_slope=np.deg2rad(1.0))
    half = 3.5
    grid = Grid.centred((0.0, 0.0), 8.0, 0.5)
    flat = Heightfield(grid, np.full(grid.shape, -300.0, np.float32))
    rock = RockField.hemispheres([0.5], [0.2], [-300.0], [0.45])
    found = []
    for rocks in (RockField.empty(), rock):
        scan = returns(Terrain(flat, rocks), half, 0.25, 0.01, rng)
        found.append(
            posterior_safety(scan, 0.01, prior, lander, rng, chains=2, samples=10, moves=2000)
        )
    assert found[0].p_safe > 0.9
    assert found[1].p_safe == 0.0
    assert found[1].chains.tolist() == [0.0, 0.0]
    assert np.isnan(found[1].effective_samples)


def test_same_generator_same_draws():
    points = np.array([[0.0, 0.0, 0.2], [0.5, 0.5, 0.0]])
    first, second = (
        draw_patches(points, 0.05, PRIOR, HALF, np.random.default_rng(5), 3, 500, 3)
        for _ in range(2)
    )
    for (relief, rocks), (again, others) in zip(first, second, strict=True):
        assert np.array_equal(relief.z, again.z) and np.array_equal(rocks.a, others.a)


def test_effective_samples_of_independent_and_of_correlated_chains():
    rng = np.random.default_rng(6)
    noise = rng.standard_normal((4, 500))
    assert effective_samples(noise) > 1200
    walk = np.zeros_like(noise)
    for n in range(1, 500):
        walk[:, n] = 0.9 * walk[:, n - 1] + noise[:, n]
    # (1 - 0.9) / (1 + 0.9) of 2000.
    assert effective_samples(walk) == pytest.approx(105.0, rel=0.5)
    # Chains that disagree count as few samples.
    assert effective_samples(noise + np.array([[0.0], [5.0], [0.0], [5.0]])) < 20
    assert np.isnan(effective_samples(np.ones((2, 5))))


def test_bad_priors_are_named():
    for name, value in (("min_diameter", 0.0), ("max_diameter", 0.1), ("cover", 0.6)):
        with pytest.raises(InputError, match=name):
            PatchPrior(**{name: value})
