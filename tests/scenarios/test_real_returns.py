"""Airborne returns in both LiDAR maps, and their evaluation on known terrain."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.gaussian_dem import GaussianDem
from lunarsim.studies import report_study, run_study

GRADIENT = (0.3, -0.2)


def plane(xy):
    return 5.0 + xy[..., 0] * GRADIENT[0] + xy[..., 1] * GRADIENT[1]


@pytest.fixture
def scattered():
    """Points on a tilted plane without errors."""
    xy = np.random.default_rng(3).uniform(-20.0, 20.0, (4000, 2))
    return np.column_stack((xy, plane(xy)))


def test_cloud_split_and_spacing(script):
    returns = script("real_returns", "returns")
    cloud = returns.load()
    assert len(cloud.points) == 35_318
    assert cloud.spacing(1.0) == pytest.approx(1.03, abs=0.02)
    assert cloud.spacing(0.25) == pytest.approx(2.0 * cloud.spacing(1.0))
    mapped, held = cloud.split(0.3, np.random.default_rng(0))
    assert len(mapped) == round(0.3 * len(cloud.points))
    both = np.vstack((mapped, held))
    order = np.lexsort(both.T), np.lexsort(cloud.points.T)
    np.testing.assert_array_equal(both[order[0]], cloud.points[order[1]])


def test_trend_of_a_plane_is_removed_completely(script, scattered):
    returns = script("real_returns", "returns")
    bumps = scattered + [0.0, 0.0, 1.0] * (np.arange(4000) == 77)[:, None]
    np.testing.assert_allclose(returns.subtract_local_planes(scattered)[:, 2], 0.0, atol=1e-8)
    assert returns.subtract_local_planes(bumps)[77, 2] == pytest.approx(1.0, abs=0.2)


def test_only_lengths_of_the_lander_are_scaled(script):
    returns = script("real_returns", "returns")
    large = returns.scaled_lander(Lander(), 2.0)
    assert (large.leg_radius, large.pad_diameter, large.roughness_limit) == (4.7, 0.6, 0.5)
    assert large.slope_limit == pytest.approx(np.deg2rad(30.0))


def test_heights_are_interpolated_and_split_by_stratum(script, scattered):
    """Bilinear interpolation is exact on a plane; known errors are recovered."""
    judging = script("real_returns", "held_out_comparison")
    grid = Grid.centred((0.0, 0.0), 30.0, 0.5)
    mean = plane(grid.centres()).astype(np.float32)
    seen = np.ones(grid.shape, np.bool_)
    dem = GaussianDem(grid, mean, np.full(grid.shape, 0.0375, np.float32), seen)
    slope = np.where(grid.centres()[..., 0] < 0.0, 10.0, 35.0)
    wrong = scattered.copy()
    sigma = np.sqrt(0.0375 + judging.SIGMA**2)
    wrong[:, 2] += sigma * np.random.default_rng(1).standard_normal(4000)
    exact = judging.dem_errors(dem, scattered, slope)
    assert np.abs(exact.error).max() < 1e-4
    own = judging.dem_errors(dem, wrong, slope)
    np.testing.assert_allclose(own.sigma, sigma, rtol=1e-5)
    assert np.unique(own.stratum).tolist() == [0, 3]
    figures = own.statistics()
    assert figures["nees"] == pytest.approx(1.0, abs=0.08)
    assert figures["beyond2"] == pytest.approx(0.0455, abs=0.015)
    assert figures["n"] == own.statistics(0)["n"] + own.statistics(3)["n"]
    assert np.isnan(own.statistics(1)["rmse"])


def test_quadtree_cell_errors_match_the_scatter_of_their_returns(script):
    """On flat terrain with noise the error has the predicted deviation."""
    returns = script("real_returns", "returns")
    judging = script("real_returns", "held_out_comparison")
    rng = np.random.default_rng(4)
    both = np.column_stack((rng.uniform(-32.0, 32.0, (40_000, 2)), rng.normal(0.0, 0.2, 40_000)))
    grid = Grid.centred((0.0, 0.0), 64.0, 0.5)
    mapper = returns.quadtree_map(both[:20_000], grid, 2.0, 20_000 / 64.0**2)
    slope = np.full(grid.shape, 22.0)
    own = judging.quadtree_errors(mapper, both[20_000:], slope, grid)
    figures = own.statistics(1)
    assert figures["n"] > 300
    # Cells of 1.6 m contain 12.5 returns of each half.
    assert figures["rmse"] == pytest.approx(0.2 * np.sqrt(2.0 / 12.5), rel=0.2)
    assert figures["nees"] == pytest.approx(1.0, abs=0.2)
    lifted = judging.quadtree_errors(mapper, both[20_000:] + [0.0, 0.0, 0.3], slope, grid)
    assert lifted.statistics()["bias"] == pytest.approx(figures["bias"] - 0.3, abs=1e-6)


def test_scores_of_a_known_map(script):
    judging = script("real_returns", "held_out_comparison")
    p = np.array([0.9, 0.9, 0.1, 0.1, np.nan])
    safe = np.array([True, False, False, False, True])
    s = judging.safety_metrics([judging.safety_counts(p, safe)])
    assert (s["n"], s["share"], s["precision"], s["recall"]) == (4, 0.25, 0.5, 1.0)
    # Brier: (0.01 + 0.81 + 0.01 + 0.01) / 4 = 0.21 against a base of 0.1875.
    assert s["skill"] == pytest.approx(1.0 - 0.21 / 0.1875)
    assert np.isnan(s["above"])
    # Counts of the parts add up.
    parts = [judging.safety_counts(p[k], safe[k]) for k in (slice(2), slice(2, None))]
    assert judging.safety_metrics(parts) == pytest.approx(s, nan_ok=True)


def test_height_errors_of_splits_are_pooled(script):
    judging = script("real_returns", "held_out_comparison")
    rng = np.random.default_rng(5)
    error, sigma = rng.normal(0.0, 0.3, 50), rng.uniform(0.1, 0.4, 50)
    place, xy = np.zeros(50, int), np.zeros((50, 2))
    parts = [judging.HeightErrors(error[k], sigma[k], place[k], xy[k]).statistics()
             for k in (slice(10), slice(10, 50), slice(0))]  # fmt: skip
    whole = judging.HeightErrors(error, sigma, place, xy).statistics()
    assert judging.height_metrics(parts) == pytest.approx(whole)
    assert np.isnan(judging.height_metrics(parts[2:])["rmse"])


def test_script_prints_and_draws(script, tmp_path, capsys):
    module = script("real_returns", "airborne")
    study, options = module.study, {"quick": True}
    rows = run_study(study, count=1, options=options)
    report_study(study, rows, options=options, out=tmp_path)
    found = {(r["test"], r.get("mapped"), r["map"], r["slope"]): r for r in rows}
    every = found["heights", None, "as flights do", "all"]
    assert abs(every["bias"]) < 0.05
    assert every["rmse"] < 0.5
    planes = found["safety", 0.5, "planes, field of Table 6", "all"]
    assert module.safety_metrics([planes])["precision"] > 0.9
    assert (tmp_path / "airborne.png").stat().st_size > 50_000
    assert "lander scale" in capsys.readouterr().out
