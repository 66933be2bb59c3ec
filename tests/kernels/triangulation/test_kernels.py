"""Compiled parts of the triangulation, each by itself: a fault in one may cost time alone."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from lunarsim.triangulation import _flip_kernels, _geometry_kernels, _insertion_kernels


def edges(triangles):
    return {tuple(sorted(e)) for t in triangles.tolist() for e in itertools.combinations(t, 2)}


def mesh(rows, cols, seed, noise=0.1):
    """Return the integer returns of a detector of rows x cols, none of its quads folded."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(float(cols)), np.arange(float(rows)))
    points = np.column_stack((x.ravel(), y.ravel()))
    return np.rint((points + noise * rng.standard_normal(points.shape)) * 2**16).astype(np.int64)


@pytest.mark.parametrize(("rows", "cols"), [(23, 9), (5, 31), (2, 2), (2, 17), (14, 2)])
@pytest.mark.parametrize("turn", [(1, 1), (-1, 1), (1, -1)])
def test_a_mesh_is_flipped_without_help_from_insertion(rows, cols, turn):
    """Its caller inserts the points one by one where the mesh gives no triangles."""
    points = mesh(rows, cols, seed=rows) * turn
    triangles = _flip_kernels.triangulate_mesh(points, rows, cols)
    assert edges(triangles) == edges(Delaunay(points).simplices)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    assert (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 0).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_mesh_that_must_be_flipped_often(seed):
    points = mesh(12, 15, seed, noise=0.05)
    points[:, 0] += 3 * points[:, 1]  # sheared: the first diagonals are far from Delaunay
    triangles = _flip_kernels.triangulate_mesh(points, 12, 15)
    assert edges(triangles) == edges(Delaunay(points).simplices)


@pytest.mark.parametrize("place", [0, 8, 9 * 11, 9 * 12 - 1, 9 * 5 + 4])
def test_a_mesh_that_folds_over_is_refused(place):
    points = mesh(12, 9, seed=1)
    points[place] += (2**16) * np.array([3, 3]) * (1 if place < 50 else -1)
    assert _flip_kernels.triangulate_mesh(points, 12, 9).shape == (0, 3)


@pytest.mark.parametrize(
    ("b", "c", "d"), [((4, 0), (4, 4), (8, 8)), ((8, 8), (4, 4), (0, 4)), ((4, 4), (4, 4), (0, 4))]
)
def test_a_quad_with_a_triangle_of_no_area_is_refused(b, c, d):
    points = np.array([(0, 0), b, d, c], dtype=np.int64)
    assert _flip_kernels.triangulate_mesh(points, 2, 2).shape == (0, 3)


@pytest.mark.parametrize("bits", [1, 2, 5])
def test_the_curve_goes_through_every_place_once_and_never_jumps(bits):
    side = 2**bits
    points = np.array([(x, y) for x in range(side) for y in range(side)], dtype=np.int64)
    key = _insertion_kernels.hilbert_keys(points, bits)
    assert sorted(key.tolist()) == list(range(side * side))
    steps = np.abs(np.diff(points[np.argsort(key)], axis=0)).sum(axis=1)
    assert (steps == 1).all()


@pytest.mark.parametrize("seed", range(3))
def test_points_may_come_in_any_order(seed):
    points = np.random.default_rng(seed).integers(0, 2**20, (60, 2))
    wanted = edges(Delaunay(points).simplices)
    for turn in range(6):
        order = np.random.default_rng((seed, turn)).permutation(60)
        assert edges(_insertion_kernels.insert_all(points, order)) == wanted


def circle_points():
    """Return integer points of one circle about the origin with a radius of almost 2**24."""
    # A product of sums of two squares is one in many ways.
    factors = [complex(2, 1), complex(3, 2), complex(4, 1), complex(5, 2), complex(6, 1)]
    found = set()
    for signs in itertools.product((False, True), repeat=len(factors)):
        x, y = 1, 0
        for factor, turned in zip(factors, signs, strict=True):
            a, b = int(factor.real), int(factor.imag) * (-1 if turned else 1)
            for _ in range(2):
                x, y = x * a - y * b, x * b + y * a
        found |= {(x, y), (-x, -y), (-y, x), (y, -x)}
    scale = 2**24 // max(abs(x) for x, _ in found)
    return sorted((scale * x, scale * y) for x, y in found)


def determinant(a, b, c, p):
    """Return the in-circle determinant of integers without bound."""
    rows = [(q[0] - p[0], q[1] - p[1]) for q in (a, b, c)]
    (ax, ay), (bx, by), (cx, cy) = rows
    return (
        (ax * ax + ay * ay) * (bx * cy - by * cx)
        + (bx * bx + by * by) * (cx * ay - cy * ax)
        + (cx * cx + cy * cy) * (ax * by - ay * bx)
    )


@given(
    st.permutations(circle_points()).map(lambda points: points[:4]),
    st.tuples(st.integers(-1, 1), st.integers(-1, 1)),
)
def test_one_unit_off_a_circle_of_any_four_points(points, off):
    """The determinant has up to 100 bits and all but the last few cancel."""
    a, b, c, p = points
    p = (p[0] + off[0], p[1] + off[1])
    wanted = determinant(a, b, c, p)
    sign = (wanted > 0) - (wanted < 0)
    assert _geometry_kernels.in_circle(*a, *b, *c, *p) == sign
