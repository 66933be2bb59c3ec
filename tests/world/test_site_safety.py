"""Safety of sites on the terrain itself, and its use as the truth of maps and flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim import Grid, Heightfield, Terrain, exact_safety
from lunarsim.api import Lander
from lunarsim.errors import InputError
from lunarsim.rocks.field import RockModel
from lunarsim.safety import safe_sites
from lunarsim.world import World
from lunarsim.world.site_safety import site_safety
from lunarsim.world.terrain import fractal_relief, place_rocks
from lunarsim.world.truth import TerrainTruth
from tests.reference import safety as reference

LANDER = Lander(leg_radius=0.8, pad_diameter=0.25)


def rocky(side: float = 16.0, seed: int = 0, count: int = 80) -> Terrain:
    rng, grid = np.random.default_rng(seed), Grid.centred((0.0, 0.0), side, 0.25)
    relief = fractal_relief(grid, rng, hurst=0.85, rms_slope=np.deg2rad(4.0))
    diameters = rng.uniform(0.15, 0.7, count)
    return Terrain(relief, place_rocks(relief, diameters, rng, model=RockModel("mixed")))


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    return rocky()


@pytest.mark.parametrize("legs", [3, 4])
@pytest.mark.parametrize("stride", [2, 3, 4])
def test_sites_apart_have_the_safety_of_the_complete_raster(terrain, stride, legs):
    """In windows of grouped columns, sites read the same cells as without a stride."""
    grid = Grid.centred((0.3, -0.2), 13.0, 0.08, 11.0)
    z, lander = terrain.raster(grid), replace(LANDER, legs=legs)
    z[60:64, 70] = np.nan
    expected = exact_safety(z, grid, lander)
    assert 0.1 < expected.safe[expected.observed].mean() < 0.9
    for where in (None, np.random.default_rng(1).random(z[::stride, ::stride].shape) < 0.1):
        safe, observed = safe_sites(z, grid, lander, where=where, stride=stride)
        every = np.ones(safe.shape, bool) if where is None else where
        assert np.array_equal(observed, expected.observed[::stride, ::stride] & every)
        assert np.array_equal(safe, expected.safe[::stride, ::stride] & every)


def test_sites_agree_with_the_plain_reference(terrain):
    """The reference goes over every cell under the lander, at the posting of the samples."""
    sites = Grid.centred((0.0, 0.0), 8.0, 0.2)
    safe, observed = site_safety(terrain, sites, LANDER, posting=0.1)
    assert observed.all() and 0.1 < safe.mean() < 0.9
    fine = Grid(sites.x0 - 1.6, sites.y0 - 1.6, 0.1, 2 * sites.rows + 31, 2 * sites.cols + 31)
    z = terrain.raster(fine)
    for row, col in np.random.default_rng(3).integers(0, sites.rows, (12, 2)):
        slope, roughness = reference.exact(z, fine, LANDER, 2 * row + 16, 2 * col + 16)
        assert safe[row, col] == (slope < LANDER.slope_limit and roughness < LANDER.roughness_limit)


def test_blocks_of_sites_do_not_matter(terrain):
    """More sites than one block, a part of them, and one alone have the same safety."""
    sites = Grid.centred((0.0, 0.0), 12.0, 0.08)
    assert sites.rows > 128
    safe, observed = site_safety(terrain, sites, LANDER)
    where = np.zeros(sites.shape, bool)
    where[100:140, 100:150] = True
    part, seen = site_safety(terrain, sites, LANDER, where=where)
    assert np.array_equal(seen, where) and np.array_equal(part, safe & where)
    one = Grid(float(sites.x[129]), float(sites.y[127]), 0.08, 1, 1)
    assert site_safety(terrain, one, LANDER)[0][0, 0] == safe[127, 129]
    assert observed.all()


def test_a_rock_between_coarse_samples_counts():
    """A rock 0.3 m high and wide at (0.1, 0.1): samples 0.2 m apart miss its top."""
    flat = Heightfield(Grid.centred((0.0, 0.0), 12.0, 0.5), np.zeros((24, 24), np.float32))
    model = RockModel("cube", (1.0, 0.0), (0.0, 0.0), (1.0, 1.0))
    rocks = place_rocks(flat, np.full(40, 0.3), np.random.default_rng(2), model=model)
    terrain, lander = Terrain(flat, rocks), replace(LANDER, roughness_limit=0.2)
    sites = Grid.centred((0.0, 0.0), 8.0, 0.2)
    coarse = site_safety(terrain, sites, lander, posting=0.2)[0]
    fine, finer = (site_safety(terrain, sites, lander, posting=p)[0] for p in (0.05, 0.025))
    assert (coarse & ~finer).sum() > 4 * (fine & ~finer).sum() + 4


def test_one_heading_is_safe_where_all_are(terrain):
    sites = Grid.centred((0.0, 0.0), 6.0, 0.2)
    every = site_safety(terrain, sites, LANDER)[0]
    one = site_safety(terrain, sites, LANDER, heading=0.3)[0]
    assert one[every].all() and one.sum() > every.sum()
    with pytest.raises(InputError, match="heading"):
        site_safety(terrain, sites, LANDER, heading=np.nan)


def test_beyond_the_terrain_nothing_is_known(terrain):
    sites = Grid.centred((8.0, 0.0), 4.0, 0.2)
    safe, observed = site_safety(terrain, sites, LANDER)
    inside = np.broadcast_to(sites.x < 8.0 - 1.1, observed.shape)
    assert observed[inside].all() and not observed[:, sites.x > 7.3].any()
    assert not (safe & ~observed).any()


def test_legs_far_apart_use_coarser_samples():
    """Otherwise a footprint would have too many cells."""
    flat = Terrain(Heightfield(Grid.centred((0.0, 0.0), 80.0, 1.0), np.zeros((80, 80), np.float32)))
    wide = replace(LANDER, leg_radius=14.0, pad_diameter=1.0)
    safe, observed = site_safety(flat, Grid.centred((0.0, 0.0), 2.0, 1.0), wide)
    assert safe.all() and observed.all()


def test_the_truth_of_a_point_is_that_of_its_nearest_site(terrain):
    truth = TerrainTruth.of(World(terrain, 1.622), LANDER)
    window = truth.within((-3.0, 3.0, -2.0, 2.0))
    xy = window.grid.centres()
    safe, observed = site_safety(terrain, window.grid, LANDER)
    assert np.array_equal(window.safe, safe) and np.array_equal(window.observed, observed)
    fresh = TerrainTruth.of(World(terrain, 1.622), LANDER)
    nudge = np.random.default_rng(0).uniform(-0.09, 0.09, xy.shape)
    assert np.array_equal(fresh.is_safe_at(xy + nudge), safe)
    assert fresh.is_safe_at(xy[3, 4]) == safe[3, 4]
    assert window.elevation == pytest.approx(terrain.raster(window.grid))
    assert not fresh.is_safe_at([100.0, 0.0]) and not fresh.is_known_at([100.0, 0.0])
    assert fresh.is_known_at([0.0, 0.0])


def test_a_large_part_keeps_sites_that_coincide_with_other_parts(terrain):
    truth = TerrainTruth.of(World(terrain, 1.622), LANDER)
    wide = truth.within((-6.0, 6.0, -6.0, 6.0), max_cells=20)
    assert max(wide.safe.shape) <= 20
    for shift in (0.2, 0.4, 0.6, 0.8):
        shifted = truth.within((-6.0 + shift, 6.0 + shift, -6.0, 6.0), max_cells=20)
        common = np.isin(np.round(shifted.grid.x, 6), np.round(wide.grid.x, 6))
        assert common.sum() >= len(common) - 2
    assert np.array_equal(truth.is_safe_at(wide.grid.centres()), wide.safe)


def test_the_safe_fraction_is_that_of_the_sites_in_the_rectangle(terrain):
    truth = TerrainTruth.of(World(terrain, 1.622), LANDER)
    window = truth.within((-2.0, 3.0, -1.0, 2.0))
    found = truth.safe_fraction((0.5, 0.5), (2.5, 1.5))
    assert found == pytest.approx(window.safe.mean())
    assert truth.safe_fraction((0.5, 0.5), (2.5, 1.5), heading=0.0) >= found
    assert np.isnan(truth.safe_fraction((100.0, 0.0), (1.0, 1.0)))
