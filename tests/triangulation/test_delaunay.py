from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay, QhullError

from lunarsim.triangulation import delaunay, delaunay_of_image
from tests.reference.triangulation import in_circle


def orientation(points: list[list[int]], t) -> int:
    (ax, ay), (bx, by), (cx, cy) = (points[i] for i in t)
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def check_delaunay(xy: np.ndarray, triangles: np.ndarray) -> None:
    """Positive triangles that tile the hull, every inner edge locally Delaunay, exactly.

    The coordinates must be integers, so that the check is free of rounding.
    """
    points = xy.astype(np.int64).tolist()
    area = 0
    across: dict[tuple[int, int], int] = {}
    for t in triangles.tolist():
        twice = orientation(points, t)
        assert twice > 0
        area += twice
        for k in range(3):
            edge = (t[k], t[(k + 1) % 3])
            assert edge not in across
            across[edge] = t[(k + 2) % 3]
    for (u, v), apex in across.items():
        other = across.get((v, u))
        if other is not None:
            assert in_circle(points[u], points[v], points[apex], points[other]) <= 0
    hull = [(u, v) for u, v in across if (v, u) not in across]
    shoelace = sum(points[u][0] * points[v][1] - points[v][0] * points[u][1] for u, v in hull)
    assert shoelace == area
    used = {i for t in triangles.tolist() for i in t}
    distinct = {tuple(p) for p in points}
    assert len({tuple(points[i]) for i in used}) == len(distinct)
    # The hull is convex: no point lies outside a hull edge.
    everything = np.array(points, dtype=object)
    for u, v in hull[:50]:
        d = everything[v] - everything[u]
        side = d[0] * (everything[:, 1] - points[u][1]) - d[1] * (everything[:, 0] - points[u][0])
        assert (side >= 0).all()


def edges(triangles: np.ndarray) -> set[tuple[int, int]]:
    pairs = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    return set(map(tuple, np.sort(pairs, axis=1).tolist()))


@given(
    st.integers(0, 10_000),
    st.integers(3, 60),
    st.sampled_from([4, 10, 100, 2**24]),
)
def test_integer_points_of_any_arrangement(seed, count, span):
    """Small spans force collinear, cocircular and coincident points."""
    xy = np.random.default_rng(seed).integers(0, span, (count, 2)).astype(float)
    triangles = delaunay(xy)
    try:
        Delaunay(np.unique(xy, axis=0))
    except (QhullError, ValueError):
        assert len(triangles) == 0 or len(np.unique(xy, axis=0)) >= 3
    if len(triangles):
        check_delaunay(xy, triangles)


@pytest.mark.parametrize("seed", range(3))
def test_random_points_agree_with_qhull(seed):
    # Integers, so that nothing is rounded before the predicates.
    xy = np.rint(np.random.default_rng(seed).random((5000, 2)) * 2**24)
    assert edges(delaunay(xy)) == edges(Delaunay(xy).simplices)


def test_lattice():
    x, y = np.meshgrid(np.arange(12.0), np.arange(9.0))
    xy = np.column_stack((x.ravel(), y.ravel()))
    triangles = delaunay(xy)
    assert len(triangles) == 2 * 11 * 8
    check_delaunay(xy, triangles)
    check_delaunay(xy, delaunay_of_image(xy, (9, 12)))


def test_points_on_a_circle():
    angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    xy = np.rint(1e6 * np.column_stack((np.cos(angle), np.sin(angle))) + 1e6)
    triangles = delaunay(xy)
    assert len(triangles) == 62
    check_delaunay(xy, triangles)


@pytest.mark.parametrize(
    "xy",
    [np.zeros((0, 2)), [[0, 0]], [[0, 0], [1, 1]], [[i, 2 * i] for i in range(9)], [[1, 1]] * 5],
    ids=["none", "one", "two", "collinear", "coincident"],
)
def test_degenerate_clouds_have_no_triangles(xy):
    assert delaunay(np.array(xy, dtype=float).reshape(-1, 2)).shape == (0, 3)


def scan(seed: int, noise: float, shear: float = 0.0, n: int = 40) -> np.ndarray:
    rng = np.random.default_rng(seed)
    u = np.arange(n, dtype=float)
    x, y = np.meshgrid(u, -u)
    points = np.column_stack((x.ravel() + shear * y.ravel(), y.ravel()))
    return np.rint((points + noise * rng.standard_normal(points.shape)) * 2**16)


@pytest.mark.parametrize(("noise", "shear"), [(0.0, 0.0), (0.01, 0.0), (0.1, 0.4), (0.2, -0.8)])
def test_a_detector_image_gives_the_same_triangulation(noise, shear):
    xy = scan(3, noise, shear)
    fast = delaunay_of_image(xy, (40, 40))
    check_delaunay(xy, fast)
    if noise > 0.0:
        assert edges(fast) == edges(delaunay(xy))


def test_mirrored_and_turned_images():
    xy = scan(1, 0.1)
    for turned in (xy * [-1.0, 1.0], xy[:, ::-1], -xy):
        triangles = delaunay_of_image(turned, (40, 40))
        check_delaunay(turned - turned.min(axis=0), triangles)


def test_folded_and_broken_images_fall_back():
    xy = scan(2, 0.05)
    folded = xy.copy()
    folded[20 * 40 + 20] = folded[20 * 40 + 24]  # a point hidden behind its neighbours
    check_delaunay(folded, delaunay_of_image(folded, (40, 40)))
    broken = xy.copy()
    broken[[5, 77, 900]] = np.nan
    triangles = delaunay_of_image(broken, (40, 40))
    assert not np.isin(triangles, [5, 77, 900]).any()
    seen = np.isfinite(broken).all(axis=1)
    assert edges(triangles) == {
        (int(np.flatnonzero(seen)[a]), int(np.flatnonzero(seen)[b]))
        for a, b in edges(delaunay(broken[seen]))
    }


def test_threads_do_not_matter():
    xy = scan(5, 0.1)
    before = numba.get_num_threads()
    try:
        results = []
        for threads in (1, before):
            numba.set_num_threads(threads)
            results.append((delaunay(xy), delaunay_of_image(xy, (40, 40))))
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(results[0][0], results[1][0])
    assert np.array_equal(results[0][1], results[1][1])


@pytest.mark.slow
def test_a_million_points():
    # Integers, so that both see the same points; Qhull itself rounds its circumcircles.
    xy = np.rint(np.random.default_rng(1).random((1_000_000, 2)) * 2**24)
    triangles = delaunay(xy)
    assert len(edges(triangles) ^ edges(Delaunay(xy).simplices)) < 20


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])


@pytest.mark.parametrize("extent", [1e-250, 1e-30, 1.0, 1e30, 1e250])
def test_any_ordinary_extent_is_triangulated(extent):
    assert len(delaunay(extent * SQUARE)) == 2


@pytest.mark.parametrize("xy", [5e-324 * SQUARE, 1e-310 * SQUARE, 1e-300 * SQUARE, 1e305 * SQUARE,
                                1.7e308 * (2.0 * SQUARE - 1.0)])  # fmt: skip
def test_an_extent_that_no_integers_can_show_is_refused(xy):
    with pytest.raises(ValueError, match="must have an extent"):
        delaunay(xy)
    with pytest.raises(ValueError, match="must have an extent"):
        delaunay_of_image(xy, (2, 2))


def test_bad_input():
    with pytest.raises(ValueError, match="shape"):
        delaunay(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="NaN"):
        delaunay([[0.0, np.nan], [1.0, 0.0], [0.0, 1.0]])
    with pytest.raises(ValueError, match="shape"):
        delaunay_of_image(np.zeros((5, 2)), (2, 3))
