"""Association, tracking, probabilities and the map."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lunarsim.errors import InputError
from lunarsim.evaluation.classification import RELIABILITY_EDGES, classify
from lunarsim.evaluation.reliability import reliability
from lunarsim.grid import Grid
from lunarsim.onboard.hazards.shadows import (
    HazardPrior,
    ProbabilityMap,
    RockTracker,
    TrackerSettings,
    cover_probability,
)
from lunarsim.onboard.hazards.shadows import _probability_kernels as kernels
from lunarsim.onboard.hazards.shadows.association import GATE, associate
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import detect_rocks
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.rocks.field import RockField
from lunarsim.rocks.laws import golombek_cover, golombek_number
from lunarsim.world.terrain import Terrain
from tests.worlds import flat_terrain
from tests.onboard.perception.test_shadow_detector import SUN, at, picture, rocks_on_a_plane
from tests.reference.shadows import rice

MODEL = ShadowModel(np.radians(20.0))
GRID = Grid.centred((0.0, 0.0), 40.0, 0.25)


def tracker_at(position, **settings):
    state, _ = at(position)
    inertial = StrapdownState(state.position, np.zeros(3), state.attitude, 1.622)
    rocks = RockFilter(inertial, StartSigmas(1e-3, 1e-3, 1e-5))
    return RockTracker(rocks, MODEL, settings=TrackerSettings(**settings))


def follow(terrain, path, tracker, mapping=None):
    """Take one picture from each place on a path; the lander's own motion is known."""
    for k, position in enumerate(path):
        state, camera, counts = picture(terrain, position)
        tracker.filter.inertial._x[:3] = state.position
        seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
        tracker.update(seen, camera, SUN, 0.1 * k)
        if mapping is not None:
            mapping.see(camera, camera.view(state), SUN, seen)
    return tracker


# --- association --------------------------------------------------------------------------


def test_association_is_the_best_of_all_assignments():
    rng = np.random.default_rng(1)
    for _ in range(30):
        d, t = rng.integers(1, 5, 2)
        pixel, rocks = 5.0 * rng.random((d, 2)), 5.0 * rng.random((t, 2))
        radius, size = rng.random(d), rng.random(t)
        eye = np.eye(2)
        i, j, _, _ = associate(
            pixel, np.tile(eye, (d, 1, 1)), radius, np.full(d, 0.1),
            rocks, np.tile(0.5 * eye, (t, 1, 1)), size, np.full(t, 0.1),
        )  # fmt: skip
        cost = ((pixel[:, None] - rocks) ** 2).sum(-1) / 1.5 + (radius[:, None] - size) ** 2 / 0.2

        def total(choice, cost=cost):
            return sum(GATE if k < 0 else cost[n, k] for n, k in enumerate(choice))

        choices = (
            c for c in product(range(-1, t), repeat=d)
            if len({k for k in c if k >= 0}) == sum(k >= 0 for k in c)
        )  # fmt: skip
        mine = np.full(d, -1)
        mine[i] = j
        assert total(mine) == pytest.approx(min(total(c) for c in choices))


def test_a_pair_with_a_rival_is_not_sure():
    eye = np.tile(np.eye(2), (2, 1, 1))
    rocks = np.array([[0.0, 0.0], [1.0, 0.0]])
    near = np.array([[0.4, 0.0], [30.0, 0.0]])
    one = np.ones(2)
    i, j, sure, close = associate(near, eye, one, one, rocks, eye, one, one)
    assert (i.tolist(), j.tolist(), sure.tolist()) == ([0], [0], [False])
    assert close.tolist() == [True, False]
    far = np.array([[0.0, 0.0], [20.0, 0.0]])
    _, _, sure, _ = associate(far, eye, one, one, far, eye, one, one)
    assert sure.all()


def test_nothing_seen_or_nothing_tracked():
    empty, eye = np.empty((0, 2)), np.empty((0, 2, 2))
    none = np.empty(0)
    i, j, sure, close = associate(empty, eye, none, none, empty, eye, none, none)
    assert len(i) == len(j) == len(sure) == len(close) == 0


# --- tracking -----------------------------------------------------------------------------


def test_rocks_are_tracked_once_each_and_their_places_sharpen():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    path = [(-30.0 + 3.0 * k, 10.0, 90.0 - 3.0 * k) for k in range(15)]
    tracker = follow(terrain, path, tracker_at(path[0]))
    true = np.column_stack((terrain.rocks.x, terrain.rocks.y))
    distance, nearest = cKDTree(true).query(tracker.filter.xy)
    good = distance < 0.5 * terrain.rocks.a[nearest]
    assert good.mean() > 0.85
    # Few doubles.
    assert len(np.unique(nearest[good])) > 0.95 * good.sum()
    assert np.median(distance[good]) < 0.15
    ratio = tracker.filter.radius[good] / terrain.rocks.a[nearest[good]]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert np.median(tracker.existence[good]) > 0.99


def test_a_cluster_seen_as_one_is_split_when_it_is_resolved():
    tracker = tracker_at((0.0, 0.0, 60.0))
    state, camera = at((0.0, 0.0, 60.0))
    tracker.add_known([[0.0, 0.0]], 0.3, 2.0, 0.5)
    rocks = RockField.hemispheres([-1.1, 1.1], [0.4, -0.4], 0.0, 0.6)
    pair = Terrain(flat_terrain(400.0, 10.0).relief, rocks)
    state, camera, counts = picture(pair, (0.0, 0.0, 60.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    assert len(seen) == 2
    tracker.update(seen, camera, SUN, 0.0)
    assert tracker.filter.count == 2
    assert np.sort(tracker.filter.xy[:, 0]) == pytest.approx([-1.1, 1.1], abs=0.25)


def test_doubles_are_merged_and_ghosts_pruned():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=30, size=60.0)
    big = int(np.argmax(terrain.rocks.a))
    place = np.array([terrain.rocks.x[big], terrain.rocks.y[big]])
    tracker = tracker_at((0.0, 0.0, 50.0))
    # The same rock twice, and one where there is none.
    ghost = np.array([3.0, -2.0])
    away = np.hypot(*(np.column_stack((terrain.rocks.x, terrain.rocks.y)) - ghost).T)
    assert away.min() > 1.5
    tracker.add_known([place, place + 0.2, ghost], 0.05, [1.0, 1.0, 1.0], 0.2)
    follow(terrain, [(0.0, 0.0, 50.0)] * 25, tracker)
    near = np.hypot(*(tracker.filter.xy - place).T) < 1.0
    assert near.sum() == 1
    assert np.hypot(*(tracker.filter.xy - ghost).T).min() > 0.8


def test_known_rocks_must_be_numbers():
    with pytest.raises(InputError, match=r"rocks\.known"):
        tracker_at((0.0, 0.0, 50.0)).add_known([[0.0, 0.0]], -1.0, 1.0, 0.1)


def test_most_rocks_is_a_limit():
    terrain = rocks_on_a_plane("hemisphere", seed=11)
    tracker = follow(terrain, [(0.0, 0.0, 60.0)] * 2, tracker_at((0.0, 0.0, 60.0), most_rocks=7))
    assert tracker.filter.count <= 7
    assert len(tracker.tentative.xy) > 0


def test_rocks_out_of_view_rest_in_large_maps():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    high, low = (1.0, 0.0, 70.0), (1.0, 0.0, 20.0)  # the camera looks at the middle
    moved = {}
    for above in (0, 1000):
        tracker = follow(terrain, [high] * 6, tracker_at(high, large=above))
        before = tracker.filter.xy.copy()
        follow(terrain, [low] * 2, tracker)
        away = np.array([(np.abs(tracker.filter.xy - xy).max(1) > 0.0).all() for xy in before])
        moved[above] = away.mean()
    assert moved[0] < 0.3
    assert moved[1000] > 0.9


def test_radii_of_all_rocks_seen_are_corrected():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    path = [(0.0, 0.0, 60.0)] * 8
    few, all_of_them = (
        follow(terrain, path, tracker_at(path[0], most_updates=n)) for n in (1, 1000)
    )
    assert few.filter.count == all_of_them.filter.count > 20
    assert few.filter.radius_variance == pytest.approx(all_of_them.filter.radius_variance, rel=0.05)
    own = [np.trace(t.filter.rock_covariance(), axis1=1, axis2=2) for t in (few, all_of_them)]
    assert np.median(own[0]) > 2.0 * np.median(own[1])


# --- probabilities ------------------------------------------------------------------------


def test_rice_form_equals_the_reference():
    rng = np.random.default_rng(2)
    for _ in range(60):
        sigma, mean = rng.uniform(0.02, 0.6), rng.uniform(0.1, 1.5)
        spread, d = rng.uniform(0.02, 0.4) * mean, rng.uniform(0.0, 3.0)
        found = cover_probability([[d]], [sigma], [mean], [spread])[0, 0]
        assert found == pytest.approx(rice(d, sigma, mean, spread), abs=2e-3)


def test_rice_form_equals_monte_carlo():
    rng = np.random.default_rng(3)
    centre = 0.3 * rng.standard_normal((400_000, 2))
    radius = 0.8 + 0.15 * rng.standard_normal(400_000)
    for d in (0.0, 0.5, 1.0, 1.6):
        share = np.mean(np.hypot(centre[:, 0] - d, centre[:, 1]) <= radius)
        found = cover_probability([[d]], [0.3], [0.8], [0.15])[0, 0]
        assert found == pytest.approx(share, abs=3e-3)


def test_the_papers_form_never_says_less():
    """Eqs. 17-21 add the centre's error to the radius whatever its direction."""
    d = np.linspace(0.0, 3.0, 61)[None, :]
    exact = cover_probability(d, [0.2], [0.6], [0.1], "rice")
    fit = cover_probability(d, [0.2], [0.6], [0.1], "gaussian")
    assert (fit >= exact - 1e-3).all()
    assert fit.max() <= 1.0
    assert (fit - exact).max() > 0.1  # and the difference is not small


def test_rates_are_cut_lines():
    rates = DetectionRates((2.0, -0.5, 0.05), (0.2, -0.1, 0.01))
    assert rates.false_negative([0.0, 2.0, 3.0, 100.0]) == pytest.approx([1.0, 1.0, 0.5, 0.05])
    assert rates.false_positive([0.0, 1.0, 5.0]) == pytest.approx([0.2, 0.1, 0.01])
    assert rates.least_q == pytest.approx(2.0)
    with pytest.raises(InputError, match=r"rates\.missed"):
        DetectionRates((1.0, 0.3, 0.1))


def test_map_begins_with_the_prior_and_falls_by_eq_14():
    prior = HazardPrior(0.07, 0.4)
    mapping = ProbabilityMap(GRID, MODEL, prior)
    tracker = tracker_at((0.0, 0.0, 60.0))
    start = mapping.probability(tracker)
    assert start == pytest.approx(float(golombek_cover(0.4, 0.07)), rel=1e-5)
    assert not mapping.observed.any()
    # A rate that is 1 below a resolution and 0 above is Eq. 14.
    step = DetectionRates((1001.0, -500.0, 1e-9))
    sharp = ProbabilityMap(GRID, MODEL, prior, step)
    state, camera, counts = picture(rocks_on_a_plane("hemisphere", count=1), (0.0, 0.0, 150.0))
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    view = camera.view(state)
    sharp.see(camera, view, SUN, seen)
    q = float(MODEL.visible_pixels(1.0, 0.0, np.pi / 2, 150.0 / camera.fx))
    resolved = 2.0 * 2.0 / q
    expected = golombek_cover(0.4, 0.07) - golombek_cover(max(resolved, 0.4), 0.07)
    middle = sharp.probability(tracker)[80, 80]
    # Sizes are taken in 24 classes.
    assert middle == pytest.approx(float(expected), abs=0.15 * float(golombek_cover(0.4, 0.07)))


def test_paint_equals_a_plain_loop():
    rng = np.random.default_rng(4)
    xy = rng.uniform(-22.0, 22.0, (40, 2))
    reach = rng.uniform(0.5, 3.0, 40)
    profile = np.sort(rng.random((40, 33)), axis=1)[:, ::-1].copy()
    profile[:, -1] = 0.0
    weight = rng.random(40)
    clear = np.ones(GRID.shape)
    kernels.paint(clear, GRID.x0, GRID.y0, GRID.posting, xy, reach, profile, weight)
    expected = np.ones(GRID.shape)
    for i, j in product(range(0, GRID.rows, 3), range(0, GRID.cols, 3)):
        for k in range(40):
            d = np.hypot(GRID.x[j] - xy[k, 0], GRID.y[i] - xy[k, 1])
            p = np.interp(d / reach[k] * 32, np.arange(33), profile[k], right=0.0)
            expected[i, j] *= 1.0 - weight[k] * p
    assert clear[::3, ::3] == pytest.approx(expected[::3, ::3], abs=1e-12)


def test_map_is_a_probability_and_knows_the_rocks():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    path = [(-20.0 + 2.0 * k, 10.0, 80.0 - 3.0 * k) for k in range(12)]
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    tracker = follow(terrain, path, tracker_at(path[0]), mapping)
    p = mapping.probability(tracker)
    assert p.min() >= 0.0
    assert p.max() <= 1.0
    rock = terrain.rock_raster(GRID)
    assert p[rock >= 0].mean() > 20.0 * p[rock < 0].mean()
    result = classify(p, rock >= 0)
    assert result.rates["clear_recall"] > 0.5
    assert result.rates["clear_false"] < 0.0025
    table = reliability(p, rock >= 0, RELIABILITY_EDGES)
    assert table[:, 0].sum() == p.size
    assert len(table) == len(RELIABILITY_EDGES) - 1


def test_footprint_map_is_the_more_careful_and_keeps_off_the_edge():
    terrain = rocks_on_a_plane("hemisphere", seed=11, count=60, size=60.0)
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    tracker = follow(terrain, [(0.0, 0.0, 55.0)] * 3, tracker_at((0.0, 0.0, 55.0)), mapping)
    point, wide = mapping.probability(tracker), mapping.probability(tracker, 1.5)
    assert (wide >= point - 1e-6).all()
    hazard_map = mapping.hazard_map(tracker, 1.5)
    assert not hazard_map.observed[:6].any()
    assert not hazard_map.observed[:, -6:].any()
    assert hazard_map.observed[80, 80]
    assert (hazard_map.p_safe[~hazard_map.observed] == 0.0).all()
    inside = hazard_map.observed
    assert hazard_map.p_safe[inside] == pytest.approx(1.0 - wide[inside], abs=1e-6)


def test_footprint_prior_counts_rocks_that_reach_in():
    """Against a Monte Carlo over Poisson fields of discs by the same law."""
    mapping = ProbabilityMap(GRID, MODEL, HazardPrior(0.05, 0.5))
    p = float(mapping.probability(tracker_at((0.0, 0.0, 60.0)), 1.0)[0, 0])
    edges = np.geomspace(0.5, 4.0, 2000)
    number = -np.diff(golombek_number(edges, 0.05))
    middle = 0.5 * (edges[1:] + edges[:-1])
    expected = 1.0 - np.exp(-np.sum(number * np.pi * (1.0 + 0.5 * middle) ** 2))
    assert p == pytest.approx(expected, rel=0.02)


def test_dark_ground_is_not_seen():
    mapping = ProbabilityMap(GRID, MODEL)
    terrain = rocks_on_a_plane("hemisphere", count=1)
    state, camera, counts = picture(terrain, (0.0, 0.0, 60.0))
    counts = counts.copy()
    counts[200:280, 280:360] = 0
    seen = detect_rocks(counts, camera, state, SUN, model=MODEL)
    mapping.see(camera, camera.view(state), SUN, seen)
    assert not mapping.observed[80, 80]
    assert mapping.observed[10, 10]


def test_a_camera_that_looks_at_the_sky_changes_nothing():
    mapping = ProbabilityMap(GRID, MODEL)
    state, camera = at((0.0, 0.0, 60.0))
    sky = replace(camera, mount=camera.mount @ np.diag([1.0, -1.0, -1.0]))
    image = np.full((480, 640), 100, np.uint8)
    seen = detect_rocks(image, sky, state, SUN, model=MODEL)
    mapping.see(sky, sky.view(state), SUN, seen)
    assert not mapping.observed.any()
    tracker = tracker_at((0.0, 0.0, 60.0))
    tracker.add_known([[0.0, 0.0]], 0.1, 1.0, 0.1)
    tracker.update(seen, sky, SUN, 0.0)
    assert tracker.filter.count == 1
    assert np.isfinite(tracker.filter.covariance).all()


def test_prior_must_make_sense():
    with pytest.raises(InputError, match=r"prior\.least_diameter"):
        HazardPrior(0.05, 5.0)
    with pytest.raises(InputError, match="cover"):
        HazardPrior(0.9)


def test_classification_counts():
    p = np.array([[0.001, 0.001, 0.9, 0.9, 0.5]], np.float32)
    occupied = np.array([[False, True, True, False, False]])
    rates = classify(p, occupied).rates
    assert rates == {
        "clear_recall": pytest.approx(1 / 3), "occupied_called_clear": 0.5, "clear_false": 0.5,
        "occupied_correct": 0.5, "unknown": pytest.approx(0.2),
    }  # fmt: skip
