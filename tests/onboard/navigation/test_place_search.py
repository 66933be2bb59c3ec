"""Test the place search against simple references, and on wrong maps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation import map_features
from lunarsim.onboard.navigation.map_features import (
    CHANGED_PROBABILITY,
    FeatureTile,
    MapFeatures,
    forecast_lock,
    subtract_plane,
)
from lunarsim.onboard.navigation.place_search import PlaceSearch
from lunarsim.onboard.navigation.submap import Submap
from lunarsim.world.survey import simulate_survey
from lunarsim.world.terrain import hazard_field
from tests.reference import places as plain

POSTING = 1.0


def bumps(rng, shape, height=0.3, share=0.04):
    """Return flat terrain with single bumps."""
    return height * (rng.random(shape) < share)


def small_map(rng, ground, sigma=0.1, voids=0):
    elevation = ground + sigma * rng.standard_normal(ground.shape)
    elevation.flat[rng.choice(elevation.size, voids, replace=False)] = np.nan
    return PriorMap(Grid(0.0, 0.0, POSTING, *ground.shape), elevation, sigma)


def points_of(ground, rows, cols, shift=(0.0, 0.0, 0.0), per=4):
    """Return evenly spread points on posts, seen with a position error `shift`."""
    u = (np.arange(per) + 0.5) / per - 0.5
    x = (np.arange(*cols)[:, None] + u).ravel()
    y = (np.arange(*rows)[:, None] + u).ravel()
    xx, yy = np.meshgrid(x, y)
    z = np.repeat(np.repeat(ground[slice(*rows), slice(*cols)], per, 0), per, 1)
    return np.column_stack((xx.ravel(), yy.ravel(), z.ravel())) - shift


def test_planes_are_those_of_least_squares():
    rng = np.random.default_rng(0)
    height = rng.standard_normal((22, 26)) + 0.3 * np.arange(26)
    known = rng.random(height.shape) < 0.9
    known[:, 14:16] = False
    above, kept = subtract_plane(height, known, 3)
    expected = plain.above_plane(height, known, 3)
    assert 150 < kept.sum() < known.sum()
    # All kept posts have a plane; the others are at an edge or have few known posts.
    assert not np.isnan(expected[kept]).any()
    assert above[kept] == pytest.approx(expected[kept], abs=1e-9)
    assert not above[~kept].any()
    inner = np.zeros_like(kept)
    inner[3:-3, 3:9] = True
    assert kept[inner & known].all()


def test_features_are_what_stands_out():
    xx, yy = np.meshgrid(np.arange(40.0), np.arange(30.0))
    known = np.ones(xx.shape, bool)
    known[10, 20] = known[22, 5] = False
    above, kept = subtract_plane(0.3 * xx - 0.2 * yy + 5.0, known, 3)
    assert above == pytest.approx(0.0, abs=1e-9)
    # A void removes only itself.
    assert kept[3:-3, 3:-3].sum() == 34 * 24 - 2


def test_likelihoods_are_those_of_the_reference(monkeypatch):
    monkeypatch.setattr(map_features, "CORRELATION_LENGTH_M", 1.3)
    rng = np.random.default_rng(1)
    ground = bumps(rng, (40, 44))
    features = MapFeatures(small_map(rng, ground, voids=60))
    shown = np.where(features.known > 0.0, features.feature_height, np.nan).astype(float)
    rare = plain.rarity(shown[np.isfinite(shown)], 0.1)(shown)
    tile = ground[10:18, 20:27] + 0.02 * rng.standard_normal((8, 7))
    weight = (rng.random(tile.shape) < 0.8).astype(float)
    variance = 0.011 + 0.01 * rng.random(tile.shape)
    row, col = (part.ravel() for part in np.mgrid[-3:38:3, -4:42:3])
    ratio, share = features.log_likelihood_ratios(FeatureTile(tile, weight, variance), row, col)
    masked = np.where(weight > 0.0, tile, np.nan)
    for n in range(len(row)):
        expected = plain.tile_ratio(
            shown, rare, masked, variance, row[n], col[n], 0.05, features.correlated_count
        )
        assert (ratio[n], share[n]) == pytest.approx(expected, abs=2e-4)
    assert features.correlated_count == pytest.approx(1.3**2)


def test_the_evidence_is_that_of_the_reference():
    rng = np.random.default_rng(2)
    ground = bumps(rng, (40, 40), height=0.2)
    prior = small_map(rng, ground, sigma=0.12, voids=10)
    features = MapFeatures(prior)
    search = PlaceSearch(features)
    search.add(points_of(ground, (10, 30), (10, 30)))
    mean, covariance = np.zeros(2), np.eye(2) * 3.0**2
    search.search(0.0, mean, covariance)
    match = search.search(2.0, mean, covariance)
    found, origin = search.log_likelihood
    assert search.spacing == 0.5 * POSTING
    # Reference: scanned heights above their planes, in tiles, at whole-post shifts.
    own, added = np.full((40, 40), np.nan), np.zeros((40, 40))
    scanned = ground[10:30, 10:30]
    own[10:30, 10:30] = plain.above_plane(scanned, np.ones((20, 20), bool), features.reach)
    added[10:30, 10:30] = plain.beside(scanned, features.reach)
    shown = np.where(features.known > 0.0, features.feature_height, np.nan).astype(float)
    rare = plain.rarity(shown[np.isfinite(shown)], prior.sigma)(shown)
    every = list(zip(*np.nonzero(features.known), strict=True))
    n, wide, tile_count = np.arange(-3, 4), 8, 0
    expected = np.zeros((7, 7))
    for r0 in range(8, 32, wide):
        for c0 in range(8, 32, wide):
            cut = (slice(r0, r0 + wide), slice(c0, c0 + wide))
            if np.isfinite(own[cut]).sum() < 0.25 * wide * wide:
                continue
            tile_count += 1
            of = (shown, rare, own[cut], features.variance + added[cut])
            rest = (0.05, features.correlated_count)
            here = [plain.tile_ratio(*of, r0 + a, c0 + b, *rest) for a in n for b in n]
            there = [plain.tile_ratio(*of, r - 4, c - 4, *rest) for r, c in every]
            factors = plain.log_factors(
                *zip(*here, strict=True),
                *zip(*there, strict=True),
                CHANGED_PROBABILITY,
            )
            expected += np.reshape(factors, (7, 7))
    assert tile_count >= 4
    mine = found[2 * n[0] - origin[0] :: 2, 2 * n[0] - origin[1] :: 2][:7, :7]
    assert mine == pytest.approx(expected, abs=0.02)
    assert 3.0 < np.ptp(expected) < 12.0
    # The place from all searched half-post shifts.
    rows, cols = (part.ravel() for part in np.indices(found.shape))
    shifts = 0.5 * POSTING * np.column_stack((cols + origin[1], rows + origin[0]))
    p = plain.posterior(found.ravel(), shifts, mean, covariance)
    near = np.hypot(*(shifts - shifts[np.argmax(p)]).T) <= 1.5 * POSTING + 1e-9
    assert match.certainty == pytest.approx(p[near].sum(), abs=2e-3)
    assert match.shift[:2] == pytest.approx(p[near] @ shifts[near] / p[near].sum(), abs=1e-6)


def swept(seed=3, **options):
    """A hazard field, its map, and the points of two scans of it."""
    rng = np.random.default_rng(seed)
    terrain = hazard_field(rng, size=60.0, surround=120.0, boulders=150, craters=20)
    prior = simulate_survey(terrain, Grid.centred((0.0, 0.0), 110.0, 0.5), rng, **options)
    x = np.arange(-20.0, 20.0, 0.12)
    xx, yy = np.meshgrid(x, x)
    xy = np.column_stack((xx.ravel(), yy.ravel()))
    return prior, np.column_stack((xy, terrain.elevation(xy)))


SHIFT = np.array([9.2, -6.7, 4.0])


def found_on(prior, points, sigma=8.0):
    search = PlaceSearch(MapFeatures(prior))
    search.add(points - SHIFT)
    search.search(0.0, np.zeros(2), np.eye(2) * sigma**2)
    return search, search.search(2.0, np.zeros(2), np.eye(2) * sigma**2)


@pytest.mark.parametrize(
    "options",
    [
        {"sigma": 0.1},
        {"sigma": 0.2},
        {"sigma": 0.1, "void_fraction": 0.05},
        {"sigma": 0.1, "correlation": 0.4},
    ],
    ids=str,
)
def test_it_finds_the_place(options):
    prior, points = swept(**options)
    _, match = found_on(prior, points)
    assert match.certainty > 0.99999
    assert match.agreeing_fraction > 0.9
    gap = match.shift - SHIFT
    assert (np.abs(gap[:2]) < 4.0 * np.sqrt(np.diag(match.covariance))[:2]).all()
    assert abs(gap[2]) < 0.25
    assert match.vertical_shift == pytest.approx(SHIFT[2], abs=0.25)


def test_ten_voids_change_nothing_much():
    prior, points = swept(sigma=0.1)
    whole = found_on(prior, points)[0].log_likelihood[0]
    elevation = prior.elevation.copy()
    elevation.flat[np.random.default_rng(0).choice(elevation.size, 10)] = np.nan
    pierced = found_on(PriorMap(prior.grid, elevation, 0.1), points)[0].log_likelihood[0]
    assert pierced.max() > 0.9 * whole.max() > 20.0


def test_a_post_is_compared_once():
    prior, points = swept(sigma=0.1)
    search, match = found_on(prior, points)
    before = search.log_likelihood[0].copy()
    for n in range(4):
        search.add(points - SHIFT)
        again = search.search(3.0 + n, np.zeros(2), np.eye(2) * 8.0**2)
    assert np.array_equal(search.log_likelihood[0], before)
    assert again.certainty == match.certainty
    search.restart()
    assert search.search(9.0, np.zeros(2), np.eye(2) * 8.0**2) is None


def test_changed_terrain_speaks_against_a_place_by_no_more_than_allowed():
    features = MapFeatures(swept(sigma=0.1)[0])
    factors = features.log_factor(np.array([-1e4, 0.0, 30.0]), np.array([1.0, 0.0, 1.0]), 5.0, 1e6)
    changed = CHANGED_PROBABILITY
    # Worst fit, unknown map, and maximum evidence of one tile.
    assert factors[0] == pytest.approx(np.log(changed))
    assert factors[1] == pytest.approx(0.0, abs=1e-12)
    assert factors[2] == pytest.approx(np.log(0.8 * 1e6 + 0.2), abs=1e-6)
    # On average over all places a tile gives no evidence.
    assert np.exp(
        features.log_factor(np.log([1.0, 2.0, 3.0]), np.ones(3), np.log(2.0), 1e6)
    ).mean() == (pytest.approx(1.0))


def test_drift_blurs_what_is_known():
    prior, points = swept(sigma=0.1)
    search, match = found_on(prior, points)
    before = search.log_likelihood[0].copy()
    spread = [match.covariance[0, 0]]
    for n in range(3):
        later = search.search(4.0 + 2.0 * n, np.zeros(2), np.eye(2) * 8.0**2, speed_sigma=0.2)
        spread.append(later.covariance[0, 0])
    assert np.all(np.diff(spread) > 0.0)
    assert later.certainty < 0.95 < match.certainty
    # Blurring does not increase the total probability.
    after = search.log_likelihood[0]
    assert np.exp(after).sum() == pytest.approx(np.exp(before).sum(), rel=0.05)


def test_places_drift_by_a_speed_that_stays_wrong_for_seconds():
    search, _ = found_on(swept(sigma=0.1)[0], swept(sigma=0.1)[1])
    before = search.log_likelihood[0].copy()
    search.search(5.0, np.zeros(2), np.eye(2) * 8.0**2, speed_sigma=0.15)
    # 3 s on: a speed that is drawn anew every 4 s has gone sqrt(3 x 4) of it.
    wide = 0.15 * np.sqrt(3.0 * 4.0) / search.spacing
    expected = ndimage.gaussian_filter(np.exp(before - before.max()), wide, mode="nearest")
    after = np.exp(search.log_likelihood[0] - before.max())
    np.testing.assert_allclose(after, expected, atol=1e-9)


def test_a_height_is_estimated_from_posts_that_agree():
    prior, points = swept(sigma=0.1)
    _, match = found_on(prior, points)
    # Many posts; a position known to half a post leaves a height error on slopes.
    assert match.covariance[2, 2] == pytest.approx((0.4 * 0.5) ** 2, rel=0.1)
    changed = points.copy()
    changed[changed[:, 0] > 8.0, 2] += 1.5 * np.sin(3.0 * changed[changed[:, 0] > 8.0, 1])
    _, other = found_on(prior, changed)
    assert other.agreeing_fraction < 0.9 * match.agreeing_fraction


def test_probability_outside_search_is_kept():
    prior, points = swept(sigma=0.1)
    # 9 m off at a stated 1.5 m: six deviations.
    _, match = found_on(prior, points, sigma=1.5)
    assert match.certainty < 0.99999 or np.abs(match.shift - SHIFT).max() < 1.0


def test_places_that_are_not_looked_at_keep_their_share_of_what_was_known():
    rng = np.random.default_rng(5)
    prior = small_map(rng, np.zeros((70, 70)), sigma=0.1)
    search = PlaceSearch(MapFeatures(prior))
    search.add(points_of(np.zeros((70, 70)), (20, 50), (20, 50)))
    # A search covers 1,000 places to either side, here about half of the prior.
    covariance = np.diag([3.0**2, 1600.0**2])
    search.search(0.0, np.zeros(2), covariance)
    match = search.search(2.0, np.zeros(2), covariance)
    found, origin = search.log_likelihood
    unit = search.spacing
    # All places, with those outside the search without evidence.
    rows = np.arange(-int(9600.0 / unit), int(9600.0 / unit) + 1)
    cols = np.arange(-int(30.0 / unit), int(30.0 / unit) + 1)
    log = np.zeros((len(rows), len(cols)))
    at = np.subtract(origin, (rows[0], cols[0]))
    log[at[0] : at[0] + found.shape[0], at[1] : at[1] + found.shape[1]] += found
    log -= 0.5 * ((unit * rows[:, None] / 1600.0) ** 2 + (unit * cols / 3.0) ** 2)
    p = np.exp(log - log.max())
    p /= p.sum()
    r, c = np.unravel_index(np.argmax(p), p.shape)
    near = np.hypot(rows[:, None] - rows[r], cols - cols[c]) * unit <= 1.5 * POSTING + 1e-9
    assert len(found) * unit < 0.7 * 2.0 * 1600.0
    assert match.certainty == pytest.approx(p[near].sum(), rel=1e-4)


@pytest.mark.parametrize("sigma", [0.3, 0.02, 0.01, 0.003, 1e-4])
def test_a_place_known_better_than_places_lie_apart_is_certain(sigma):
    prior, points = swept(sigma=0.1)
    search = PlaceSearch(MapFeatures(prior))
    search.add(points - SHIFT)
    # In the middle between four places.
    mean = 0.25 * np.round(SHIFT[:2] / 0.25) + 0.125
    for n in range(3):
        match = search.search(float(n), mean, np.eye(2) * sigma**2)
    assert match.certainty > 0.99999
    assert np.abs(match.shift[:2] - SHIFT[:2]).max() < 0.25


@pytest.mark.parametrize(("first", "spacing"), [(1600.0, 1.0), (1.0, 0.5)])
def test_places_lie_as_far_apart_as_when_the_search_began(first, spacing):
    search = PlaceSearch(MapFeatures(swept(sigma=0.1)[0]))
    for time, sigma in enumerate((first, 1.0, 1600.0)):
        search.search(float(time), np.zeros(2), np.eye(2) * sigma**2)
        assert search.spacing == spacing * search.prior.grid.posting
    search.restart()
    search.search(0.0, np.zeros(2), np.eye(2))
    assert search.spacing == 0.5 * search.prior.grid.posting


def test_correlated_prior_weights_places():
    rng = np.random.default_rng(2)
    ground = bumps(rng, (40, 40), height=0.2)
    search = PlaceSearch(MapFeatures(small_map(rng, ground, sigma=0.12)))
    search.add(points_of(ground, (10, 30), (10, 30)))
    mean, covariance = np.array([0.7, -1.3]), np.array([[4.0, 3.0], [3.0, 9.0]])
    search.search(0.0, mean, covariance)
    match = search.search(2.0, mean, covariance)
    found, origin = search.log_likelihood
    rows, cols = (part.ravel() for part in np.indices(found.shape))
    shifts = search.spacing * np.column_stack((cols + origin[1], rows + origin[0]))
    p = plain.posterior(found.ravel(), shifts, mean, covariance)
    near = np.hypot(*(shifts - shifts[np.argmax(p)]).T) <= 1.5 * POSTING + 1e-9
    assert match.certainty == pytest.approx(p[near].sum(), abs=2e-3)
    assert match.shift[:2] == pytest.approx(p[near] @ shifts[near] / p[near].sum(), abs=1e-6)


@pytest.mark.parametrize(
    ("given", "match"),
    [({"mean": [np.nan, 0.0]}, "mean"), ({"covariance": np.zeros((2, 2))}, "covariance"),
     ({"covariance": -np.eye(2)}, "covariance"), ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "cov"),
     ({"covariance": np.full((2, 2), np.nan)}, "covariance"), ({"speed_sigma": -1.0}, "speed"),
     ({"speed_sigma": np.nan}, "speed"), ({"time": 1.0}, "time"), ({"time": np.nan}, "time")],
)  # fmt: skip
def test_invalid_prior_is_rejected(given, match):
    search, _ = found_on(*swept(sigma=0.1))
    before = search.log_likelihood[0].copy()
    known = {"time": 3.0, "mean": np.zeros(2), "covariance": np.eye(2), "speed_sigma": 0.1} | given
    with pytest.raises(InputError, match=match):
        search.search(**{k: np.asarray(v) if np.ndim(v) else v for k, v in known.items()})
    assert np.array_equal(search.log_likelihood[0], before)


def test_flat_terrain_is_not_found_but_its_height_is():
    rng = np.random.default_rng(4)
    prior = small_map(rng, np.zeros((90, 90)), sigma=0.1)
    search = PlaceSearch(MapFeatures(prior))
    search.add(points_of(np.zeros((90, 90)), (25, 60), (25, 60), (3.0, -4.0, 12.0)))
    for n in range(3):
        match = search.search(float(n), np.zeros(2), np.eye(2) * 8.0**2)
    assert match.certainty < 0.5
    assert match.vertical_shift == pytest.approx(12.0, abs=0.1)
    assert match.vertical_shift_variance < 0.05
    # On a slope the height is no more certain than the position.
    ramp = 0.1 * np.arange(90.0) + np.zeros((90, 90))
    search = PlaceSearch(MapFeatures(small_map(rng, ramp, sigma=0.1)))
    search.add(points_of(ramp, (25, 60), (25, 60)))
    for n in range(3):
        match = search.search(float(n), np.zeros(2), np.eye(2) * 8.0**2)
    assert 0.2 < match.vertical_shift_variance < 1.0


def test_scans_off_the_map_and_empty_ones_report_nothing():
    prior, points = swept(sigma=0.1)
    search = PlaceSearch(MapFeatures(prior))
    search.add(np.full((10, 3), np.nan))
    search.add(np.zeros((0, 3)))
    search.add(np.array([[0.0, 0.0, 0.0], [1e6, 0.0, 0.0]]))
    assert search.search(0.0, np.zeros(2), np.eye(2) * 9.0) is None
    search.add(points + [5000.0, 0.0, 0.0])
    search.search(1.0, np.zeros(2), np.eye(2) * 9.0)
    match = search.search(3.0, np.zeros(2), np.eye(2) * 9.0)
    assert not search.log_likelihood[0].any()
    assert match.certainty < 0.9
    assert np.isinf(match.vertical_shift_variance)


def test_gathered_scans_are_one_scan():
    rng = np.random.default_rng(5)
    points = rng.uniform(-6.0, 6.0, (20_000, 3)) * [1.0, 1.0, 0.1]
    submap = Submap(-0.5, -0.5, 1.0)
    for part in np.array_split(points, 7):
        assert submap.add(part)
    back = submap.points()
    assert len(back) == submap.count
    for x, y, z in back[::9]:
        mine = (np.abs(points[:, 0] - x) <= 0.5) & (np.abs(points[:, 1] - y) <= 0.5)
        assert z == pytest.approx(points[mine, 2].mean(), abs=1e-9)


# --- what a map promises ----------------------------------------------------------------------


def flat(slope=0.0, sigma=0.1, size=300.0, posting=1.0, seed=0, relief=None):
    grid = Grid.centred((0.0, 0.0), size, posting)
    z = slope * grid.centres()[..., 0] + (0.0 if relief is None else relief(grid.centres()))
    noise = sigma * np.random.default_rng(seed).standard_normal(grid.shape)
    return PriorMap(grid, z + noise, sigma)


@pytest.mark.parametrize("seed", range(4))
def test_noise_and_slopes_cannot_lock(seed):
    for slope in (0.0, 0.3):
        forecast = forecast_lock(flat(slope, seed=seed), (0.0, 0.0), 90.0, 30.0)
        assert not forecast.can_lock
        assert str(forecast).startswith("cannot lock")


def test_ridges_cannot_lock():
    ridge = flat(relief=lambda c: np.sin(c[..., 0] / 3.0))
    forecast = forecast_lock(ridge, (0.0, 0.0), 60.0, 20.0)
    assert not forecast.can_lock
    # The most probable wrong place lies along the ridges.
    assert abs(forecast.rival[0]) < 2.5


def test_rich_terrain_can_lock_and_more_noise_takes_it_away():
    told = []
    for sigma in (0.03, 0.06, 1.0):
        prior, _ = swept(sigma=sigma)
        told.append(forecast_lock(prior, (0.0, 0.0), 40.0, 10.0))
    assert [f.can_lock for f in told] == [True, True, False]
    assert told[0].expected > told[1].expected > told[2].expected
    # More possible places need more evidence; correlated errors give less.
    prior, _ = swept(sigma=0.06)
    assert forecast_lock(prior, (0.0, 0.0), 40.0, 20.0).needed > told[1].needed
    alike = PriorMap(prior.grid, prior.elevation, 0.06, 2.0)
    assert forecast_lock(alike, (0.0, 0.0), 40.0, 10.0).expected < 0.5 * told[1].expected


@pytest.mark.parametrize(
    ("arguments", "match"),
    [((np.nan, 10.0, 0.9), "side_m"), ((10.0, 0.0, 0.9), "place_sigma_m"),
     ((10.0, 10.0, 1.0), "certainty")],
)  # fmt: skip
def test_impossible_forecasts_are_refused(arguments, match):
    with pytest.raises(InputError, match=match):
        forecast_lock(flat(), (0.0, 0.0), *arguments[:2], certainty=arguments[2])


# --- maps ---------------------------------------------------------------------------------------


def test_errors_that_are_alike_count_together():
    prior = PriorMap(Grid(0.0, 0.0, 0.5, 4, 4), np.zeros((4, 4)), 0.1, 1.2)
    n = 0.5 * np.arange(-60, 61)
    distance = np.hypot(*np.meshgrid(n, n))
    assert prior.equivalent_correlated_posts == pytest.approx(
        np.exp(-0.5 * (distance / 1.2) ** 2).sum(), rel=1e-6
    )
    assert PriorMap(prior.grid, prior.elevation, 0.1).equivalent_correlated_posts == 1.0
    for wrong in (-1.0, np.nan):
        with pytest.raises(InputError, match="correlation_m"):
            PriorMap(prior.grid, prior.elevation, 0.1, wrong)


def test_a_survey_has_the_errors_and_the_voids_as_configured():
    terrain = hazard_field(np.random.default_rng(0), boulders=0, craters=0)
    grid = Grid.centred((0.0, 0.0), 200.0, 1.0)
    exact = simulate_survey(terrain, grid, np.random.default_rng(1), sigma=1e-9).elevation
    made = simulate_survey(
        terrain, grid, np.random.default_rng(1), sigma=0.2, correlation=3.0, void_fraction=0.1
    )
    error = made.elevation - exact
    known = np.isfinite(error)
    assert known.mean() == pytest.approx(0.9, abs=0.01)
    assert np.std(error[known]) == pytest.approx(0.2, rel=0.1)
    for lag, expected in ((3, np.exp(-0.5)), (9, np.exp(-4.5))):
        pair = known[:, lag:] & known[:, :-lag]
        alike = np.mean(error[:, lag:][pair] * error[:, :-lag][pair]) / 0.04
        assert alike == pytest.approx(expected, abs=0.12)
    with pytest.raises(InputError, match=r"prior_map\.void_fraction"):
        simulate_survey(terrain, grid, np.random.default_rng(0), void_fraction=1.0)
