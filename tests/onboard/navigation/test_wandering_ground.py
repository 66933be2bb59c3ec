"""Test kriging against a random field with unknown mean, and random heights."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.navigation.terrain_heights import interpolate_heights, kriging_weights

INDIVIDUAL_SIGMA_M = 0.05  # individual part of each height


def covariance(points, growth, level=1e4):
    """Return the covariance (n, n) of heights about an unknown mean."""
    away = np.linalg.norm(points[:, None] - points[None], axis=-1)
    return level - 0.5 * growth * away + INDIVIDUAL_SIGMA_M**2 * np.eye(len(points))


@pytest.mark.parametrize("growth", [0.0, 0.01, 0.2])
def test_weights_and_variance_equal_those_of_a_field_of_unknown_level(growth):
    rng = np.random.default_rng(1)
    places, at = rng.uniform(-50.0, 50.0, (7, 4, 2)), rng.uniform(-50.0, 50.0, (7, 2))
    weights, variance = kriging_weights(places, at, growth)
    assert weights.sum(1) == pytest.approx(1.0)
    for k in range(7):
        c = covariance(np.vstack((places[k], at[k])), growth)
        expected = np.linalg.solve(c[:4, :4], c[:4, 4])
        assert weights[k] == pytest.approx(expected, abs=2e-3)
        assert variance[k] == pytest.approx(c[4, 4] - c[4, :4] @ expected, rel=0.02)


def test_heights_of_flat_terrain_are_level_and_near_ones_count():
    rng = np.random.default_rng(2)
    places = rng.uniform(-20.0, 20.0, (30, 2))
    at = rng.uniform(-20.0, 20.0, (9, 2))
    assert interpolate_heights(places, np.full(30, 3.7), at, 0.1) == pytest.approx(3.7)
    known = rng.normal(size=30)
    # Near a place, its height counts, apart from the individual part.
    assert interpolate_heights(places, known, places + 0.01, 10.0) == pytest.approx(known, abs=0.05)
    assert interpolate_heights(places[:1], known[:1], at, 0.1) == pytest.approx(known[0])
