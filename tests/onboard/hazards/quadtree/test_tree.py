"""Test the quadtree against a plain one, for any order and size of the batches."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.quadtree import QuadtreeMap, SiteSelector
from tests.reference import quadtree as reference


def cloud(rng, n, spread=5.0):
    return np.column_stack((rng.normal(0.0, spread, (n, 2)), rng.normal(10.0, 1.0, n)))


def filled(seed, batches, split_count=6, *, spread=5.0, tall=1.0):
    rng = np.random.default_rng(seed)
    quadtree = QuadtreeMap((0.5, -0.5, 10.0), 20.0, 0.15, split_count=split_count)
    for n in batches:
        points = cloud(rng, n, spread)
        points[:, 2] = 10.0 + tall * (points[:, 2] - 10.0)
        quadtree.insert(points + np.array([0.5, -0.5, 0.0]))
    return quadtree


def plain(quadtree):
    t = quadtree.tree
    points = t.xyz[: quadtree.count].astype(np.float64)
    return points, reference.cells(points, t.half, quadtree.depths, quadtree.split_count)


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    batches=st.lists(st.integers(0, 300), min_size=1, max_size=5),
    split_count=st.integers(2, 12),
    spread=st.sampled_from([0.1, 1.0, 5.0]),
    tall=st.sampled_from([0.1, 1.0]),
)
# The share of isolated points falls below the limit when a smallest cell gets more points.
@example(seed=161, batches=[14, 245, 5], split_count=2, spread=0.1, tall=1.0)
def test_cells_and_their_means_are_those_of_the_plain_tree(
    seed, batches, split_count, spread, tall
):
    quadtree = filled(seed, batches, split_count, spread=spread, tall=tall)
    points, tree = plain(quadtree)
    t = quadtree.tree
    nodes = np.arange(quadtree.cell_count, dtype=np.int32)
    node_by_cell = {(int(t.depth[i]), int(t.column[i]), int(t.row[i])): i for i in nodes}
    assert node_by_cell.keys() == tree.keys()
    elevation, variance = quadtree.elevation(nodes), quadtree.variance(nodes)
    z = points[:, 2]
    apart = reference.stand_apart(z, tree, t.half, quadtree.depths, 8)
    assert np.array_equal(quadtree.is_outlier, apart)
    for key, i in node_by_cell.items():
        assert t.count[i] == len(tree[key])
        least = key[0] == quadtree.depths and len(tree[key]) >= 8
        assert (t.slot[i] >= 0) == (reference.divided(key, tree) or least)
        below = points[tree[key]][~apart[tree[key]]]
        if len(below):
            assert elevation[i] == pytest.approx(below[:, 2].mean() + 10.0, abs=1e-9)
            assert variance[i] == pytest.approx(below[:, 2].var(), abs=1e-9)
            x, y = quadtree.centres(np.array([i]))[0] - quadtree.centre[:2]
            d = below - np.array([x, y, 0.0])
            sums = [*d.sum(0), *(np.sum(d[:, a] * d[:, b]) for a in range(3) for b in range(a, 3))]
            sums += [len(below), below[:, 2].min(), below[:, 2].max()]
            if t.slot[i] >= 0:
                assert t.sums[t.slot[i]] == pytest.approx(np.array(sums), abs=1e-7)


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    west=st.floats(-12, 10),
    south=st.floats(-12, 10),
    wide=st.floats(0, 20),
    high=st.floats(0, 20),
)
def test_queries_find_what_looking_at_everything_finds(seed, west, south, wide, high):
    quadtree = filled(seed, [200, 1, 150])
    points, tree = plain(quadtree)
    everything = points + quadtree.centre
    inside = (
        (points[:, 0] >= west - 0.5)
        & (points[:, 0] <= west + wide - 0.5)
        & (points[:, 1] >= south + 0.5)
        & (points[:, 1] <= south + high + 0.5)
    )
    found = quadtree.points_in(west, west + wide, south, south + high)
    assert sorted(map(tuple, found)) == sorted(map(tuple, everything[inside]))
    t = quadtree.tree
    band = quadtree.band(0.3, 2.4)
    keys = {(int(t.depth[i]), int(t.column[i]), int(t.row[i])) for i in band}
    assert keys == reference.band(tree, quadtree.depth_of(0.3), quadtree.depth_of(2.4))
    assert len(keys) == len(band)
    # The cell at a point is the one of the band that contains it.
    at = quadtree.cell_at((west, south), 0.3, 2.4)
    gap = np.abs(quadtree.centres(band) - [west, south]) - 0.5 * quadtree.sizes(band)[:, None]
    if at >= 0:
        assert at in band[(gap <= 1e-9).all(axis=1)]
    else:
        assert not (gap < -1e-9).all(axis=1).any()


def test_one_batch_or_many_give_the_same_cells():
    rng = np.random.default_rng(3)
    points = cloud(rng, 2000)
    one, many = (QuadtreeMap((0.0, 0.0), 20.0, 0.15) for _ in range(2))
    one.insert(points)
    for part in np.array_split(rng.permutation(points), 17):
        many.insert(part)
    a, b = one.band(0.3, 5.0), many.band(0.3, 5.0)
    assert one.cell_count == many.cell_count
    assert one.centres(a) == pytest.approx(many.centres(b))
    assert one.elevation(a) == pytest.approx(many.elevation(b), abs=1e-6, nan_ok=True)


def test_cells_know_when_points_reached_them_last():
    quadtree = filled(1, [400])
    version = quadtree.version
    assert len(quadtree.band(0.6, 2.4, since=version)) == 0
    quadtree.insert(np.array([[1.0, 1.0, 10.0]]))
    changed = quadtree.band(0.6, 2.4, since=version)
    assert quadtree.cell_at((1.0, 1.0), 0.6, 2.4) in changed
    assert (np.abs(quadtree.centres(changed) - 1.0) <= quadtree.sizes(changed)[:, None]).all()


def test_points_that_cannot_be_placed_are_counted_and_left_out():
    quadtree = QuadtreeMap((0.0, 0.0), 10.0, 0.1)
    done = quadtree.insert(
        np.array([[0, 0, 1], [np.nan, 0, 0], [0, 0, np.nan], [99, 0, 0], [1e30, 0, 0],
                  [0, 0, 2e4]], float)
    )  # fmt: skip
    assert (done.added, done.outside, done.missing) == (1, 3, 2)
    assert quadtree.count == 1
    assert quadtree.insert(np.full((5, 3), np.nan)).missing == 5
    assert quadtree.insert(np.zeros((0, 3))).added == 0
    assert quadtree.version == 1


def test_a_point_that_rounds_over_the_edge_is_off_the_map():
    # Slightly less than half the side; in cells it rounds to one past the last.
    least = float(np.nextafter(np.float64(np.float32(0.22)), 1.0))
    half = 8.0 * least
    edge = float(np.float32(half))
    assert edge < half
    assert (edge + half) * (16 / (2.0 * half)) == 16.0
    for xy in ((edge, 0.1), (0.1, edge)):
        quadtree = QuadtreeMap((0.0, 0.0), 2.0 * half, least)
        done = quadtree.insert([[*xy, 0.0], [0.1, 0.1, 0.0]])
        assert (done.added, done.outside) == (1, 1)


def test_all_points_in_one_place_end_in_one_least_cell():
    quadtree = QuadtreeMap((0.0, 0.0), 10.0, 0.1)
    for _ in range(3):
        quadtree.insert(np.tile([1.234, 2.345, 3.0], (5000, 1)))
    node = quadtree.cell_at((1.234, 2.345))
    assert quadtree.sizes(np.array([node]))[0] == pytest.approx(0.1)
    assert quadtree.point_counts(np.array([node]))[0] == 15_000
    assert quadtree.variance(np.array([node]))[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"min_cell_size": 0.0}, "quadtree.min_cell_size_m"),
        ({"min_cell_size": -1.0}, "quadtree.min_cell_size_m"),
        ({"min_cell_size": np.nan}, "quadtree.min_cell_size_m"),
        ({"min_cell_size": 1e-9}, "quadtree.min_cell_size_m"),
        ({"side": 0.0}, "quadtree.side_m"),
        ({"side": np.inf}, "quadtree.side_m"),
        ({"split_count": 1}, "quadtree.split_count"),
        ({"centre": (np.nan, 0.0)}, "quadtree.centre"),
    ],
)
def test_impossible_maps_are_refused(arguments, field):
    with pytest.raises(InputError, match=field):
        QuadtreeMap(**({"centre": (0.0, 0.0), "side": 10.0} | arguments))
    with pytest.raises(InputError, match=r"quadtree\.points"):
        QuadtreeMap((0.0, 0.0), 10.0).insert(np.zeros((3, 2)))


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((3, 2)),
        np.zeros(3),
        np.zeros((2, 3, 3)),
        [[0.0, 0.0, np.inf]],
        [[-np.inf, 0.0, 0.0], [0.0, 0.0, 0.0]],
        [[0.0, 0.0, 1j]],
        [["0.0", "0.0", "1.0"]],
        np.ones((2, 3), bool),
        [[0.0, 0.0, 1e300]],
        # Measured from the centre of the Moon.
        np.array([[0.0, 0.0, 1_737_400.0], [1.0, 1.0, 1_737_400.0]]),
    ],
    ids=[
        "two columns",
        "one row",
        "three axes",
        "infinite",
        "infinite east",
        "complex",
        "text",
        "truth",
        "absurd",
        "datum",
    ],
)
def test_points_that_cannot_be_are_refused(points):
    quadtree = QuadtreeMap((0.0, 0.0), 10.0)
    quadtree.insert([[1.0, 1.0, 0.0]])
    with pytest.raises(InputError, match=r"quadtree\.points"):
        quadtree.insert(points)
    assert quadtree.count == 1


def test_masked_points_are_left_out():
    points = np.ma.masked_greater(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 9e9]]), 1e6)
    quadtree = QuadtreeMap((0.0, 0.0), 10.0)
    done = quadtree.insert(points)
    assert (done.added, done.missing) == (1, 1)


def test_terrain_at_any_height_is_mapped_about_its_own_elevation():
    rng = np.random.default_rng(8)
    points = cloud(rng, 500, 2.0)
    low, high = (QuadtreeMap((0.0, 0.0, h), 10.0) for h in (0.0, 1_737_400.0))
    low.insert(points)
    high.insert(points + [0.0, 0.0, 1_737_400.0])
    a, b = low.band(0.3, 2.0), high.band(0.3, 2.0)
    assert np.array_equal(a, b)
    lifted = high.elevation(b) - 1_737_400.0
    assert lifted == pytest.approx(low.elevation(a), abs=1e-5, nan_ok=True)


def test_memory_is_some_bytes_a_point():
    rng = np.random.default_rng(9)
    quadtree = QuadtreeMap((0.0, 0.0), 20.0)
    selector = SiteSelector(quadtree)
    for _ in range(40):
        xy = rng.uniform(-2.0, 2.0, (5000, 2)) + rng.uniform(-8.0, 8.0, 2)
        quadtree.insert(np.column_stack((xy, 0.1 * rng.random(5000))))
    selector.update()
    t = quadtree.tree
    held = sum(a.nbytes for a in t if isinstance(a, np.ndarray)) + selector.nbytes
    assert quadtree.nbytes < held
    assert held / quadtree.count < 80.0
