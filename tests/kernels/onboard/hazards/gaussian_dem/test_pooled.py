"""Kriging, edge increments and curvature of pooled samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lunarsim.grid import Grid
from lunarsim.onboard.hazards.gaussian_dem import SamplePool, _kernels, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem import _sample_kernels as sk
from lunarsim.onboard.hazards.local_planes import LocalPlaneGrid
from tests.reference import dem as reference

GRID = Grid.centred((0.0, 0.0), 5.0, 0.5)


def samples(seed: int, n: int = 120):
    rng = np.random.default_rng(seed)
    points = np.column_stack((rng.uniform(-3.0, 3.0, (n, 2)), rng.normal(0.0, 0.5, n)))
    points[rng.random(n) < 0.05] = np.nan
    return points, rng.uniform(0.01, 0.1, n)


@given(st.integers(0, 1000), st.floats(1e-5, 0.1), st.floats(5.0, 500.0))
def test_regression_with_slope_and_noises_is_that_of_matrices(seed, growth, length):
    rng = np.random.default_rng(seed)
    vertices = np.column_stack((rng.uniform(-2.0, 2.0, (3, 2)), rng.normal(0.0, 0.3, 3)))
    a, b, c = vertices[:, :2]
    if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0.0:
        vertices = vertices[::-1].copy()
    noise, gradient = rng.uniform(1e-6, 1e-3, 3), rng.normal(0.0, 0.2, 2)
    mean, variance = np.full(GRID.shape, np.nan, np.float32), np.zeros(GRID.shape, np.float32)
    observed = np.zeros(GRID.shape, np.bool_)
    _kernels.regress(
        vertices, noise, np.array([[0, 1, 2]]), np.array([True]), gradient[None],
        GRID.x0, GRID.y0, GRID.posting, np.array([growth * length]), np.array([length]),
        np.zeros(GRID.shape, np.float32), np.float32(0.5), mean, variance, observed,
    )  # fmt: skip
    for i, j in np.argwhere(observed):
        wanted = reference.trended(vertices, noise, gradient, growth, length, GRID.centre_of(i, j))
        assert mean[i, j] == pytest.approx(wanted[0], abs=1e-5)
        assert variance[i, j] == pytest.approx(wanted[1], rel=1e-3, abs=1e-7)


def test_growth_of_a_triangle_is_what_its_edges_rise_off_the_slope():
    rng = np.random.default_rng(4)
    points, variance = rng.normal(0.0, 1.0, (30, 3)), rng.uniform(0.0, 0.01, 30)
    triangles, gradient = rng.integers(0, 30, (40, 3)), rng.normal(0.0, 0.3, (40, 2))
    out = np.empty((40, 2))
    sk.sum_edge_increments(points, variance, triangles, gradient, out)
    for (a, b, c), g, (grown, length) in zip(triangles, gradient, out, strict=True):
        rise = along = 0.0
        for u, v in ((a, b), (b, c), (c, a)):
            d = points[v] - points[u]
            rise += (d[2] - g @ d[:2]) ** 2 - variance[u] - variance[v]
            along += 2.0 * np.hypot(*d[:2])
        assert (grown, length) == pytest.approx((rise, along))


def test_a_bend_adds_to_the_variance_and_a_slope_does_not():
    x = GRID.centres()[..., 0]
    step = np.where(x > 0.0, 0.4, 0.0)
    for z, bent in ((0.3 * x, False), (step, True)):
        variance = np.zeros(GRID.shape, np.float32)
        measured, noise = np.ones(GRID.shape, np.bool_), np.full(GRID.shape, 1e-4)
        sk.add_curvature_variance(z.astype(np.float32), measured, noise, 0.5, variance)
        inner = variance[1:-1, 1:-1]
        wanted = 0.5 * (0.2**2 - 13.5e-4) if bent else 0.0
        assert inner.max() == pytest.approx(wanted, rel=1e-4, abs=1e-9)
        assert (inner[:, :2] == 0.0).all()


def test_a_bend_is_the_greatest_of_four_directions():
    z = np.random.default_rng(0).normal(0.0, 0.1, GRID.shape).astype(np.float32)
    z[4, 5] = np.nan
    measured, noise = np.isfinite(z), np.full(GRID.shape, 1e-4)
    variance = np.zeros(GRID.shape, np.float32)
    sk.add_curvature_variance(z, measured, noise, 0.5, variance)
    wide = np.pad(z, 1, constant_values=np.nan)  # off the map nothing is known
    for i in range(GRID.rows):
        for j in range(GRID.cols):
            pairs = [
                (wide[i + 1 - di, j + 1 - dj], wide[i + 1 + di, j + 1 + dj])
                for di, dj in ((0, 1), (1, 0), (1, 1), (-1, 1))
            ]
            bends = [(0.5 * (a + b) - z[i, j]) ** 2 for a, b in pairs]
            most = max((b for b in bends if np.isfinite(b)), default=0.0)
            wanted = 0.5 * max(most - 13.5e-4, 0.0)
            assert variance[i, j] == pytest.approx(wanted, rel=1e-4, abs=1e-7)


def test_triangles_are_taken_by_all_of_their_corners(monkeypatch):
    """Compare centres and prior of the terrain between samples, bit for bit."""
    pool, given, middles, at = SamplePool(GRID), [], [], LocalPlaneGrid.at
    points, sigma = samples(3, 25)
    pool.add(points, sigma, 0.5)
    monkeypatch.setattr(_kernels, "regress", lambda *args: given.append(args))
    monkeypatch.setattr(LocalPlaneGrid, "at", lambda *args: middles.append(args[2]) or at(*args))
    pooled_dem(pool)
    vertices, noise, triangles, _, gradient, _, _, _, prior, length, *_ = given[0]
    assert np.ptp(noise) > 0.0
    # The third call is for the samples themselves.
    for points in middles[:2]:
        np.testing.assert_array_equal(points, vertices[triangles].mean(axis=1)[:, :2])
    grown = np.empty((len(triangles), 2))
    sk.sum_edge_increments(vertices, noise, triangles, gradient, grown)
    corners = noise[triangles]
    # A multiple of the largest corner noise plus the growth along the edges.
    times = prior / (corners.max(axis=1) + prior / length * grown[:, 1])
    np.testing.assert_allclose(times, times[0], rtol=1e-12)
