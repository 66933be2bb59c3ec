"""Test that LiDAR mappers never call worse terrain safer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    LOG_ODDS_MARGIN,
    MAX_CLAIM_DEFICIT,
)
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.calibration.evidence import UNCONSTRAINED_FEATURES
from lunarsim.onboard.calibration.quadtree import QUADTREE, SiteEvidence
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper
from lunarsim.onboard.hazards.quadtree.site_evidence import quadtree_site_evidence
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.rocks.field import RockField
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import exact_safety
from lunarsim.safety.unseen_rocks import (
    ExceedanceCurve,
    depth_curve,
    distribution_fraction,
    height_curve,
)
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.vehicle import State
from lunarsim.world import World
from lunarsim.world.terrain import Heightfield, Terrain, place_rocks

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
MAP = Grid.centred((0.0, 0.0), 16.0, 0.2)
TILTS = (0.0, 5.0, 8.0, 10.0, 12.0, 16.0, 20.0)
MAPPERS = {
    "calibrated": lambda: GaussianDemMapper(MAP, Lander()),
    "level": lambda: GaussianDemMapper(MAP, Lander(), safety="level"),
    "planes": lambda: GaussianDemMapper(MAP, Lander(), safety="planes"),
    "quadtree": lambda: QuadtreeMapper(MAP),
}


def tilted(degrees: float, rocks: int = 0, size: float = 0.8) -> Terrain:
    grid = Grid.centred((0.0, 0.0), 60.0, 1.0)
    z = np.tan(np.deg2rad(degrees)) * grid.centres()[..., 0]
    relief = Heightfield(grid, z.astype(np.float32))
    if not rocks:
        return Terrain(relief, RockField.empty())
    return Terrain(relief, place_rocks(relief, np.full(rocks, size), np.random.default_rng(2)))


def flashes(terrain: Terrain) -> list[tuple[LidarScan, Estimate]]:
    """Return three scans from above with their poses."""
    lidar = FlashLidar(rows=128, cols=128)
    out = []
    for n, height in enumerate((110.0, 100.0, 92.0)):
        position = np.array([0.3 * n, 0.2 * n, height])
        state = State(position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
        scan = lidar.measure(World(terrain, 1.622), state, 0.0, np.random.default_rng(n))
        estimate = Estimate(0.0, position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, np.eye(9) * 1e-8)
        out.append((scan, estimate))
    return out


def mapped(name: str, terrain: Terrain):
    mapper = MAPPERS[name]()
    for scan, estimate in flashes(terrain):
        mapper.update(scan, estimate)
    return mapper.hazard_map()


@pytest.mark.parametrize("name", list(MAPPERS))
def test_no_map_calls_steeper_terrain_safer(name):
    middle = (np.abs(MAP.centres()) < 3.0).all(axis=-1)
    p = []
    for tilt in TILTS:
        drawn = mapped(name, tilted(tilt))
        assert drawn.observed[middle].all()
        p.append(float(drawn.p_safe[middle].mean()))
    assert (np.diff(p) <= 0.01).all(), p
    assert p[0] > 0.9, p
    # The limit is 10 deg; a calibrated map must not stay uncertain for long.
    assert p[-1] < 0.01, p
    assert p[-2] < 0.05, p


@pytest.mark.parametrize("name", list(MAPPERS))
def test_no_map_calls_rockier_terrain_safer(name):
    bare, few, many = (mapped(name, tilted(0.0, n)).p_safe.mean() for n in (0, 25, 150))
    assert bare > few > many


def test_what_is_claimed_holds_where_small_rocks_under_a_pad_tilt_the_lander_over_its_limit():
    share = []
    for tilt in (8.5, 9.0):
        terrain = tilted(tilt, 900, 0.2)
        truth = exact_safety(terrain.raster(MAP), MAP, Lander())
        drawn = mapped("calibrated", terrain)
        judged = drawn.observed & truth.observed
        sure = judged & drawn.in_domain & (drawn.p_safe > 0.95)
        share.append(sure.sum() / judged.sum())
        if sure.any():
            assert drawn.p_safe[sure].mean() - truth.safe[sure].mean() < 0.005
    # Terrain of which a tenth is unsafe, due to rocks without samples, is not claimed safe.
    assert share[0] > 0.3
    assert share[1] < 0.1


@pytest.mark.parametrize("name", ["calibrated", "quadtree"])
@pytest.mark.parametrize("expected", [0.05, 1e-6])
def test_gravel_is_not_taken_for_bare_terrain(name, expected):
    """Sites claimed safe are safe, even where gravel adds tilt, expected or not."""
    rocks = RockExpectation(cover=expected)
    made = {"calibrated": GaussianDemMapper, "quadtree": QuadtreeMapper}[name]
    for tilt in (4.0, 8.4, 9.0):
        terrain = tilted(tilt, 10_000, 0.18)
        truth = exact_safety(terrain.raster(MAP), MAP, Lander())
        mapper = made(MAP, lander=Lander(), rocks=rocks)
        for scan, estimate in flashes(terrain):
            mapper.update(scan, estimate)
        drawn = mapper.hazard_map()
        judged = drawn.observed & truth.observed
        sure = judged & drawn.in_domain & (drawn.p_safe > 0.95)
        assert sure.mean() > 0.3 or tilt > 4.0
        assert tilt < 9.0 or truth.safe[judged].mean() < 0.9
        if sure.any():
            assert drawn.p_safe[sure].mean() - truth.safe[sure].mean() < 0.005


BAD_SCANS = [
    ("range", lambda s: s.range[:-1], "scan.range"),
    ("range", lambda s: s.range.reshape(s.shape), "scan.range"),
    ("range", lambda s: s.range + 0j, "scan.range"),
    ("range", lambda s: np.ma.masked_array(s.range, s.range > 0.0), "scan.range"),
    ("range", lambda s: np.where(np.arange(s.range.size) == 9, np.inf, s.range), "scan.range[9]"),
    ("range", lambda s: np.where(np.arange(s.range.size) == 9, -3.0, s.range), "scan.range[9]"),
    ("sigma", lambda s: s.sigma[:-1], "scan.sigma"),
    ("sigma", lambda s: 0.01, "scan.sigma"),
    ("sigma", lambda s: np.full(s.sigma.size, np.nan), "scan.sigma[0]"),
    ("sigma", lambda s: 0.0 * s.sigma, "scan.sigma[0]"),
    ("shape", lambda s: (127, 128), "scan.range"),
    ("mount", lambda s: 2.0 * s.mount, "scan.mount"),
    ("mount", lambda s: s.mount @ np.diag([1.0, 1.0, -1.0]), "scan.mount"),
    ("mount", lambda s: np.full((3, 3), np.nan), "scan.mount"),
]
BAD_POSES = [
    ("position[0]", np.array([np.nan, 0.0, 100.0])), ("attitude", np.zeros(4)),
    ("attitude", np.full(4, np.nan)), ("attitude", np.array([0.0, 0.0, 0.0, 1.5])),
]  # fmt: skip


@pytest.mark.parametrize("name", ["calibrated", "quadtree"])
def test_scans_and_poses_that_none_gives_are_refused_and_change_nothing(name):
    taken = flashes(tilted(0.0))
    scan, estimate = taken[0]
    mapper = MAPPERS[name]()
    for field, change, named in BAD_SCANS:
        with pytest.raises(InputError) as caught:
            mapper.update(replace(scan, **{field: change(scan)}), estimate)
        assert caught.value.field == named
    for field, value in BAD_POSES:
        with pytest.raises(InputError) as caught:
            mapper.update(scan, replace(estimate, **{field.partition("[")[0]: value}))
        assert caught.value.field == f"estimate.{field}"
    for each in taken:
        mapper.update(*each)
    found, wanted = mapper.hazard_map(), mapped(name, tilted(0.0))
    assert found.observed.any()
    assert np.array_equal(found.p_safe, wanted.p_safe)


def test_the_calibrated_map_says_where_it_holds():
    drawn = mapped("calibrated", tilted(0.0))
    middle = (np.abs(MAP.centres()) < 3.0).all(axis=-1)
    assert drawn.in_domain[middle].all()
    assert not drawn.in_domain[~drawn.observed].any()
    seen = mapped("quadtree", tilted(0.0))
    assert seen.in_domain[middle].all()
    assert not seen.in_domain[~seen.observed].any()


def test_a_map_of_few_points_among_large_rocks_claims_no_domain():
    for name, mapper in (
        ("calibrated", MAPPERS["calibrated"]()),
        ("quadtree", MAPPERS["quadtree"]()),
    ):
        rough = tilted(0.0, 150)
        for scan, estimate in flashes(rough):
            # One return in a hundred.
            thin = np.full_like(scan.range, np.nan)
            thin[::100] = scan.range[::100]
            mapper.update(replace(scan, range=thin), estimate)
        assert not mapper.hazard_map().in_domain.any(), name


weights = st.integers(0, 10_000).map(
    lambda seed: Ensemble(
        tuple(
            (
                *np.random.default_rng([seed, fit]).normal(0.0, 1.0, UNCONSTRAINED_FEATURES),
                *np.random.default_rng([seed, fit, 1]).exponential(
                    0.5, QUADTREE.count - UNCONSTRAINED_FEATURES
                ),
            )
            for fit in range(3)
        )
    )
)


SITE = {
    "slope": 0.4, "roughness": 0.3, "mesh_slope": 0.4, "fitted_slope": 0.4, "mesh_spread": 0.1,
    "fitted_spread": 0.1, "ratio": 0.0, "footprint_ratio": 0.0, "relief": 0.2,
    "footprint_relief": 0.2,
}  # fmt: skip


def site(rocks: float, noise: float = 0.02, **changes: float) -> SiteEvidence:
    """Return a smooth site without exceptions, except for changes, among expected rocks."""
    return site_among(curve_of(rocks), curve_of(0.01), noise, **changes)


def curve_of(rocks: float) -> ExceedanceCurve:
    """Return the height curve of a multiple of the usual rocks."""
    height = Lander().roughness_limit * np.geomspace(0.08, 8.0, 40)
    return ExceedanceCurve(
        height, np.minimum(rocks * distribution_fraction(height, 0.05, 0.5), 0.5)
    )


def site_among(
    curve: ExceedanceCurve, holes: ExceedanceCurve, noise: float, **changes: float
) -> SiteEvidence:
    own = {k: np.array([v]) for k, v in (SITE | changes).items()}
    own = {"density": np.array([30.0]), "min_density": np.array([30.0])} | own
    own["may_be_unsafe"] = np.maximum(own["slope"], own["roughness"]) >= 1.0
    return SiteEvidence(**own, curve=curve, holes=holes, lander=Lander(), noise=noise)


@given(
    weights, st.floats(0.0, 1.5), st.floats(0.0, 1.5), st.floats(0.0, 0.3), st.floats(0.01, 10.0),
    st.floats(0.0, 0.6),
)  # fmt: skip
def test_worse_sites_are_never_called_safer(model, slope, rough, ratio, rocks, worse):
    here = {
        "slope": slope, "fitted_slope": slope, "mesh_slope": 0.8 * slope, "roughness": rough,
        "mesh_spread": 0.4 * rough, "fitted_spread": 0.3 * rough, "footprint_relief": 0.8 * rough,
        "relief": rough, "ratio": ratio, "footprint_ratio": 0.5 * ratio,
    }  # fmt: skip
    p = calibrated_safety(site(rocks, **here), model)[0][0]
    for name, value in here.items():
        assert calibrated_safety(site(rocks, **here | {name: value + worse}), model)[0][0] <= p, (
            name
        )
    assert calibrated_safety(site(rocks * (1.0 + worse), **here), model)[0][0] <= p + 1e-12


@given(
    weights, st.integers(0, 10_000), st.floats(1.0, 3.0), st.floats(0.0, 0.95),
    st.floats(2.0, 200.0),
)  # fmt: skip
def test_sites_among_taller_rocks_are_never_called_safer(model, seed, times, slope, density):
    """Some of the points on a rock or in a hole are on a larger one."""
    rng = np.random.default_rng(seed)
    residual_heights = np.zeros(int(rng.choice([300, 3000, 20_000])))
    count = int(rng.integers(1, 100))
    residual_heights[:count] = 0.25 * rng.uniform(0.3, 2.5, count) * rng.choice([-1.0, 1.0], count)
    worse = residual_heights.copy()
    worse[: int(rng.integers(1, count + 1))] *= times
    own = {"slope": slope, "mesh_slope": slope, "fitted_slope": slope, "min_density": density}
    p = [
        calibrated_safety(site_among(height_curve(*said), depth_curve(*said), 0.02, **own), model)[
            0
        ][0]
        for said in ((r, 0.02, 0.25, 0.05) for r in (residual_heights, worse))
    ]
    assert p[1] <= p[0] + 1e-12


def fits_of(*odds: float) -> Ensemble:
    """Return fits that give the same probability for all sites."""
    return Ensemble(tuple((o, *[0.0] * (QUADTREE.count - 1)) for o in odds))


def test_where_fits_differ_on_a_site_the_lowest_counts_and_is_no_frequency():
    for odds, claims in (((2.0, 5.0), False), ((4.0, 5.0), True)):
        p, known = calibrated_safety(site(0.02), fits_of(*odds))
        left = (1.0 - MAX_CLAIM_DEFICIT) * (1.0 if claims else ALMOST_CERTAINLY_SAFE_P)
        assert p[0] == pytest.approx(left * expit(odds[0] - LOG_ODDS_MARGIN))
        assert known[0] == claims
    doubtful = site(0.16, fitted_slope=0.7)
    assert doubtful.in_domain.all()
    p, known = calibrated_safety(doubtful, fits_of(2.8, 2.8))
    assert p == pytest.approx(
        (1.0 - MAX_CLAIM_DEFICIT) * ALMOST_CERTAINLY_SAFE_P * expit(2.8 - LOG_ODDS_MARGIN)
    )
    assert not known.any()
    # Near the domain, the fits still count, but p is no calibrated frequency.
    near = site(3.0)
    assert near.near_domain.all() and not near.in_domain.any()
    p, known = calibrated_safety(near, fits_of(-1.0, -1.0))
    assert 0.5 * expit(-1.0 - LOG_ODDS_MARGIN) < p[0] < expit(-1.0)
    assert not known.any()
    # Far from the domain, p is at most the probability of no undetected rock.
    far = site(30.0)
    assert not far.near_domain.any()
    nothing = np.exp(-far.expected_roughness_violations - far.expected_tilt_violations)
    assert nothing < 0.5
    p, known = calibrated_safety(far, fits_of(2.8, 2.8))
    assert p == pytest.approx(ALMOST_CERTAINLY_SAFE_P * nothing)
    assert not known.any()


def test_a_site_is_surely_unsafe_only_where_it_is_so_without_its_holes():
    for odds, doomed, claims in ((-6.0, True, True), (-6.0, False, False), (-3.0, True, False)):
        bad = replace(site(0.02, slope=1.2), may_be_unsafe=np.array([doomed]))
        p, known = calibrated_safety(bad, fits_of(odds, odds))
        assert p[0] <= 0.95 * expit(odds)
        assert known[0] == claims


@pytest.mark.parametrize("name", [*SITE, "density", "min_density"])
def test_a_site_of_which_anything_is_unknown_is_not_evaluated(name):
    for value in (np.nan, np.inf):
        own = site(0.02, **{name: value})
        assert not own.observed.any()
        p, known = calibrated_safety(own)
        assert p[0] == 0.0
        assert not known[0]


def test_a_site_at_which_anything_fatal_was_seen_is_not_called_safe():
    assert calibrated_safety(site(0.02))[0][0] > 0.95
    fatal = {
        "slope": 1.3,
        "mesh_slope": 1.15,
        "fitted_slope": 1.15,
        "roughness": 1.6,
        "footprint_relief": 4.0,
    }
    for name, value in fatal.items():
        assert calibrated_safety(site(0.02, **{name: value}))[0][0] < 0.5, name


@pytest.mark.parametrize("name", ["slope", "mesh_slope", "fitted_slope"])
def test_a_site_just_under_the_limit_of_the_slope_is_not_surely_safe(name):
    for share, sure in ((0.88, True), (0.97, False)):
        p, known = calibrated_safety(site(0.001, **{name: share}), fits_of(6.0))
        assert (p[0] > 0.95) == sure
        assert known[0] == sure


@pytest.mark.parametrize(("slope", "matters"), [(0.4, False), (0.85, True)])
def test_gravel_matters_to_a_site_where_it_tilts_the_lander_too_far(slope, matters):
    height = Lander().roughness_limit * np.geomspace(0.08, 8.0, 40)
    on = {"slope": slope, "mesh_slope": slope, "fitted_slope": slope}
    for gravel in (1e-9, 0.1):
        low = np.where(height < 0.09, gravel, 1e-9)
        curve = ExceedanceCurve(height, np.full(40, 1e-9), 0.1, low, 0.05)
        p, known = calibrated_safety(site_among(curve, curve_of(0.01), 0.02, **on), fits_of(6.0))
        assert known[0] == (p[0] > 0.95) == (gravel < 0.01 or not matters)


def test_the_domain_ends_where_rocks_may_stand_unseen_or_noise_is_not_that_of_the_fit():
    assert site(0.02).in_domain.all()
    limit = Lander().roughness_limit
    assert site(0.02, noise=0.1 * limit).in_domain.all()
    assert not site(0.02, noise=0.15 * limit).in_domain.any()
    assert site(0.25).in_domain.all()
    assert not site(0.25, min_density=1.0).in_domain.any()
    assert not site(20.0).in_domain.any()
    # Few hazards, but at the slope limit any stone tilts the lander too far.
    steep = site(0.2, fitted_slope=0.99)
    assert steep.expected_hazards[0] < QUADTREE.limits.hazards
    assert not steep.in_domain.any()
    # Undetected holes under the pads, or much terrain that is known to be deep.
    gaping = site_among(curve_of(0.02), curve_of(2.0), 0.02, min_density=1.0)
    assert gaping.expected_hole_violations[0] > QUADTREE.limits.holes
    assert not gaping.in_domain.any()
    sunk = site_among(curve_of(0.02), curve_of(3.0), 0.02, min_density=1000.0)
    assert sunk.expected_hole_violations[0] < QUADTREE.limits.holes
    assert not sunk.in_domain.any()
    for degrees, inside in ((3.0, False), (5.0, True), (20.0, True), (25.0, False)):
        other = replace(site(0.02), lander=replace(Lander(), slope_limit=np.deg2rad(degrees)))
        assert other.in_domain.all() == inside
    # Outside the domain, p is at most the probability of no undetected rock.
    unknown = site(20.0)
    nothing = np.exp(-unknown.expected_roughness_violations - unknown.expected_tilt_violations)
    assert (calibrated_safety(unknown)[0] <= nothing).all()


def test_what_noise_adds_to_the_highest_point_is_taken_off():
    quiet, noisy = (
        site(0.02, noise=1e-4, footprint_relief=0.4),
        site(0.02, noise=0.02, footprint_relief=0.4),
    )
    limit = Lander().roughness_limit
    assert quiet.denoised_relief()[0] == pytest.approx(0.4 - 3e-4 / limit)
    assert noisy.denoised_relief()[0] == pytest.approx(0.4 - 0.06 / limit)
    assert quiet.denoised_relief()[1] == pytest.approx(0.1, abs=1e-5)
    assert noisy.denoised_relief()[1] == pytest.approx(np.sqrt(0.1**2 - (0.02 / limit) ** 2))


def test_the_noise_of_a_quadtree_is_that_of_its_noisiest_scan():
    mapper = QuadtreeMapper(MAP)
    scans = flashes(tilted(0.0))
    sigma = [float(np.nanmedian(scan.height_sigma(UPRIGHT))) for scan, _ in scans]
    assert sigma[0] != sigma[-1]
    for scan, estimate in scans:
        mapper.update(scan, estimate)
    evidence = quadtree_site_evidence(
        mapper.map, mapper.select(), mapper.selector.settings.zone_half_side, 0.01, Lander(),
        RockExpectation(),
    )  # fmt: skip
    assert mapper.noise == max(sigma)
    # The density is averaged over the complete zone; its maximum is that of the scans.
    points = mapper.map.points
    count = (np.abs(points[:, :2]) < 4.0).all(axis=1).sum() / 64.0
    inside = (np.abs(mapper.selection.position[:, :2]) < 2.0).all(axis=1)
    assert np.nanmedian(evidence.density[inside]) == pytest.approx(count, rel=0.1)
    assert np.nanmedian(evidence.min_density[inside]) == pytest.approx(count, rel=0.35)


def test_noise_that_the_points_do_not_have_excuses_nothing():
    mapper = QuadtreeMapper(MAP)
    for scan, estimate in flashes(tilted(0.0, 60)):
        mapper.update(scan, estimate)
    stated = mapper.noise
    told = (mapper.map, mapper.select(), mapper.selector.settings.zone_half_side)
    true, more = (
        quadtree_site_evidence(*told, noise, Lander(), RockExpectation())
        for noise in (stated, 8.0 * stated)
    )
    assert true.noise <= stated
    assert more.noise < 1.5 * stated
    p, q = (calibrated_safety(e)[0][true.observed] for e in (true, more))
    assert len(p) > 50
    assert (q - p).max() < 0.05
    less = quadtree_site_evidence(*told, 0.1 * stated, Lander(), RockExpectation())
    assert less.noise == 0.1 * stated


def test_the_packaged_weights_of_the_quadtree_do_not_fall():
    model = QUADTREE.packaged
    assert min(w for fit in model.weights for w in fit[UNCONSTRAINED_FEATURES:]) >= 0.0
    assert len(model.without) == len(model.weights) - 1 > 20
    assert "scenarios/lidar_maps/quadtree_calibration.py" in model.note
