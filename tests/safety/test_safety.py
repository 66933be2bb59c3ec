from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards import HazardMap
from lunarsim.safety import (
    alhat_safety,
    bounded_safety,
    conservative_safety,
    exact_safety,
    footprint_of,
    plane_stochastic_safety,
    safe_sites,
    stochastic_safety,
)
from tests.reference import safety as reference

SMALL = Lander(leg_radius=1.1, pad_diameter=0.45)
THREE = Lander(leg_radius=1.1, pad_diameter=0.45, legs=3)


def terrain(seed: int, roughness: float, cells: int = 24, posting: float = 0.2):
    rng = np.random.default_rng(seed)
    grid = Grid.centred((0.0, 0.0), cells * posting, posting)
    z = roughness * rng.standard_normal(grid.shape)
    return z.astype(np.float32), grid


@pytest.mark.parametrize(
    ("lander", "posting"),
    [(lander, p) for lander in (SMALL, THREE) for p in (0.1, 0.2)]
    + [(lander, p) for lander in (Lander(), Lander(legs=3)) for p in (0.1, 0.2, 0.5)],
    ids=lambda v: f"{v.legs}x{v.leg_radius}" if isinstance(v, Lander) else str(v),
)
def test_footprints_hold_every_heading(lander, posting):
    footprint = footprint_of(lander, posting)
    plain = {tuple(sorted(c)) for c in reference.leg_cells(lander, posting)}
    ours = {tuple(sorted(map(tuple, cells.tolist()))) for cells in footprint.legs}
    assert ours == plain


@pytest.mark.parametrize("lander", [SMALL, THREE], ids=["four", "three"])
@pytest.mark.parametrize("seed", range(3))
def test_exact_safety_agrees_with_the_plain_reference(lander, seed):
    z, grid = terrain(seed, 0.08)
    ours = exact_safety(z, grid, lander)
    rng = np.random.default_rng(seed)
    cells = np.argwhere(ours.observed)
    for row, col in rng.permutation(cells)[:6]:
        slope, roughness = reference.exact(z, grid, lander, row, col)
        assert ours.slope[row, col] == pytest.approx(slope, abs=2e-5)
        assert ours.roughness[row, col] == pytest.approx(roughness, abs=2e-5)


def grounds(grid: Grid) -> dict:
    """Ground that pruning goes by: smooth and sloping, stepped, with rocks, with a spike."""
    rng = np.random.default_rng(2)
    x, y = np.meshgrid(grid.x, grid.y)
    flat = np.zeros(grid.shape)
    spike = 0.1 * x
    spike[20, 30] = 1e3
    return {
        "tilt": np.tan(np.deg2rad(12.0)) * x - 0.1 * y,
        "dome": -(x**2 + y**2) / 40.0,
        "saddle": 0.3 * x + (x**2 - y**2) / 20.0,
        "ripples": 0.05 * np.cos(4.0 * x + y),
        "terraces": 0.1 * np.floor(2.0 * x),
        "rocks on a dome": -(x**2) / 30.0 + np.where(rng.random(grid.shape) < 0.03, 0.3, 0.0),
        "cliff": np.where(x > 0.3, 40.0, 0.0),
        "spike": spike,
        "level": flat + 2.0e-4 * rng.standard_normal(grid.shape),
    }


@pytest.mark.parametrize("legs", [3, 4])
@pytest.mark.parametrize("name", list(grounds(Grid.centred((0.0, 0.0), 4.0, 0.1))))
def test_no_terrain_is_passed_over(name, legs):
    """What is skipped would not have counted, whatever the ground's shape."""
    grid = Grid.centred((0.0, 0.0), 5.2, 0.1, 4.4)
    z = grounds(grid)[name]
    lander = Lander(leg_radius=0.9, pad_diameter=0.3, legs=legs)
    ours = exact_safety(z, grid, lander)
    single = bounded_safety(z, grid, lander, block_side=1e-3)
    rise = conservative_safety(z, grid, lander).roughness
    seen = ours.observed
    scale = 1e-5 + 1e-5 * np.abs(z).max()
    # Blocks of one cell go through every cell; the level bound may lie lower by rounding alone.
    assert np.allclose(ours.roughness[seen], single.roughness[seen], rtol=1e-5, atol=scale)
    assert np.all(ours.roughness[seen] <= rise[seen] + scale)
    for row, col in np.random.default_rng(0).permutation(np.argwhere(seen))[:2]:
        slope, roughness = reference.exact(z, grid, lander, row, col)
        assert ours.slope[row, col] == pytest.approx(slope, abs=2e-5)
        assert ours.roughness[row, col] == pytest.approx(roughness, rel=1e-5, abs=2e-5)


@pytest.mark.parametrize("lander", [SMALL, THREE], ids=["four", "three"])
def test_conservative_bounds_agree_with_the_plain_reference(lander):
    z, grid = terrain(5, 0.05)
    ours = conservative_safety(z, grid, lander)
    for row, col in np.random.default_rng(1).permutation(np.argwhere(ours.observed))[:8]:
        high, low, body, least = reference.extremes(z, grid, lander, row, col)
        ratio = (high - low) / least
        slope = np.arcsin(ratio) if ratio < 1.0 else np.pi / 2
        assert ours.slope[row, col] == pytest.approx(slope, abs=1e-5)
        assert ours.roughness[row, col] == pytest.approx(body - low, abs=1e-5)


@settings(max_examples=30)
@given(
    st.integers(0, 10_000),
    st.sampled_from([3, 4]),
    st.floats(0.5, 1.4),
    st.sampled_from([0.1, 0.2, 0.25]),
    st.floats(0.001, 0.15),
    st.floats(0.0, 0.2),
)
def test_conservative_never_calls_an_unsafe_site_safe(seed, legs, radius, posting, rough, tilt):
    """Proposition III.1, on random terrain and landers."""
    lander = Lander(legs=legs, leg_radius=radius, pad_diameter=0.3)
    z, grid = terrain(seed, rough, 36, posting)
    z = (z + tilt * grid.x[None, :]).astype(np.float32)
    exact = exact_safety(z, grid, lander)
    bound = conservative_safety(z, grid, lander)
    seen = exact.observed
    assert not np.any(bound.safe & ~exact.safe)
    assert np.all(bound.slope[seen] >= exact.slope[seen] - 1e-5)
    assert np.all(bound.roughness[seen] >= exact.roughness[seen] - 1e-5)


@settings(max_examples=30)
@given(
    st.integers(0, 10_000),
    st.sampled_from([3, 4]),
    st.floats(0.6, 1.4),
    st.sampled_from([0.1, 0.2]),
    st.floats(0.001, 0.15),
    st.floats(0.0, 0.25),
    st.floats(0.1, 0.9),
)
def test_bounded_never_calls_an_unsafe_site_safe(seed, legs, radius, posting, rough, tilt, side):
    lander = Lander(legs=legs, leg_radius=radius, pad_diameter=0.3)
    z, grid = terrain(seed, rough, 40, posting)
    z = (z + tilt * grid.x[None, :] - 0.5 * tilt * grid.y[:, None]).astype(np.float32)
    exact = exact_safety(z, grid, lander)
    bound = bounded_safety(z, grid, lander, block_side=side)
    seen = exact.observed
    assert np.array_equal(bound.observed, seen)
    assert not np.any(bound.safe & ~exact.safe)
    assert np.allclose(bound.slope[seen], exact.slope[seen], atol=1e-5)
    assert np.all(bound.roughness[seen] >= exact.roughness[seen] - 1e-5)


@pytest.mark.parametrize("legs", [3, 4])
def test_blocks_of_one_cell_are_exact(legs):
    lander = Lander(legs=legs, leg_radius=1.1)
    z, grid = terrain(6, 0.07)
    exact, bound = exact_safety(z, grid, lander), bounded_safety(z, grid, lander, block_side=0.05)
    assert np.allclose(bound.roughness, exact.roughness, atol=1e-5, equal_nan=True)
    assert np.array_equal(bound.safe, exact.safe)


def test_bounded_keeps_safe_sites_on_a_slope():
    """Where the level plane of the conservative test gives up."""
    grid = Grid.centred((0.0, 0.0), 12.0, 0.1)
    z = 0.1 * grid.x[None, :] + 0.02 * np.random.default_rng(0).standard_normal(grid.shape)
    exact = exact_safety(z, grid, Lander())
    recall = {
        test.__name__: (test(z, grid, Lander()).safe & exact.safe).sum() / exact.safe.sum()
        for test in (bounded_safety, conservative_safety)
    }
    assert recall["conservative_safety"] < 0.05
    assert recall["bounded_safety"] > 0.8


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.sampled_from([3, 4]), st.floats(0.005, 0.1))
def test_deciding_alone_agrees_with_the_full_map(seed, legs, rough):
    lander = Lander(legs=legs, leg_radius=1.1)
    z, grid = terrain(seed, rough, 26)
    z[3, 20] = np.nan
    exact = exact_safety(z, grid, lander)
    safe, observed = safe_sites(z, grid, lander)
    assert np.array_equal(safe, exact.safe)
    assert np.array_equal(observed, exact.observed)
    where = np.random.default_rng(seed).random(z.shape) < 0.2
    safe, observed = safe_sites(z, grid, lander, where=where)
    assert np.array_equal(safe, exact.safe & where)
    assert np.array_equal(observed, exact.observed & where)


@given(st.integers(0, 1000), st.floats(-300.0, 300.0))
def test_height_does_not_matter(seed, dz):
    z, grid = terrain(seed, 0.03)
    a, b = exact_safety(z, grid, SMALL), exact_safety(z + np.float32(dz), grid, SMALL)
    assert np.allclose(a.slope, b.slope, atol=2e-3, equal_nan=True)


@pytest.mark.parametrize("legs", [3, 4])
def test_quarter_turns_of_the_terrain(legs):
    lander = Lander(legs=legs, leg_radius=1.1)
    z, grid = terrain(3, 0.05)
    a = conservative_safety(z, grid, lander)
    b = conservative_safety(np.ascontiguousarray(np.rot90(z)), grid, lander)
    assert np.allclose(np.rot90(a.roughness), b.roughness, atol=1e-6, equal_nan=True)
    if legs == 4:
        e, f = exact_safety(z, grid, lander), exact_safety(np.rot90(z).copy(), grid, lander)
        assert np.allclose(np.rot90(e.slope), f.slope, atol=1e-5, equal_nan=True)


def test_planes_have_their_slope_at_every_heading():
    grid = Grid.centred((0.0, 0.0), 8.0, 0.1)
    z = (np.tan(np.deg2rad(7.0)) * grid.x[None, :] * np.ones((grid.rows, 1))).astype(np.float32)
    lander = Lander(pad_diameter=0.01)
    exact = exact_safety(z, grid, lander)
    assert np.allclose(np.rad2deg(exact.slope[exact.observed]), 7.0, atol=0.01)
    assert np.abs(exact.roughness[exact.observed]).max() < 1e-3


def test_edges_and_unknown_terrain_are_unobserved():
    z, grid = terrain(1, 0.01)
    z[12, 12] = np.nan
    for result in (exact_safety(z, grid, SMALL), conservative_safety(z, grid, SMALL)):
        reach = footprint_of(SMALL, grid.posting).reach
        assert not result.observed[:reach].any()
        assert not result.observed[:, -reach:].any()
        assert not result.observed[12, 12]
        assert not (result.safe & ~result.observed).any()
        assert np.isnan(result.slope[12, 12])


def test_certain_maps_give_certain_answers():
    z, grid = terrain(7, 0.02)
    bound = conservative_safety(z, grid, SMALL)
    p = stochastic_safety(z, np.zeros_like(z), grid, SMALL)
    assert np.array_equal(p.p_safe > 0.5, bound.safe)
    assert set(np.unique(p.p_safe)) <= {0.0, 1.0}


def test_probabilities_are_eq_17():
    z, grid = terrain(8, 0.02)
    sigma = np.float32(0.03)
    p = stochastic_safety(z, np.full_like(z, sigma**2), grid, SMALL)
    for row, col in np.argwhere(p.observed)[::17]:
        high, low, body, least = reference.extremes(z, grid, SMALL, row, col)
        spread = sigma * np.sqrt(2.0)
        slope = norm.cdf((least * np.sin(SMALL.slope_limit) - (high - low)) / spread)
        rough = norm.cdf((SMALL.roughness_limit - (body - low)) / spread)
        assert p.p_slope[row, col] == pytest.approx(slope, abs=1e-4)
        assert p.p_roughness[row, col] == pytest.approx(rough, abs=1e-4)
        assert p.p_safe[row, col] == pytest.approx(slope * rough, abs=2e-4)
    tangent = stochastic_safety(z, np.full_like(z, sigma**2), grid, SMALL, slope_bound="tan")
    assert np.all(tangent.p_slope >= p.p_slope)


def test_planes_of_a_certain_map_are_the_bounded_test():
    z, grid = terrain(9, 0.04)
    bound = bounded_safety(z, grid, SMALL)
    p = plane_stochastic_safety(z, np.zeros_like(z), grid, SMALL)
    assert np.array_equal(p.p_safe > 0.5, bound.safe)
    assert np.array_equal(p.observed, bound.observed)


@pytest.mark.parametrize("sigma", [0.01, 0.03])
def test_planes_promise_no_more_than_sampled_maps_keep(sigma):
    """Monte Carlo over maps drawn from the Gaussian DEM, judged by the exact test."""
    z, grid = terrain(11, 0.03, 30)
    z = (z + 0.08 * grid.x[None, :]).astype(np.float32)
    variance = np.full_like(z, sigma**2)
    rng = np.random.default_rng(0)
    draws = [
        exact_safety(z + sigma * rng.standard_normal(z.shape), grid, SMALL).safe for _ in range(60)
    ]
    share = np.mean(draws, axis=0)
    ours = plane_stochastic_safety(z, variance, grid, SMALL)
    seen = ours.observed
    called = seen & (ours.p_safe > 0.9)
    assert called.sum() > 0
    assert share[called].mean() > 0.9
    # The level plane of Eqs. 15 to 17 gives up on this slope.
    level = stochastic_safety(z, variance, grid, SMALL)
    assert np.abs(ours.p_safe - share)[seen].mean() < np.abs(level.p_safe - share)[seen].mean()


def test_alhat_is_the_exact_map_with_noise():
    z, grid = terrain(4, 0.06)
    exact, p = exact_safety(z, grid, SMALL), alhat_safety(z, grid, SMALL, sigma=0.02)
    row, col = np.argwhere(exact.observed)[7]
    slope, roughness = reference.exact(z, grid, SMALL, row, col)
    assert p.p_slope[row, col] == float(slope < SMALL.slope_limit)
    wanted = norm.cdf((SMALL.roughness_limit - roughness) / 0.02)
    assert p.p_roughness[row, col] == pytest.approx(wanted, abs=1e-3)
    assert np.array_equal(p.p_safe > 0.5, exact.safe)
    with pytest.raises(ValueError, match="sigma"):
        alhat_safety(z, grid, SMALL, sigma=0.0)


def test_bad_input():
    z, grid = terrain(1, 0.01)
    with pytest.raises(ValueError, match="shape"):
        exact_safety(z[:-1], grid, SMALL)
    tiny = Grid.centred((0.0, 0.0), 2.0, 0.2)
    with pytest.raises(ValueError, match="rows and columns, the size of the lander"):
        exact_safety(np.zeros(tiny.shape), tiny, SMALL)
    with pytest.raises(ValueError, match="must be 0 or more"):
        stochastic_safety(z, np.full_like(z, -1.0), grid, SMALL)
    with pytest.raises(ValueError, match="must be 0 or more"):
        plane_stochastic_safety(z, np.full_like(z, -1.0), grid, SMALL)
    with pytest.raises(ValueError, match="block_side"):
        bounded_safety(z, grid, SMALL, block_side=0.0)
    with pytest.raises(ValueError, match=r"grid\.posting: must be less"):
        footprint_of(SMALL, 2.0)


def test_aiming_at_a_site_spreads_the_probability():
    grid = Grid.centred((0.0, 0.0), 20.0, 0.2)
    p = np.where(grid.x[None, :] > 0.0, 1.0, 0.0) * np.ones((grid.rows, 1))
    hazard_map = HazardMap(grid, p.astype(np.float32), np.ones(grid.shape, bool))
    aim = hazard_map.dispersed_p_safe(0.5)
    middle = aim[grid.rows // 2]
    assert np.allclose(middle[20:-20], norm.cdf(grid.x[20:-20] / 0.5), atol=0.02)
    assert np.array_equal(hazard_map.dispersed_p_safe(0.0), hazard_map.p_safe)
    assert hazard_map.p_safe_at([50.0, 0.0]) == 0.0
    with pytest.raises(ValueError, match="shape"):
        HazardMap(grid, np.zeros((2, 2), np.float32), np.ones(grid.shape, bool))
