"""Curves of precision and recall, and means with their intervals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from lunarsim.evaluation.map_quality import (
    MapQuality,
    precision_at_recall,
    true_elevation_in_map_frame,
)
from lunarsim.evaluation.precision_recall import PrecisionRecall
from lunarsim.evaluation.reliability import brier_score
from lunarsim.evaluation.statistics import mean_interval
from lunarsim.grid import Grid
from lunarsim.world.terrain import Heightfield, Terrain


@pytest.fixture
def cells():
    rng = np.random.default_rng(3)
    p = rng.random(4000).astype(np.float32)
    return p, rng.random(4000) < p


def test_the_curve_passes_through_what_is_called_at_one_half(cells):
    p, safe = cells
    curve = PrecisionRecall.of(p, safe)
    called = MapQuality.of(p > 0.5, safe)
    assert curve.at_half() == called
    precision, recall = curve.curve()
    near = np.argmin(np.abs(recall - called.recall))
    assert precision[near] == pytest.approx(called.precision)
    assert recall[-1] == 1.0
    assert np.all(np.diff(recall) >= 0.0)
    assert precision[-1] == pytest.approx(safe.mean())


def test_precision_at_a_recall_agrees_with_that_of_the_cells(cells):
    p, safe = cells
    curve = PrecisionRecall.of(p, safe)
    for recall in (0.3, 0.7):
        exact = precision_at_recall(p, safe, recall)
        assert curve.precision_at(recall) == pytest.approx(exact, abs=0.02)
    # More than is ever found: that of the lowest threshold.
    assert curve.precision_at(2.0) == pytest.approx(safe.mean())


def test_curves_of_two_maps_pool_their_cells(cells):
    p, safe = cells
    both = PrecisionRecall.of(p[:1500], safe[:1500]) + PrecisionRecall.of(p[1500:], safe[1500:])
    whole = PrecisionRecall.of(p, safe)
    assert np.array_equal(both.safe, whole.safe)
    assert np.array_equal(both.unsafe, whole.unsafe)


def test_mean_interval_is_that_of_student():
    x = np.array([1.0, 2.0, 4.0, 5.5])
    low, high = stats.t.interval(0.95, 3, loc=x.mean(), scale=stats.sem(x))
    found = mean_interval([*x, np.nan])
    assert (found.mean - found.half, found.mean + found.half) == pytest.approx((low, high))
    assert np.isnan(mean_interval([2.0]).half)
    assert np.isnan(mean_interval([]).mean)
    assert mean_interval([1.0, 1.0]).text(2) == "1.00 ± 0.00"


def test_brier_score_is_the_mean_square():
    assert brier_score([0.0, 0.5, 1.0], [False, True, False]) == pytest.approx(1.25 / 3.0)


def test_local_terrain_lies_where_a_map_with_this_error_has_it():
    posts = Grid.centred((0.0, 0.0), 40.0, 0.5)
    z = 0.2 * posts.x[None, :] - 0.1 * posts.y[:, None]
    terrain = Terrain(Heightfield(posts, z.astype(np.float32)))
    grid, error = Grid.centred((1.0, 2.0), 6.0, 0.5), np.array([3.0, -1.0, 0.7])
    ground = true_elevation_in_map_frame(terrain, grid, error)
    true = grid.centres() - error[:2]
    assert ground == pytest.approx(0.2 * true[..., 0] - 0.1 * true[..., 1] + 0.7, abs=1e-4)
    assert grid.moved(error).centre == pytest.approx((4.0, 1.0))


def test_recall_at_a_precision_is_the_greatest_of_any_threshold():
    # From the surest down: one safe, one unsafe, then nine safe.
    p = [0.99, 0.9, *[0.6] * 9]
    curve = PrecisionRecall.of(p, [True, False, *[True] * 9])
    assert curve.recall_at(0.95) == pytest.approx(0.1)
    assert curve.recall_at(0.9) == pytest.approx(1.0)
    assert PrecisionRecall.of([0.9], [False]).recall_at(0.5) == 0.0
