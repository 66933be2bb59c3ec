"""A refit judged by flights left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit

from lunarsim.errors import InputError
from lunarsim.evaluation.reliability import brier_score, brier_skill, calibration_error, reliability
from lunarsim.evaluation.site_calibration import SiteSamples, cross_validate, sample_sites
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.conservative_probability import (
    ALMOST_CERTAINLY_SAFE_P,
    ALMOST_CERTAINLY_UNSAFE_P,
    LOG_ODDS_MARGIN,
    conservative_probability,
    lower_bound_probability,
)
from lunarsim.onboard.calibration.gaussian_dem import GAUSSIAN_DEM
from tests.given_truth import GivenTruth
from tests.map_evidence import evidence

LANDER = Lander()


def test_sites_are_evaluated_where_they_truly_are():
    grid = Grid(-2.0, -2.0, 0.5, 17, 17)
    xy = grid.centres()
    safe, known = xy[..., 0] < 1.9, xy[..., 1] < 2.9
    truth = GivenTruth(grid, safe, known)
    seen = np.ones((9, 9), bool)
    seen[0] = False
    e = evidence(seen=seen, slope=np.linspace(0.1, 0.9, 81).reshape(9, 9))
    # A cell of the map at (x, y) truly lies at (x - 1, y + 1).
    found = sample_sites(e, truth, (1.0, -1.0, 9.0), 1000, 5, np.random.default_rng(1))
    x, y = np.moveaxis(e.horizontal_plane.grid.centres(), -1, 0)
    taken = seen & (y + 1.0 < 2.9)
    assert taken.sum() == len(found) > 20
    assert np.array_equal(found.safe, (x - 1.0 < 1.9)[taken])
    assert 0 < found.safe.sum() < len(found)
    assert np.array_equal(found.tilting, e.expected_tilt_violations[taken])
    assert (found.flight == 5).all()
    some = [sample_sites(e, truth, np.zeros(3), 20, 0, np.random.default_rng(i)) for i in (1, 1, 2)]
    assert [len(s) for s in some] == [20, 20, 20]
    assert np.array_equal(some[0].tilting, some[1].tilting)
    assert not np.array_equal(some[0].tilting, some[2].tilting)


def test_sites_that_gravel_may_tilt_count_as_not_claimed_as_on_the_map():
    """What is claimed of sites is what `calibrated_safety` claims of them."""
    e = evidence(rough=0.05, level=6.0, planes=6.0, slope=np.linspace(0.1, 0.97, 81).reshape(9, 9))
    e = replace(e, curve=replace(e.curve, gravel=np.full(len(e.curve.height), 0.2)))
    _, claimed = calibrated_safety(e)
    found = SiteSamples.of(e, e.observed, e.observed, 0)
    assert 0 < claimed.sum() < claimed.size
    assert np.array_equal((found.known & found.agreed), claimed[e.observed])
    assert (
        e.observed_terrain_bound()[~claimed] > ALMOST_CERTAINLY_SAFE_P
    ).any()  # it was the rocks that told


def sites(flight: int, n: int = 1500, shift: float = 0.0, known: float = 0.5, seed: int = 1,
          right: bool = False):  # fmt: skip
    rng = np.random.default_rng([seed, flight])
    z = rng.normal(0.0, 3.0, n)
    inside = rng.random(n) < known
    agreed = (lower_bound_probability(z, np.ones(n)) >= ALMOST_CERTAINLY_SAFE_P) | (
        expit(z) <= ALMOST_CERTAINLY_UNSAFE_P
    )
    said = conservative_probability(
        z, np.ones(n), np.full(n, 0.1), inside, GAUSSIAN_DEM.outside_margin
    )
    truth = said if right else expit(z - LOG_ODDS_MARGIN + shift)
    return SiteSamples(
        flight=np.full(n, flight), log_odds=z, ceiling=np.ones(n), clear=np.ones(n),
        agreed=agreed,
        bound=np.full(n, 0.1), known=inside, hazards=np.where(inside, 0.01, 0.2),
        tilting=np.full(n, 0.1), noise=np.full(n, 0.05), spacing=np.full(n, 0.2),
        safe=rng.random(n) < truth,
    )  # fmt: skip


def judged(*flights: SiteSamples, count: int | None = None):
    rng = np.random.default_rng(7)
    return cross_validate(SiteSamples.joined(list(flights)), count or len(flights), LANDER, rng)


def test_figures_are_those_of_plain_counting():
    parts = [sites(i) for i in range(3)]
    every = SiteSamples.joined(parts)
    found = judged(*parts)
    k = every.known & every.agreed
    assert k.sum() < every.known.sum()
    p, safe = every.probability()[k], every.safe[k]
    f = found.packaged_domain.packaged
    assert (f.sites, f.confident_sites) == (k.sum(), (p > 0.95).sum())
    assert f.share[0] == pytest.approx(k.mean())
    assert f.safe[0] == pytest.approx(safe.mean())
    assert f.ece[0] == pytest.approx(calibration_error(reliability(p, safe)))
    assert f.skill[0] == pytest.approx(brier_skill(p, safe))
    sure = p > 0.95
    assert f.bias[0] == pytest.approx(p[sure].mean() - safe[sure].mean())
    for figure in (f.share, f.safe, f.ece, f.skill, f.bias):
        assert figure[1] <= figure[0] <= figure[2]
        assert figure[1] < figure[2]
    # The refit of each flight by hand.
    after = np.concatenate(
        [
            parts[i].probability(SiteSamples.joined(parts[:i] + parts[i + 1 :]).fitted(LANDER))
            for i in range(3)
        ]
    )
    group = found.packaged_domain
    assert group.refit.skill[0] == pytest.approx(brier_skill(after[k], safe))
    gain = brier_score(p, safe) - brier_score(after[k], safe)
    assert group.gain[0] == pytest.approx(gain)
    assert found.refit_domain.refit.sites == len(every)
    assert found.refit_domain.better


def test_what_drawing_flights_adds_to_the_error_is_taken_off_its_interval():
    # Hardly any sites and as sure as they should be: nearly all of the error is chance.
    parts = [sites(i, n=60, known=1.0, seed=6) for i in range(3)]
    found = judged(*parts).packaged_domain.packaged.ece

    def error(times) -> float:
        drawn = SiteSamples.joined([p for p, n in zip(parts, times, strict=True) for _ in range(n)])
        k = drawn.known & drawn.agreed
        return calibration_error(reliability(drawn.probability()[k], drawn.safe[k]))

    times = np.random.default_rng(7).multinomial(3, np.full(3, 1.0 / 3.0), 2000)
    known = {tuple(t): error(t) for t in np.unique(times, axis=0)}
    drawn = np.array([known[tuple(t)] for t in times])
    added = drawn.mean() - error((1, 1, 1))
    assert added > 0.002
    ends = np.maximum(np.quantile(drawn, [0.025, 0.975]) - added, 0.0)
    assert found == pytest.approx([error((1, 1, 1)), *ends], abs=1e-9)


def test_no_flight_is_evaluated_by_a_fit_to_itself():
    # Two flights that say the opposite: each refit is wrong about the other.
    found = judged(sites(0, shift=4.0), sites(1, shift=-4.0))
    assert found.packaged_domain.refit.ece[0] > 0.2
    assert found.packaged_domain.gain[0] < 0.0
    assert not found.packaged_domain.better


def test_a_packaged_probability_that_is_right_is_not_bettered():
    found = judged(*(sites(i, right=True) for i in range(6)))
    assert not found.packaged_domain.better
    shifted = judged(*(sites(i, shift=1.5) for i in range(6)))
    assert shifted.packaged_domain.better
    assert shifted.packaged_domain.refit.ece[0] < 0.5 * shifted.packaged_domain.packaged.ece[0]


def test_the_chance_of_rocks_under_the_pads_does_not_spoil_a_refit():
    doubted = [replace(sites(i), clear=np.full(1500, 0.05)) for i in range(6)]
    refit_quality = judged(*doubted).refit_domain
    assert refit_quality.packaged.ece[0] > 0.2
    assert refit_quality.refit.ece[0] < 0.03


def test_flights_alike_leave_no_interval():
    one = sites(0)
    same = SiteSamples(**{**vars(one), "flight": np.full(len(one), 1)})
    f = judged(one, same).packaged_domain.packaged
    assert f.skill[1] == pytest.approx(f.skill[2])
    # A flight that saw nothing counts as a flight.
    f = judged(one, sites(2), count=4).packaged_domain.packaged
    assert np.isfinite(f.skill).all()


def test_without_both_kinds_of_sites_there_is_no_fit():
    safe = sites(0, shift=60.0)
    with pytest.raises(InputError, match="20 safe and 20 unsafe"):
        safe.fitted(LANDER)
    # One flight holds all that is unsafe.
    with pytest.raises(InputError, match="also without any one flight"):
        judged(safe, sites(1, shift=60.0), sites(2))


def test_terrain_that_no_flight_was_fitted_to_is_left_out_of_the_domain():
    near = [sites(i, known=1.0) for i in range(2)]
    far = sites(2, n=400, shift=60.0, known=0.0)  # all safe: nothing to fit to
    refit = SiteSamples.joined([*near, far]).fitted(LANDER)
    assert not far.inside(refit.domain).any()
    assert near[0].inside(refit.domain).all()
    assert (far.probability(refit) <= 0.1).all()
    many = SiteSamples.joined([*near, sites(2, known=0.0)]).fitted(LANDER)
    assert far.inside(many.domain).all()
