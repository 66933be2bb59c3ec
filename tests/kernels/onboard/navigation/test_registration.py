"""Mean heights and slopes of the squares of a scan."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.onboard.navigation import _registration_kernels as k


def test_squares_hold_the_mean_of_their_points():
    rng = np.random.default_rng(0)
    points = rng.uniform(-3.0, 3.0, (400, 3))
    points[::7] = np.nan
    col, row, mean, count = k.average_points(points, 0.2, -0.1, 0.5, 2)
    seen = set()
    for c, r, m, n in zip(col, row, mean, count, strict=True):
        mine = (np.floor((points[:, 0] - 0.2) / 0.5 + 0.5) == c) & (
            np.floor((points[:, 1] + 0.1) / 0.5 + 0.5) == r
        )
        assert mine.sum() == n >= 2
        assert m == pytest.approx(points[mine].mean(0))
        seen.add((c, r))
    assert len(seen) == len(col)
    nothing = k.average_points(np.full((5, 3), np.nan), 0.0, 0.0, 0.5, 2)
    assert all(len(part) == 0 for part in nothing)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("far", [1e12, -1e20, 1e150])
def test_points_too_far_for_a_number_of_a_square_are_not_averaged(axis, far):
    points = np.random.default_rng(0).uniform(0.0, 1.0, (40, 3))
    assert len(k.average_points(points, 0.0, 0.0, 0.5, 2)[0]) > 0
    points[7, axis] = far
    assert [len(part) for part in k.average_points(points, 0.0, 0.0, 0.5, 2)] == [0, 0, 0, 0]
    points[7, axis] = np.nan
    assert k.average_points(points, 0.0, 0.0, 0.5, 2)[3].sum() <= 39


def test_surface_takes_the_slope_between_the_squares_on_either_side():
    rng = np.random.default_rng(2)
    row, col = np.nonzero(rng.random((12, 15)) < 0.85)
    row, col = row - 4, col - 6
    x, y = 0.3 + 0.5 * col, -0.2 + 0.5 * row
    mean = np.column_stack((x, y, np.zeros(len(x)))) + rng.normal(0.0, 0.1, (len(x), 3))
    height, slope, good = k.centre_heights(col, row, mean, 0.3, -0.2, 0.5, 0.2)
    at = {(int(c), int(r)): m for c, r, m in zip(col, row, mean, strict=True)}
    for i, (c, r) in enumerate(zip(col.tolist(), row.tolist(), strict=True)):
        west, east, south, north = (
            at.get(place) for place in ((c - 1, r), (c + 1, r), (c, r - 1), (c, r + 1))
        )
        whole = all(m is not None for m in (west, east, south, north))
        off = mean[i, :2] - [x[i], y[i]]
        assert good[i] == (whole and np.abs(off).max() <= 0.2)
        if good[i]:
            gx = (east[2] - west[2]) / (east[0] - west[0])
            gy = (north[2] - south[2]) / (north[1] - south[1])
            assert slope[i] == pytest.approx([gx, gy])
            assert height[i] == pytest.approx(mean[i, 2] - gx * off[0] - gy * off[1])
    assert 20 < good.sum() < len(good)
