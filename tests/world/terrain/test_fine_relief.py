"""Roughness below the posts of procedural relief."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.rng import RandomStreams
from lunarsim.scenario import Scenario
from lunarsim.world.terrain import add_fine_roughness, fractal_relief

HURST, SLOPE = 0.8, np.radians(4.0)


def roughness(z, lag):
    """Root mean square of second differences over a lag in posts, along both axes."""
    along = z[:, 2 * lag :] - 2.0 * z[:, lag:-lag] + z[:, : -2 * lag]
    across = z[2 * lag :] - 2.0 * z[lag:-lag] + z[: -2 * lag]
    return np.sqrt(0.5 * (np.mean(along**2) + np.mean(across**2)))


@pytest.fixture(scope="module")
def coarse():
    grid = Grid.centred((0.0, 0.0), 100.0, 0.4)
    return fractal_relief(grid, np.random.default_rng(1), hurst=HURST, rms_slope=SLOPE)


@pytest.fixture(scope="module")
def fine(coarse):
    rng = np.random.default_rng(2)
    return add_fine_roughness(coarse, 0.1, rng, hurst=HURST, rms_slope=SLOPE)


def test_terrain_is_as_rough_below_its_posts_as_its_law_says(coarse, fine):
    """Second differences of self-affine relief grow with the lag to the power H."""
    z = fine.z.astype(float)
    assert fine.grid.posting == pytest.approx(0.1)
    # Lags of 0.1 to 0.8 m, across the posting of 0.4 m; cubic splines alone fall off faster.
    smooth = coarse.refined(0.1).z.astype(float)
    expected = roughness(coarse.z.astype(float), 4) / 4.0**HURST
    for lag in (1, 2, 4):
        law = expected * (lag / 4.0) ** HURST
        assert roughness(z, lag) == pytest.approx(law, rel=0.2)
    assert roughness(smooth, 1) < 0.5 * expected / 4.0**HURST


def test_the_terrain_stays_where_it_was(coarse, fine):
    off = fine.z[::4, ::4] - coarse.z
    assert np.std(off) < 0.02 < 0.1 * np.std(coarse.z)


def test_posts_that_are_no_finer_are_refused(coarse):
    rng = np.random.default_rng(0)
    for posting in (0.0, 0.5, float("nan")):
        with pytest.raises(InputError, match=r"terrain\.detail"):
            add_fine_roughness(coarse, posting, rng, hurst=HURST, rms_slope=SLOPE)


def test_a_scenario_with_detail_is_the_same_terrain_nearer():
    told = {"terrain": {"preset": "highland", "size_m": 60.0, "posting_m": 0.25, "detail_m": 0.0}}
    grounds = [
        s.terrain.make().build(s.rocks.make(), RandomStreams(1))
        for s in (
            Scenario.from_dict(told),
            Scenario.from_dict(told).changed(terrain={"detail_m": 0.0625}),
        )
    ]
    coarse, fine = (g.relief for g in grounds)
    assert fine.grid.posting == pytest.approx(0.0625)
    apart = fine.z[::4, ::4] - coarse.z
    assert np.std(apart - apart.mean()) < 0.15 * np.std(coarse.z)
    # Craters of 0.25 to 2 m as well: as many more as make it rougher than the law of relief alone.
    assert roughness(fine.z.astype(float), 2) > 1.5 * roughness(
        coarse.refined(0.0625).z.astype(float), 2
    )


@pytest.mark.parametrize("detail", [0.25, 0.5, 1e-4])
def test_detail_must_be_finer_than_the_posts_and_fit_the_memory(detail):
    scenario = {"terrain": {"size_m": 60.0, "posting_m": 0.25, "detail_m": detail}}
    with pytest.raises(InputError):
        Scenario.from_dict(scenario).terrain.make()
