"""Test site selection against plain equations of the paper and against a new selector."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.quadtree import (
    SITE_STATUS,
    InterestMap,
    QuadtreeMap,
    SiteSelector,
    SiteSettings,
)
from lunarsim.onboard.hazards.quadtree.sites import select_separated
from tests.reference import quadtree as reference

SMALL = SiteSettings(
    mesh_band=(1.6, 3.2), hazard_band=(0.8, 0.8), site_band=(0.4, 0.8), zone_half_side=1.1, count=4,
    separation=2.0,
)  # fmt: skip


def ground(p):
    """Return wavy terrain with a bump every few metres."""
    bump = np.hypot(p[:, 0] % 5.0 - 2.0, p[:, 1] % 7.0 - 3.0) < 0.4
    return 0.1 * np.sin(p[:, 0] / 4.0) + 0.03 * p[:, 1] + 0.5 * bump


def flash(rng, centre, width, n):
    p = centre + rng.uniform(-0.5 * width, 0.5 * width, (n, 2))
    return np.column_stack((p, ground(p) + rng.normal(0.0, 0.02, n)))


def swept(seed=0, n=20_000, side=19.0):
    rng = np.random.default_rng(seed)
    quadtree = QuadtreeMap((0.0, 0.0, 0.5), 20.0, 0.1)
    quadtree.insert(flash(rng, np.zeros(2), side, n))
    return quadtree


FIELDS = (
    "nodes", "position", "interest", "slope", "ratio", "footprint_ratio", "roughness",
    "relief", "footprint_relief", "points", "fitted_slope", "slope_sigma", "status", "score",
)  # fmt: skip


def squares_within(raster, place, reach):
    """Return the squares of 0.2 m on the map that overlap a zone."""
    first = np.maximum(np.floor((place - reach) / 0.2 + 1e-6).astype(int), 0)
    last = np.ceil((place + reach) / 0.2 - 1e-6).astype(int)
    return raster[first[1] : last[1], first[0] : last[0]]


def assert_same(a, b):
    for name in FIELDS:
        assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True), name
    assert [s.score for s in a.ranked] == [s.score for s in b.ranked]


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    scans=st.lists(
        st.tuples(st.floats(-12, 12), st.floats(-12, 12), st.floats(0.5, 12), st.integers(0, 3000)),
        min_size=1,
        max_size=8,
    ),
    bands=st.sampled_from(
        [((1.6, 1.6), (0.8, 0.8), (0.4, 0.4)), ((0.8, 3.2), (0.4, 1.6), (0.2, 0.8))]
    ),
    thorough=st.booleans(),
)
def test_following_the_map_ends_where_starting_afresh_does(seed, scans, bands, thorough):
    rng = np.random.default_rng(seed)
    quadtree = QuadtreeMap((0.0, 0.0), 20.0, 0.1)
    s = replace(SMALL, mesh_band=bands[0], hazard_band=bands[1], site_band=bands[2])
    following = SiteSelector(quadtree, s, thorough=thorough)
    for x, y, width, n in scans:
        quadtree.insert(flash(rng, np.array([x, y]), width, n))
        if rng.random() < 0.7:
            fresh = SiteSelector(quadtree, s, thorough=thorough).update()
            assert_same(following.update(), fresh)
    assert_same(following.update(), SiteSelector(quadtree, s, thorough=thorough).update())


def test_the_mesh_is_delaunay_and_covers_its_nodes():
    selector = SiteSelector(swept(), SMALL)
    selector.update()
    mesh = selector.mesh
    x, y = mesh.xy.T.astype(float)
    area = 0.0
    for t, (a, b, c) in enumerate(mesh.triangles):
        cross = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        assert cross > 0.0
        area += 0.5 * cross
        # No node is strictly inside the circumcircle.
        ax, ay, bx, by = x[b] - x[a], y[b] - y[a], x[c] - x[a], y[c] - y[a]
        ux = (by * (ax**2 + ay**2) - ay * (bx**2 + by**2)) / (2.0 * cross)
        uy = (ax * (bx**2 + by**2) - bx * (ax**2 + ay**2)) / (2.0 * cross)
        far = np.hypot(x - x[a] - ux, y - y[a] - uy)
        assert far.min() >= np.hypot(ux, uy) - 1e-6
        # Eq. 2.
        p = np.column_stack((x * 0.05, y * 0.05, mesh.z))
        n = np.cross(p[b] - p[a], p[c] - p[a])
        assert mesh.normals[t] == pytest.approx(n / np.linalg.norm(n), abs=1e-12)
    assert area == pytest.approx((x.max() - x.min()) * (y.max() - y.min()))


@pytest.mark.parametrize("form", ["rms", "printed"])
def test_sites_follow_the_equations(form):
    quadtree = swept(1)
    s = replace(SMALL, roughness=form)
    selector = SiteSelector(quadtree, s, thorough=True)
    selection = selector.update()
    mesh, points = selector.mesh, quadtree.points
    corners = mesh.xy[mesh.triangles]
    half = 0.5 * quadtree.min_cell_size
    corner = quadtree.centre[:2] - 0.5 * quadtree.side
    points = points[~quadtree.is_outlier]
    # Hazard cells, Eqs. 3 to 5, in squares of a quarter of their side.
    hazard = quadtree.band(*s.hazard_band)
    seen = 0
    for centre, size in zip(quadtree.centres(hazard), quadtree.sizes(hazard), strict=True):
        at = np.rint((centre - corner) / half)
        normal = reference.steepest_plane(at, corners, mesh.normals)
        low, high = centre - 0.5 * size, centre + 0.5 * size
        mine = points[(points[:, :2] >= low).all(1) & (points[:, :2] < high).all(1)]
        quarters = [
            np.sum(((mine[:, 0] >= centre[0]) == e) & ((mine[:, 1] >= centre[1]) == n))
            for e in (0, 1)
            for n in (0, 1)
        ]
        col, row = np.rint((low - corner) / 0.2).astype(int)
        squares = [a[row : row + 4, col : col + 4] for a in (selector.ratios, selector.reliefs)]
        if min(quarters) < s.min_density * size**2 / 4.0 or normal is None:
            assert np.isnan(squares).all()
            continue
        z = mesh.z[mesh.triangles] + quadtree.centre[2]
        on_mesh = reference.mesh_point(centre, corners * half + corner, z)
        expected = reference.exceptions(mine, low, size, 4, on_mesh, normal, s.roughness_limit)
        assert squares[0] == pytest.approx(expected[0], abs=1e-6, nan_ok=True)
        assert squares[1] == pytest.approx(expected[1], abs=1e-5, nan_ok=True)
        seen += 1
    assert seen > 100
    assert np.nansum(selector.ratios > s.exception_limit) > 20
    # Sites, Eqs. 6 to 9.
    rng = np.random.default_rng(0)
    for i in rng.choice(len(selection.nodes), 150, replace=False):
        r = selection.position[i]
        normal = reference.steepest_plane(np.rint((r[:2] - corner) / half), corners, mesh.normals)
        status = SITE_STATUS[selection.status[i]]
        if normal is None:
            assert status == "no ground plane"
            continue
        assert np.cos(selection.slope[i]) == pytest.approx(normal[2], abs=1e-9)
        if np.any(np.abs(r[:2] - quadtree.centre[:2]) + s.zone_half_side > 0.5 * quadtree.side):
            assert status == "zone leaves the map"
            continue
        zone = squares_within(selector.ratios, r[:2] - corner, s.zone_half_side)
        wider = squares_within(selector.ratios, r[:2] - corner, s.zone_half_side + s.margin)
        expected = (
            "too steep" if normal[2] < np.cos(s.slope_limit)
            else "too few points" if np.isnan(zone).any()
            else "hazard in the zone" if np.nanmax(wider) > s.exception_limit
            else "eligible"
        )  # fmt: skip
        assert status == expected
        if not np.isnan(zone).any():
            rough = reference.roughness(points, r, normal, s.zone_half_side, form == "printed")
            assert selection.roughness[i] == pytest.approx(rough, rel=1e-3, abs=1e-5)
            assert selection.ratio[i] == np.nanmax(wider)
            tall = squares_within(selector.reliefs, r[:2] - corner, s.zone_half_side + s.margin)
            assert selection.relief[i] == np.nanmax(tall)
            middle = squares_within(selector.ratios, r[:2] - corner, 0.6 * s.zone_half_side)
            assert selection.footprint_ratio[i] == middle.max()
            top = squares_within(selector.reliefs, r[:2] - corner, 0.6 * s.zone_half_side)
            assert selection.footprint_relief[i] == np.nanmax(top)
            inside = points[(np.abs(points[:, :2] - r[:2]) <= s.zone_half_side).all(1)]
            assert selection.points[i] == pytest.approx(len(inside), abs=2)
            slope, sigma = reference.fitted_slope(inside)
            assert selection.fitted_slope[i] == pytest.approx(slope, rel=1e-2, abs=1e-5)
            assert selection.slope_sigma[i] == pytest.approx(sigma, rel=1e-2)
        if status == "eligible":
            score = 1000.0 * (1.0 - normal[2]) + 100.0 * selection.roughness[i]
            assert selection.score[i] == pytest.approx(score, rel=1e-9)
        else:
            assert np.isinf(selection.score[i])


@pytest.mark.parametrize("footprint", [None, 1.5])
def test_sites_too_near_to_any_edge_of_the_map_are_rejected(footprint):
    quadtree = QuadtreeMap((3.0, -2.0), 6.4, 0.1)
    quadtree.insert(flash(np.random.default_rng(9), np.array([3.0, -2.0]), 6.4, 8_000))
    s = replace(SMALL, mesh_band=(0.8, 0.8), site_band=(0.4, 0.4))
    selection = SiteSelector(quadtree, s, footprint=footprint).update()
    offset = selection.position[:, :2] - [3.0, -2.0]
    wanted = (np.abs(offset) + max(s.zone_half_side, footprint or 0.0) > 3.2).any(axis=1)
    planned = selection.status != SITE_STATUS.index("no ground plane")
    leaves = selection.status == SITE_STATUS.index("zone leaves the map")
    assert np.array_equal(leaves[planned], wanted[planned])
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        assert (planned & (sign * offset[:, axis] > 2.4)).any()


def test_a_cell_whose_only_point_stands_apart_has_too_few_points():
    rng = np.random.default_rng(10)
    xy = rng.uniform(-3.2, 3.2, (8_000, 2))
    xy = xy[~((xy >= 0.4) & (xy < 0.8)).all(axis=1)]
    points = np.column_stack((xy, rng.normal(0.0, 0.01, len(xy))))
    quadtree = QuadtreeMap((0.0, 0.0), 6.4, 0.1)
    quadtree.insert(np.vstack((points, [[0.6, 0.6, 50.0]])))
    assert quadtree.is_outlier.sum() == 1
    selection = SiteSelector(quadtree, replace(SMALL, site_band=(0.4, 0.4))).update()
    i = np.argmin(np.hypot(*(selection.position[:, :2] - 0.6).T))
    assert selection.position[i, :2] == pytest.approx([0.6, 0.6])
    assert SITE_STATUS[selection.status[i]] == "too few points"


def test_the_board_holds_the_best_at_their_distance():
    rng = np.random.default_rng(2)
    xy, score = rng.uniform(0.0, 20.0, (400, 2)), rng.random(400)
    score[::3] = np.inf
    chosen = select_separated(score, xy, 6, 3.0)
    assert len(chosen) == 6
    assert np.isfinite(score[chosen]).all()
    assert (np.diff(score[chosen]) >= 0.0).all()
    for n, i in enumerate(chosen):
        earlier = xy[chosen[:n]]
        assert (np.hypot(*(earlier - xy[i]).T) >= 3.0).all()
        # A rejected site with a better score is too close to a chosen one.
        for j in np.flatnonzero(score < score[i]):
            if j not in chosen:
                assert np.hypot(*(xy[chosen[:n]] - xy[j]).T).min() < 3.0


def test_printed_roughness_grows_with_observations_and_the_mean_square_does_not():
    plain, twice = swept(4, 8_000), swept(4, 8_000)
    rng = np.random.default_rng(5)
    twice.insert(flash(rng, np.zeros(2), 19.0, 24_000))
    ratio = {}
    for form in ("rms", "printed"):
        s = replace(SMALL, roughness=form, mesh_band=(3.2, 3.2), site_band=(0.8, 0.8))
        a, b = (SiteSelector(q, s).update() for q in (plain, twice))
        both = sorted(set(a.nodes[a.status == 0]) & set(b.nodes[b.status == 0]))
        same = {tuple(p): r for p, r in zip(a.position[:, :2], a.roughness, strict=True)}
        pairs = [
            (same[tuple(p)], r)
            for p, r in zip(b.position[:, :2], b.roughness, strict=True)
            if np.isfinite(r) and np.isfinite(same.get(tuple(p), np.nan))
        ]
        assert len(pairs) > 20, both
        ratio[form] = np.median([r2 / r1 for r1, r2 in pairs])
    assert ratio["rms"] == pytest.approx(1.0, abs=0.1)
    assert ratio["printed"] == pytest.approx(2.0, abs=0.25)


def test_interest_decides_and_its_mistakes_are_named():
    quadtree = swept(6)
    grid = Grid.centred((0.0, 0.0), 20.0, 1.0)
    free = SiteSelector(quadtree, SMALL).update()
    west = np.where(grid.centres()[..., 0] < 0.0, 1.0, 0.0)
    kept = SiteSelector(quadtree, SMALL, InterestMap(grid, west)).update()
    assert {s.position[0] < 0.0 for s in kept.ranked} == {True}
    assert (kept.score[free.position[:, 0] > 0.5] == np.inf).all()
    none = SiteSelector(quadtree, SMALL, InterestMap(grid, np.zeros(grid.shape))).update()
    assert none.ranked == ()
    with pytest.raises(InputError, match="interest"):
        InterestMap(grid, np.zeros((3, 3)))
    for wrong in (-0.1, 1.1, np.nan):
        with pytest.raises(InputError, match="interest"):
            InterestMap(grid, np.full(grid.shape, wrong))


def test_weights_of_zero_rank_by_nothing_and_still_rank():
    s = replace(SMALL, interest_weight=0.0, slope_weight=0.0, roughness_weight=0.0)
    found = SiteSelector(swept(7), s).update()
    assert len(found.ranked) == s.count
    assert {site.score for site in found.ranked} == {0.0}


def test_a_map_without_points_has_no_sites():
    quadtree = QuadtreeMap((0.0, 0.0), 20.0, 0.1)
    selector = SiteSelector(quadtree, SMALL)
    assert selector.update().ranked == ()
    quadtree.insert(np.full((10, 3), np.nan))
    assert selector.update().ranked == ()
    quadtree.insert(np.tile([1.0, 1.0, 0.0], (10_000, 1)))
    assert selector.update().ranked == ()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("slope_limit", 0.0),
        ("roughness_limit", -1.0),
        ("zone_half_side", np.nan),
        ("min_density", -1.0),
        ("exception_limit", 1.0),
        ("slope_weight", -1.0),
        ("interest_weight", np.nan),
        ("mesh_band", (3.2, 1.6)),
        ("site_band", (0.0, 1.0)),
        ("count", 0),
        ("roughness", "median"),
    ],
)
def test_impossible_settings_are_refused(name, value):
    with pytest.raises(InputError, match=f"sites.{name}"):
        replace(SMALL, **{name: value})


def test_a_boulder_in_a_hollow_is_found_and_what_was_not_seen_is_not_clear():
    rng = np.random.default_rng(8)
    xy = rng.uniform(-6.4, 6.4, (100_000, 2))
    z = rng.normal(0.0, 0.01, len(xy))
    hollow = (np.abs(xy - 0.4) < 0.4).all(axis=1)
    boulder = np.hypot(*(xy - 0.5).T) < 0.1
    # Neither is 0.3 m from the surrounding terrain, but one is 0.38 m above the other.
    z += np.where(boulder, 0.18, np.where(hollow, -0.2, 0.0))
    unseen = (np.abs(xy - [-2.3, 1.7]) < 0.1).all(axis=1)
    quadtree = QuadtreeMap((0.0, 0.0), 12.8, 0.1)
    quadtree.insert(np.column_stack((xy, z))[~unseen])
    selector = SiteSelector(quadtree, replace(SMALL, mesh_band=(3.2, 3.2)))
    selector.update()
    # Squares of 0.2 m, from the south-west.
    assert selector.ratios[34, 34] > SMALL.exception_limit
    assert selector.reliefs[34, 34] == pytest.approx(0.38, abs=0.05)
    assert selector.ratios[20:30, 36:50].max() == 0.0
    known = np.isfinite(selector.ratios[32:48, 12:32])
    assert np.argwhere(~known).tolist() == [[8, 8]]
    assert (selector.hazards[33:36, 33:36] == 1.0).all()
    assert np.isnan(selector.hazards[40, 20])


def unseen_by(points):
    """Return unobserved squares of 0.4 m over 25.6 m, for points (n, 3)."""
    quadtree = QuadtreeMap((0.0, 0.0), 25.6, 0.1)
    quadtree.insert(points)
    selector = SiteSelector(quadtree, SiteSettings(mesh_band=(1.6, 3.2)))
    selector.update()
    assert selector.ratios.shape == (64, 64)
    return np.isnan(selector.ratios)


def level(rng, density, half):
    """Return points (n, 3) of flat terrain in a square, with a given density."""
    xy = rng.uniform(-half, half, (rng.poisson(density * (2.0 * half) ** 2), 2))
    return np.column_stack((xy, rng.normal(0.0, 0.01, len(xy))))


@pytest.mark.parametrize("half", [5.0, 5.4, 6.0])
def test_coarse_terrain_beside_a_fine_patch_is_not_evaluated_by_the_points_of_the_patch(half):
    rng = np.random.default_rng(13)
    coarse, fine = level(rng, 18.0, 12.8), level(rng, 1000.0, half)
    alone, both = unseen_by(coarse), unseen_by(np.concatenate((coarse, fine)))
    # A patch ends within cells of 1.6 m: a square outside it holds at most three points.
    assert (both & ~alone).sum() <= 2


def test_a_hole_in_a_patch_that_fills_no_cell_is_seen():
    rng = np.random.default_rng(14)
    coarse, fine = level(rng, 12.0, 12.8), level(rng, 300.0, 0.6)
    points = np.concatenate((coarse, fine))
    # A square in the centre of the patch, at the south-west corner of a cell.
    hole = ((points[:, :2] > 0.0) & (points[:, :2] < 0.4)).all(axis=1)
    assert not unseen_by(points)[32, 32]
    holed = unseen_by(points[~hole])
    assert holed[32, 32]
    # An empty square is not significant with twelve points per square metre.
    assert not unseen_by(coarse[~hole[: len(coarse)]])[32, 32]


def test_what_lies_beyond_the_edge_of_a_scan_was_not_seen():
    rng = np.random.default_rng(15)
    points = level(rng, 300.0, 12.8)
    unseen = unseen_by(points[points[:, 0] < 3.0])
    # A cell ends at 3.2: its last squares hold half of their points, and those beyond none.
    assert not unseen[4:60, 4:39].any()
    assert unseen[:, 40:].all()
    # At the corner of a scan each quarter of a cell has points, but one square has none; at its
    # edge, a line of squares has none.
    corner = unseen_by(points[(points[:, :2] < 2.7).all(axis=1)])
    assert corner[39, 39]
    cut = unseen_by(points[points[:, 0] < 2.7])
    assert cut[4:60, 39].all()
    assert not cut[4:60, 4:38].any()


@pytest.mark.parametrize("seed", range(3))
def test_gaps_are_those_of_a_plain_search(seed):
    rng = np.random.default_rng([17, seed])
    points = np.concatenate([level(rng, 50.0, 12.8), level(rng, 400.0, rng.uniform(7.0, 10.0))])
    lattice = np.arange(-10.8, 11.0, 2.4)
    holes = np.stack(np.meshgrid(lattice, lattice), axis=-1).reshape(-1, 2)
    holes += rng.uniform(-0.4, 0.4, holes.shape)
    # Narrower than a quarter of a cell, all of which needs points.
    wide = rng.uniform(0.25, 0.33, len(holes))
    inside = np.abs(points[:, None, :2] - holes) < wide[:, None]
    points = points[~inside.all(axis=2).any(axis=1)]
    edges = np.linspace(-12.8, 12.8, 65)
    number = np.histogram2d(points[:, 1], points[:, 0], (edges, edges))[0]
    assert unseen_by(points)[5:59, 5:59].sum() > 5
    # Away from the edges of the map, where cells have no plane.
    assert (unseen_by(points) == reference.gaps(number))[5:59, 5:59].all()
