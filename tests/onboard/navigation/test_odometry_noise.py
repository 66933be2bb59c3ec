"""Test the noise model of scan-to-scan differences."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.navigation.scan_odometry import (
    comparison_normals,
    height_variances,
    linearisation_variance,
)


def normals(slope):
    return np.column_stack((slope, np.ones(len(slope))))


def test_noise_of_slopes_is_drawn_to_the_usual_one_and_terrain_that_stands_out_is_kept():
    rng = np.random.default_rng(1)
    true = np.tile([0.02, -0.01], (600, 1))
    rough = np.arange(600) < 60
    true[rough] += rng.choice([-0.3, 0.3], (60, 2))
    new, old = (normals(true + 0.005 * rng.normal(size=true.shape)) for _ in range(2))
    found = comparison_normals(new, old)
    assert (found[:, 2] == 1.0).all()
    assert np.abs(found[rough, :2] - true[rough]).max() < 0.02
    # Almost no noise remains: 6 times its variance is seldom exceeded.
    level = found[~rough, :2] - [0.02, -0.01]
    assert np.mean(level**2) < 0.02 * 0.005**2 / 2 + 1e-6
    assert np.median(np.abs(level)) < 5e-4


def test_steep_squares_err_by_more_as_what_is_left_shows():
    rng = np.random.default_rng(2)
    steep = np.where(np.arange(4000) % 4 == 0, 0.5, 0.0)
    slope = np.column_stack((steep, np.zeros(4000))) + 1e-6 * rng.normal(size=(4000, 2))
    sigma = np.where(steep > 0.0, 0.020, 0.002)
    left = sigma * rng.normal(size=4000)
    used = np.arange(4000) < 3900
    left[~used] = 5.0
    found = np.sqrt(height_variances(normals(slope), left, used))
    assert found[steep == 0.0].mean() == pytest.approx(0.002, rel=0.05)
    assert found[steep > 0.0].mean() == pytest.approx(0.020, rel=0.05)
    # No square is exact.
    assert (height_variances(normals(slope), np.zeros(4000), used) >= 3e-4**2).all()


def test_tilts_move_the_ends_of_ways_by_their_square():
    prior = np.zeros((17, 17))
    assert linearisation_variance(prior, np.ones((2, 3))) == 0.0
    at = np.r_[3:6, 9:12]
    prior[at, at] = 0.01**2
    ways = np.array([[3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    assert linearisation_variance(prior, ways) == pytest.approx((3e-4 * 5.0) ** 2)
    prior[13, 13] = 1e-4
    assert linearisation_variance(prior, ways) == pytest.approx((4e-4 * 5.0) ** 2)
    # A lander without a state for its scanner's errors has no more than the poses.
    assert linearisation_variance(prior[:12, :12], ways) == pytest.approx((3e-4 * 5.0) ** 2)
