"""Stochastic safety, by level planes and by real ones, against loops over cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.safety import (
    bounded_safety,
    conservative_safety,
    exact_safety,
    footprint_of,
    plane_stochastic_safety,
    stochastic_safety,
)
from tests.reference import safety as reference

LANDERS = [
    (Lander(leg_radius=1.1, pad_diameter=0.45), 0.2),
    (Lander(leg_radius=1.1, pad_diameter=0.45, legs=3), 0.2),
    (Lander(leg_radius=0.7, pad_diameter=0.3, roughness_limit=0.15), 0.1),
    (Lander(leg_radius=2.35, pad_diameter=0.6, legs=3, slope_limit=np.deg2rad(14.0)), 0.4),
]
IDS = [f"{lander.legs} legs, {posting} m" for lander, posting in LANDERS]


def gaussian_map(seed: int, lander: Lander, posting: float, tilt: float):
    """Mean, variance and grid: rough ground, a tilt, and deviations that differ by cell."""
    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), 30 * posting, posting)
    mean = rng.uniform(0.005, 0.04) * rng.standard_normal(grid.shape) + tilt * grid.x[None, :]
    sigma = rng.uniform(0.002, 0.02) * np.exp(0.7 * rng.standard_normal(grid.shape))
    return mean.astype(np.float32), (sigma**2).astype(np.float32), grid


def some_sites(observed: np.ndarray, seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).permutation(np.argwhere(observed))[:count]


@pytest.mark.parametrize(("lander", "posting"), LANDERS, ids=IDS)
@pytest.mark.parametrize("bound", ["sin", "tan"])
def test_eqs_15_to_17_agree_with_the_plain_reference(lander, posting, bound):
    between = 0
    for seed, tilt in ((1, 0.0), (2, 0.03), (3, 0.06)):
        mean, variance, grid = gaussian_map(seed, lander, posting, tilt)
        ours = stochastic_safety(mean, variance, grid, lander, slope_bound=bound)
        for row, col in some_sites(ours.observed, seed, 3):
            slope, rough = reference.stochastic(
                mean, variance, grid, lander, row, col, getattr(math, bound)
            )
            assert ours.p_slope[row, col] == pytest.approx(slope, abs=2e-5)
            assert ours.p_roughness[row, col] == pytest.approx(rough, abs=2e-5)
            assert ours.p_safe[row, col] == pytest.approx(slope * rough, abs=4e-5)
            between += (0.001 < slope < 0.999) + (0.001 < rough < 0.999)
    assert between >= 3  # certain answers show nothing


@pytest.mark.parametrize(("lander", "posting"), LANDERS, ids=IDS)
def test_real_planes_agree_with_the_plain_reference(lander, posting):
    """Blocks of one cell, so that no cover of a polygon stands between."""
    between = 0
    for seed, tilt in ((4, 0.05), (5, 0.10), (6, 0.14)):
        mean, variance, grid = gaussian_map(seed, lander, posting, tilt)
        ours = plane_stochastic_safety(mean, variance, grid, lander, block_side=1e-3)
        for row, col in some_sites(ours.observed, seed, 3):
            level = reference.stochastic(mean, variance, grid, lander, row, col)
            plane = reference.real_planes(mean, variance, grid, lander, row, col)
            slope, rough = (max(a, b) for a, b in zip(level, plane, strict=True))
            assert ours.p_slope[row, col] == pytest.approx(slope, abs=1e-4)
            assert ours.p_roughness[row, col] == pytest.approx(rough, abs=1e-4)
            assert ours.p_safe[row, col] == pytest.approx(slope * rough, abs=2e-4)
            between += 0.001 < plane[0] < 0.999 and plane[0] > level[0]
            between += 0.001 < plane[1] < 0.999 and plane[1] > level[1]
    assert between >= 3


@pytest.mark.parametrize(("lander", "posting"), LANDERS, ids=IDS)
def test_real_planes_promise_no_less_than_level_ones(lander, posting):
    mean, variance, grid = gaussian_map(7, lander, posting, 0.02)
    level = stochastic_safety(mean, variance, grid, lander)
    for side in (0.01, 0.5):
        real = plane_stochastic_safety(mean, variance, grid, lander, block_side=side)
        assert np.array_equal(real.observed, level.observed)
        assert np.all(real.p_slope >= level.p_slope)
        assert np.all(real.p_roughness >= level.p_roughness)


@pytest.mark.parametrize("seed", range(3))
def test_larger_blocks_promise_no_more(seed):
    posting = 0.1
    lander = Lander(leg_radius=0.7, pad_diameter=0.3, roughness_limit=0.07)
    mean, _, grid = gaussian_map(seed, lander, posting, 0.08)
    variance = np.full(grid.shape, 1e-4)
    fine = plane_stochastic_safety(mean, variance, grid, lander, block_side=posting)
    for cells in (2, 3, 5):
        coarse = plane_stochastic_safety(
            mean, variance, grid, lander, block_side=cells * posting
        ).p_roughness
        assert np.all(coarse <= fine.p_roughness + 1e-6)
        assert coarse.sum() < fine.p_roughness.sum()


TILTS = np.tan(np.deg2rad(np.arange(0.0, 20.5, 2.0)))


@pytest.mark.parametrize("bearing", [0.0, 30.0, 45.0])
@pytest.mark.parametrize("judge", [stochastic_safety, plane_stochastic_safety])
def test_no_probability_rises_with_slope(judge, bearing):
    """On planes, site by site, and on planes with stones on the whole."""
    grid = Grid.centred((0.0, 0.0), 14.0, 0.2)
    east = np.cos(np.deg2rad(bearing)) * grid.x[None, :]
    north = np.sin(np.deg2rad(bearing)) * grid.y[:, None]
    stones = np.zeros(grid.shape)
    stones[8::25, 5::25] = 0.12
    variance = np.full(grid.shape, 0.02**2)
    before = None
    for tilt in TILTS:
        z = tilt * (east + north)
        plain = judge(z, variance, grid, LANDERS[0][0])
        rough = judge(z + stones, variance, grid, LANDERS[0][0])
        now = (plain.p_slope, plain.p_roughness, plain.p_safe)
        means = [float(p[plain.observed].mean()) for p in (rough.p_slope, rough.p_safe)]
        if before is not None:
            for p, q in zip(now, before[0], strict=True):
                assert np.all(p <= q + 1e-6)
            for p, q in zip(means, before[1], strict=True):
                assert p <= q + 1e-6
        before = now, means
    assert np.all(before[0][2] < 1e-3)


@pytest.mark.parametrize("judge", [stochastic_safety, plane_stochastic_safety])
def test_no_probability_rises_with_the_height_of_stones(judge):
    lander, posting = LANDERS[0]
    grid = Grid.centred((0.0, 0.0), 50 * posting, posting)
    stones = np.random.default_rng(1).random(grid.shape) < 0.02
    before = None
    for height in np.arange(0.0, 0.5, 0.05):
        z = np.where(stones, height, 0.0) + 0.05 * grid.x[None, :]
        now = judge(z, np.full(grid.shape, 0.01**2), grid, lander)
        means = [float(p[now.observed].mean()) for p in (now.p_slope, now.p_roughness, now.p_safe)]
        if before is not None:
            assert all(p <= q + 1e-3 for p, q in zip(means, before, strict=True))
        before = means


def test_bounded_keeps_what_either_test_keeps():
    """Small stones on level ground, where the tops of blocks alone lose nearly all safe sites."""
    rng = np.random.default_rng(3)
    grid = Grid.centred((0.0, 0.0), 16.0, 0.1)
    lander = Lander()
    level = np.where(rng.random(grid.shape) < 0.01, 0.24, 0.0)
    slope = 0.1 * grid.x[None, :] + 0.02 * rng.standard_normal(grid.shape)
    for z, least in ((level, 0.99), (slope, 0.75)):
        exact = exact_safety(z, grid, lander)
        bound, cons = bounded_safety(z, grid, lander), conservative_safety(z, grid, lander)
        seen = exact.observed
        assert exact.safe.mean() > 0.1
        assert not np.any(bound.safe & ~exact.safe)
        assert not np.any(cons.safe & ~bound.safe)
        assert (bound.safe & exact.safe).sum() > least * exact.safe.sum()
        for name in ("slope", "roughness"):
            ours = getattr(bound, name)[seen]
            assert np.all(ours <= getattr(cons, name)[seen])
            assert np.all(ours >= getattr(exact, name)[seen] - 1e-5)


def test_the_spread_of_the_legs_is_that_of_terrain_under_pads():
    """One uncertain cell matters to the sites whose pads touch it, and to no other."""
    lander, posting = LANDERS[0]
    grid = Grid.centred((0.0, 0.0), 40 * posting, posting)
    variance = np.full(grid.shape, 1e-6)
    variance[20, 20] = 0.05**2
    z = np.tan(np.deg2rad(9.0)) * grid.x[None, :] * np.ones(grid.shape)
    p = plane_stochastic_safety(z, variance, grid, lander).p_slope
    pads, corners = reference.pad_cells(lander, posting), reference.leg_cells(lander, posting, 4000)
    touched = {(20 - r - a, 20 - c - b) for legs in corners for r, c in legs for a, b in pads}
    reach = footprint_of(lander, posting).reach
    for row in range(reach, grid.rows - reach):
        for col in range(reach, grid.cols - reach):
            assert (p[row, col] < 0.99) == ((row, col) in touched)
