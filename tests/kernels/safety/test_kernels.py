"""Kernels of the safety tests one by one: windows of rasters, gradients that lids follow."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.safety import _exact_kernels as exact
from lunarsim.safety import _kernels as k
from lunarsim.safety.footprint import BLOCK

FAR = float(k.FAR)
CORNERS = ((-4, -3), (-2, 3), (2, -5), (3, 4), (7, 9), (0, 0), (-12, 2), (2, 20))


@pytest.mark.parametrize("corner", CORNERS)
def test_windows_hold_the_raster_and_far_beyond_it(corner):
    rng = np.random.default_rng(0)
    z, variance = rng.normal(7.0, 1.0, (9, 11)), rng.random((9, 11)).astype(np.float32)
    for bad, value in (((2, 3), np.nan), ((5, 0), 1e20), ((8, 10), -np.inf), ((0, 7), np.inf)):
        z[bad] = variance[bad] = value
    variance[4, 5] = np.nan
    heights, spreads = np.zeros((2, 8, 10), np.float32)
    k.load_window(z, 7.0, 6.5, *corner, heights)
    k.load_variance(variance, *corner, spreads)
    for i, j in np.ndindex(heights.shape):
        row, col = corner[0] + i, corner[1] + j
        there = 0 <= row < 9 and 0 <= col < 11
        ground = there and abs(z[row, col]) < 1e4
        known = there and variance[row, col] < FAR
        assert heights[i, j] == np.float32(z[row, col] - 6.5 if ground else FAR), (i, j)
        assert spreads[i, j] == (variance[row, col] if known else np.float32(FAR)), (i, j)


def test_lids_follow_the_terrain_at_large():
    rng = np.random.default_rng(1)
    side, arm = exact.SQUARE, 5
    z = np.cumsum(rng.normal(0.0, 0.1, (33, 44)), axis=1).astype(np.float32)
    bottom, top, left, right = inside = (3, 28, 0, 39)
    slopes = np.full((2, 4, 5), np.nan, np.float32)
    exact.large_scale_gradients(z, inside, arm, slopes)
    squares = np.empty(slopes.shape)
    for i, j in np.ndindex(4, 5):
        east, north = [], []
        for row in range(i * side, (i + 1) * side):
            for col in range(j * side, (j + 1) * side, 2):
                y, x = np.clip(row, bottom, top), np.clip(col, left, right)
                west_end, east_end = max(x - arm, left), min(x + arm, right)
                south_end, north_end = max(y - arm, bottom), min(y + arm, top)
                east += [(z[y, east_end] - z[y, west_end]) / (east_end - west_end)]
                north += [(z[north_end, x] - z[south_end, x]) / (north_end - south_end)]
        squares[:, i, j] = np.median(east), np.median(north)
    for axis, i, j in np.ndindex(slopes.shape):
        near = squares[axis, max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        assert slopes[axis, i, j] == pytest.approx(np.median(near), abs=1e-6)


@pytest.mark.parametrize("shape", [(4, 5), (1, 3), (3, 1)])
def test_a_lid_has_the_gradient_at_the_middle_of_its_block(shape):
    slopes = np.random.default_rng(2).normal(0.0, 1.0, shape).astype(np.float32)
    out = np.empty((shape[0] * exact.SQUARE + 3, shape[1] * exact.SQUARE + 7), np.float32)
    exact.block_gradients(slopes, out)
    rows, cols = (exact.SQUARE * (np.arange(n) + 0.5) - 0.5 for n in shape)
    middle = 0.5 * (BLOCK - 1)
    lines = [np.interp(np.arange(out.shape[1]) + middle, cols, line) for line in slopes]
    for j, column in enumerate(np.transpose(lines)):
        expected = np.interp(np.arange(len(out)) + middle, rows, column)
        assert out[:, j] == pytest.approx(expected, abs=1e-5)
