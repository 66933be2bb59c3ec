"""Test the quadtree mapper: map layers, update interval and invalid input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_to_matrix
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.hazards.quadtree import (
    SITE_STATUS,
    InterestMap,
    QuadtreeMap,
    QuadtreeMapper,
    SiteSelector,
    SiteSettings,
)
from lunarsim.onboard.hazards.quadtree.sites import select_separated
from lunarsim.onboard.navigation.estimate import Estimate

SMALL = SiteSettings(
    mesh_band=(1.6, 3.2), hazard_band=(0.8, 0.8), site_band=(0.4, 0.8), zone_half_side=1.1, count=4,
    separation=2.0,
)  # fmt: skip
GRID = Grid.centred((0.0, 0.0), 20.0, 0.2)
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def estimate(position=(0.0, 0.0, 30.0), attitude=(0.0, 0.0, 0.0, 1.0), *, time=0.0, sigma=0.0,
             velocity=(0.0, 0.0, 0.0)) -> Estimate:  # fmt: skip
    return Estimate(
        time, np.array(position, float), np.array(velocity, float), np.array(attitude, float),
        np.zeros(3), 1400.0, sigma**2 * np.eye(9),
    )  # fmt: skip


def scan(n=90, half=0.3, time=0.0, bump=True) -> LidarScan:
    """Return a scan from 30 m vertically above flat terrain with a boulder."""
    t = np.linspace(-half, half, n)
    x, y = (a.ravel() for a in np.meshgrid(t, t))
    rays = np.column_stack((x, y, np.ones(n * n)))
    length = np.linalg.norm(rays, axis=1)
    height = 0.5 * (np.hypot(30.0 * x - 4.0, 30.0 * y) < 0.5) if bump else np.zeros(n * n)
    return LidarScan(
        time=time, range=(30.0 - height) * length, sigma=np.full(n * n, 0.01),
        direction=rays / length[:, None], mount=DOWN, shape=(n, n),
    )  # fmt: skip


def mapper(**options) -> QuadtreeMapper:
    return QuadtreeMapper(GRID, SMALL, **options)


def interest(value=0.25):
    """Return an interest of 0 west of 0.15 m and of `value` east of it."""
    grid = Grid.centred((0.15, 0.0), 22.0, 1.0)  # its cells lie aside of those of the map
    return InterestMap(grid, np.where(grid.centres()[..., 0] < 0.0, 0.0, value))


def test_the_terrain_makes_the_probability_and_the_mission_the_layers():
    free, wanted = mapper(), mapper(interest=interest())
    for m in (free, wanted):
        m.update(scan(), estimate())
    a, b = free.hazard_map(), wanted.hazard_map()
    assert a.observed.any()
    assert np.array_equal(a.p_safe, b.p_safe)
    assert np.array_equal(a.observed, b.observed)
    assert a.value is None
    east = GRID.x > 0.15
    assert (b.value[:, east] == np.float32(0.25)).all()
    assert (b.value[:, ~east] == 0.0).all()
    assert not b.eligible[:, ~east].any()
    assert np.array_equal(a.eligible[:, GRID.x > 1.0], b.eligible[:, GRID.x > 1.0])
    assert a.eligible.any()
    # The limits of the settings define the eligible cells.
    selection = free.select()
    status = selection.status[[
        int(np.argmin(np.hypot(*(selection.position[:, :2] - xy).T)))
        for xy in ((4.0, 0.0), (-4.0, 3.0))
    ]]  # fmt: skip
    assert [SITE_STATUS[i] for i in status] == ["hazard in the zone", "eligible"]
    assert a.eligible_at([[4.0, 0.0], [-4.0, 3.0], [99.0, 0.0]]).tolist() == [False, True, False]


def test_where_no_site_is_eligible_the_terrain_is_as_safe_as_before():
    strict = QuadtreeMapper(GRID, SiteSettings(
        mesh_band=(1.6, 3.2), hazard_band=(0.8, 0.8), site_band=(0.4, 0.8), zone_half_side=1.1,
        exception_limit=0.0, slope_limit=SMALL.slope_limit,
    ), interest=InterestMap(GRID, np.zeros(GRID.shape)))  # fmt: skip
    plain = mapper()
    for m in (strict, plain):
        m.update(scan(), estimate())
    assert strict.select().ranked == ()
    assert not strict.hazard_map().eligible.any()
    assert np.array_equal(strict.hazard_map().p_safe, plain.hazard_map().p_safe)
    assert strict.hazard_map().p_safe.max() > 0.1


def test_a_map_is_drawn_of_the_points_that_its_sites_were_selected_on():
    late, whole = mapper(interval=1e9), mapper()
    late.update(scan(bump=False), estimate())
    late.refresh(0.0)
    late.update(scan(half=0.1), estimate((4.0, 0.0, 30.0)))  # too soon to select again
    late.refresh(1.0)
    whole.update(scan(bump=False), estimate())
    whole.update(scan(half=0.1), estimate((4.0, 0.0, 30.0)))
    a, b = late.hazard_map(), whole.hazard_map()
    for name in ("p_safe", "observed", "elevation", "eligible", "in_domain"):
        assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=name == "elevation")
    # The map stays the same until the next site selection.
    late.update(scan(), estimate())
    assert late.hazard_map() is a


def test_the_board_reports_the_score_of_the_site_flown_to():
    m = mapper(interest=interest(0.5))
    assert m.scoreboard(np.zeros(3)).score.size == 0
    m.update(scan(), estimate())
    selection = m.select()
    good = int(np.argmax(selection.status == 0))
    board = m.scoreboard(selection.position[good])
    assert board.current_site_score == selection.score[good]
    assert np.array_equal(board.score, [s.score for s in selection.ranked])
    assert np.array_equal(board.position, [s.position for s in selection.ranked])
    assert m.scoreboard(np.array([4.0, 0.0, 0.0])).current_site_score == np.inf
    assert m.scoreboard(np.array([400.0, 0.0, 0.0])).current_site_score == np.inf


def test_what_is_mapped_stays_where_it_is_when_the_map_is_laid_again():
    m = mapper(interest=interest())
    m.update(scan(), estimate())
    before, drawn = m.map.points, m.hazard_map()
    # A small move of the target leaves the map unchanged.
    m.recentre(np.array([0.4, 0.2, 0.0]))
    assert np.array_equal(m.map.points, before)
    m.recentre(np.array([5.0, -3.0, 0.5]))
    after = m.map.points
    assert m.grid.centre == pytest.approx((5.0, -3.0), abs=0.2)

    def on_both(points):
        """Return the points on both the new and the old map, sorted."""
        inside = np.ones(len(points), bool)
        for grid in (GRID, m.grid):
            west, east, south, north = grid.extent
            inside &= (points[:, 0] > west + 0.01) & (points[:, 0] < east - 0.01)
            inside &= (points[:, 1] > south + 0.01) & (points[:, 1] < north - 0.01)
        points = points[inside]
        return points[np.lexsort(np.rint(points[:, :2] / 1e-2).T)]

    assert 0.3 < len(on_both(before)) / len(before) < 0.9
    assert len(on_both(after)) == len(on_both(before))
    assert on_both(after) == pytest.approx(on_both(before), abs=1e-3)
    # The boulder stays in place; the interest moves by five metres.
    both = m.hazard_map()
    spot = np.array([4.0, 0.0])
    assert both.elevation_at(spot) == pytest.approx(drawn.elevation_at(spot), abs=0.1)
    assert (both.value[:, both.grid.x < 4.5] == 0.0).all()


def test_a_map_laid_again_takes_interest_along_and_forgets_sites():
    m = mapper(interest=interest())
    m.select()
    m.recentre(np.array([5.0, -3.0, 2.0]))
    value = m.hazard_map().value
    grid = m.hazard_map().grid
    assert grid.centre[:2] == pytest.approx([5.0, -3.0], abs=0.2)
    assert (value[:, grid.x < 4.5] == 0.0).all()
    assert (value[:, grid.x > 5.5] == np.float32(0.25)).all()
    assert m.map.centre[2] == 2.0
    # Sites of the previous map are dropped; the points are kept.
    m = mapper()
    m.update(scan(), estimate())
    before = m.scoreboard(np.zeros(3)).position
    m.recentre(np.array([8.0, -6.0, 0.0]))
    after = m.scoreboard(np.zeros(3)).position
    west, _, _, north = m.grid.extent
    # The side of the quadtree is a power of two of its smallest cells, slightly larger than the
    # map.
    assert ((before[:, 0] < west - 1.0) | (before[:, 1] > north + 1.0)).any()
    assert ((after[:, 0] > west - 1.0) & (after[:, 1] < north + 1.0)).all()


def test_returns_that_never_came_are_no_points():
    lost = scan()
    lost.range[::3] = np.nan
    m = mapper()
    m.update(lost, estimate())
    before = m.map.count
    assert before == np.isfinite(lost.range).sum() > 0
    lost.range[:] = np.nan
    m.update(lost, estimate())
    assert m.map.count == before


def test_nobody_changes_interest_or_sites_after_the_ranking():
    m = mapper(interest=interest())
    m.update(scan(), estimate())
    selection = m.select()
    for array in (selection.score, selection.status, selection.interest, selection.position):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        m.selector.interest.value[0, 0] = 1.0
    with pytest.raises(AttributeError):
        m.selector.interest = None
    with pytest.raises(ValueError, match="read-only"):
        m.selector.ratios[0, 0] = 0.0
    # The map copies its input.
    given = np.full(GRID.shape, 1.0)
    kept = InterestMap(GRID, given)
    given[:] = 0.0
    assert (kept.value == 1.0).all()


def test_eq_9_counts_interest():
    quadtree = QuadtreeMap((0.0, 0.0), 20.0)
    rng = np.random.default_rng(0)
    xy = rng.uniform(-9.5, 9.5, (20_000, 2))
    quadtree.insert(np.column_stack((xy, rng.normal(0.0, 0.01, 20_000))))
    plain = SiteSelector(quadtree, SMALL).update()
    given = SiteSelector(quadtree, SMALL, interest(0.25)).update()
    good = given.status == 0
    assert good.sum() > 50
    more = given.score[good] - plain.score[good]
    assert more == pytest.approx(np.full(good.sum(), SMALL.interest_weight * 0.75), abs=1e-9)
    # All three terms, computed by hand.
    score = (
        SMALL.interest_weight * (1.0 - given.interest[good])
        + SMALL.slope_weight * (1.0 - np.cos(given.slope[good]))
        + SMALL.roughness_weight * given.roughness[good]
    )
    assert given.score[good] == pytest.approx(score, abs=1e-6)
    assert [s.interest for s in given.ranked] == [0.25] * len(given.ranked)


def test_costs_that_are_no_numbers_are_refused():
    xy = np.zeros((3, 2))
    with pytest.raises(InputError, match=r"sites\.score"):
        select_separated(np.array([1.0, np.nan, 2.0]), xy, 2, 1.0)
    with pytest.raises(InputError, match=r"sites\.xy"):
        select_separated(np.array([1.0, 2.0]), xy, 2, 1.0)


def test_terrain_seen_with_a_wrong_tilt_is_turned_and_what_came_later_stays():
    tilt, pivot = np.deg2rad(1.5), np.array([2.0, 0.0, 0.0])
    wrong = quat_from_rotation_vector([0.0, tilt, 0.0])
    turn = quat_to_matrix(quat_from_rotation_vector([0.0, -tilt, 0.0]))
    found = mapper()
    flat = scan(bump=False)
    # The pose is above the pivot: the rotation about it corrects the pose.
    found.update(flat, estimate((2.0 + 30.0 * np.sin(tilt), 0.0, 30.0 * np.cos(tilt)), wrong,
                                sigma=np.deg2rad(1.0)))  # fmt: skip
    first = found.map.points
    assert np.ptp(first[:, 2]) > 0.3
    found.update(flat, estimate(sigma=np.deg2rad(0.01)))
    count = found.map.count
    found.correct_tilt(turn, pivot, np.deg2rad(0.01))
    assert np.abs(found.map.points[:, 2]).max() < 0.01
    # Only points that moved over the edge of the map are lost.
    assert count - 600 < found.map.count <= count
    assert found.noise > 0.0
    assert not found.select().ranked or found.select().ranked[0].slope < np.deg2rad(0.5)
    # The tilt is then known: another rotation moves nothing.
    before = found.map.points
    found.correct_tilt(turn, pivot, np.deg2rad(0.01))
    assert np.array_equal(found.map.points, before)
    # A later scan with an uncertain tilt does not move the other points.
    found.update(flat, estimate(sigma=np.deg2rad(1.0)))
    before = found.map.points
    found.correct_tilt(turn, pivot, np.deg2rad(1.0))
    assert np.array_equal(found.map.points, before)


@pytest.mark.parametrize(
    ("field", "value", "name"),
    [
        ("sigma", np.nan, "scan.sigma"), ("sigma", 0.0, "scan.sigma"),
        ("sigma", -0.01, "scan.sigma"), ("range", -30.0, "scan.range"),
    ],
)  # fmt: skip
def test_impossible_scans_are_refused_and_change_nothing(field, value, name):
    tree = mapper()
    good = scan(n=30)
    bad = getattr(good, field).copy()
    bad[5] = value
    with pytest.raises(InputError, match=name):
        tree.update(replace(good, **{field: bad}), estimate())
    assert tree.is_empty
    assert tree.noise == 0.0


@pytest.mark.parametrize("interval", [-1.0, np.nan, np.inf])
def test_impossible_intervals_are_refused(interval):
    with pytest.raises(InputError, match="interval"):
        mapper(interval=interval)


def test_a_masked_interest_is_refused():
    with pytest.raises(InputError, match="interest"):
        InterestMap(GRID, np.ma.masked_array(np.ones(GRID.shape), np.ones(GRID.shape, bool)))
