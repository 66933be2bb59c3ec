"""Statistics of campaigns against other people's code, closed forms and frequencies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest, chi2
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.multitest import multipletests

from lunarsim.evaluation.comparisons import (
    bootstrap_interval,
    holm_correction,
    landing_ellipse,
    mean_difference,
    quantile_interval,
    share_difference,
    share_upper_bound,
)
from lunarsim.evaluation.sequences import share_confidence_sequence


def test_holm_is_that_of_statsmodels():
    rng = np.random.default_rng(1)
    for n in (1, 2, 7, 30):
        p = rng.random(n) ** 4
        assert holm_correction(p) == pytest.approx(multipletests(p, method="holm")[1], rel=1e-12)
    corrected = holm_correction([0.01, float("nan"), 0.02])
    assert corrected[[0, 2]] == pytest.approx([0.02, 0.02]) and np.isnan(corrected[1])


def test_the_paired_test_is_mcnemars():
    rng = np.random.default_rng(2)
    for _ in range(20):
        a, b = rng.random((2, 50)) < rng.random((2, 1))
        table = [
            [int((a & b).sum()), int((a & ~b).sum())],
            [int((~a & b).sum()), int((~a & ~b).sum())],
        ]
        found = share_difference(a, b, ("a", "b"))
        assert found.p == pytest.approx(mcnemar(table, exact=True).pvalue, abs=1e-12)
        assert found.value == pytest.approx(b.mean() - a.mean())
        assert found.low <= found.value <= found.high
        back = share_difference(b, a, ("b", "a"))
        assert (back.low, back.high) == pytest.approx((-found.high, -found.low))
    assert share_difference([True] * 9, [True] * 9, ("a", "b")).p == 1.0


def test_the_paired_interval_covers_and_is_shorter_than_an_unpaired_one():
    rng = np.random.default_rng(3)
    n, rounds, hits, widths = 60, 400, 0, []
    for _ in range(rounds):
        world = rng.random(n)
        a, b = world < 0.6, (world < 0.5) | (rng.random(n) < 0.4)
        found = share_difference(a, b, ("a", "b"))
        hits += found.low <= (0.5 + 0.5 * 0.4) - 0.6 <= found.high
        widths.append(found.high - found.low)
    # Four standard deviations of a share of 0.95 in 400.
    assert 0.95 - 0.044 < hits / rounds <= 1.0
    unpaired = 2 * 1.96 * np.sqrt(0.6 * 0.4 / n + 0.7 * 0.3 / n)
    assert np.mean(widths) < 0.9 * unpaired


def test_bootstrap_intervals_cover_a_skewed_mean():
    rng = np.random.default_rng(4)
    hits = 0
    for _ in range(150):
        low, high = bootstrap_interval(rng.exponential(1.0, 40), rng)
        hits += low <= 1.0 <= high
    assert 0.87 < hits / 150 <= 0.995
    assert bootstrap_interval([3.0, 3.0, float("nan")], rng) == (3.0, 3.0)
    assert np.isnan(bootstrap_interval([1.0], rng)).all()
    many = rng.normal(5.0, 2.0, 50_000)
    low, high = bootstrap_interval(many, rng)
    assert high - low == pytest.approx(2 * 1.96 * 2.0 / np.sqrt(50_000), rel=0.02)


def test_differences_of_means_use_the_pairs():
    rng = np.random.default_rng(5)
    a = rng.normal(0.0, 10.0, 80)
    found = mean_difference(a, a + 0.5 + 0.1 * rng.normal(size=80), ("a", "b"), rng)
    assert found.low < 0.5 < found.high and found.high - found.low < 0.06 and found.p < 1e-20
    holes = mean_difference([1.0, np.nan, 3.0], [2.0, 5.0, np.nan], ("a", "b"), rng)
    assert holes.pairs == 1


def test_quantile_intervals_cover_whatever_the_law():
    rng = np.random.default_rng(6)
    for q in (0.5, 0.95):
        truth = -np.log(1.0 - q)
        hits = [
            low <= truth <= high
            for _, low, high in (
                quantile_interval(rng.exponential(1.0, 200), q) for _ in range(400)
            )
        ]
        assert 0.93 < np.mean(hits) <= 1.0
    value, low, high = quantile_interval(np.arange(10.0), 0.95)
    assert value == pytest.approx(8.55) and np.isfinite(low) and np.isnan(high)
    assert np.isnan(quantile_interval([], 0.5)).all()


def test_the_ellipse_holds_its_share_and_points_the_right_way():
    rng = np.random.default_rng(7)
    azimuth = np.deg2rad(30.0)
    along = np.array([np.sin(azimuth), np.cos(azimuth)])
    across = np.array([np.cos(azimuth), -np.sin(azimuth)])
    s, t = rng.normal(size=(2, 20_000))
    points = [5.0, -3.0] + 4.0 * s[:, None] * along + 1.0 * t[:, None] * across
    found = landing_ellipse(points)
    assert found.centre == pytest.approx([5.0, -3.0], abs=0.1)
    assert np.rad2deg(found.azimuth) == pytest.approx(30.0, abs=1.0)
    assert found.half_axes == pytest.approx(
        np.sqrt(chi2.ppf(0.95, 2)) * np.array([4.0, 1.0]), rel=0.03
    )
    assert found.inside == pytest.approx(0.95, abs=0.006)
    assert landing_ellipse(points[:2]) is None
    line = landing_ellipse(np.column_stack((np.arange(9.0), np.zeros(9))))
    assert line.half_axes[1] == pytest.approx(0.0, abs=1e-6)


def test_none_in_n_is_about_three_in_n():
    assert share_upper_bound(0, 300) == pytest.approx(3.0 / 300, rel=0.01)
    assert share_upper_bound(5, 5) == 1.0


def test_a_confidence_sequence_stands_peeking_and_wilson_does_not():
    """Looks after every tenth of 300 trials: wrong at any look counts."""
    rng = np.random.default_rng(8)
    p, rounds, trials = 0.3, 200, 300
    wrong = {"sequence": 0, "wilson": 0}
    looks = range(5, trials, 10)
    for number in range(rounds):
        counts = np.cumsum(rng.random(trials) < p)
        seen = [share_confidence_sequence(int(counts[n - 1]), n) for n in looks]
        wrong["sequence"] += any(not low <= p <= high for low, high in seen)
        if number < 40:
            tests = [binomtest(int(counts[n - 1]), n).proportion_ci(0.95, "wilson") for n in looks]
            wrong["wilson"] += any(not c.low <= p <= c.high for c in tests)
    assert wrong["sequence"] / rounds <= 0.05
    assert wrong["wilson"] / 40 > 0.15


def test_a_confidence_sequence_at_its_ends():
    assert share_confidence_sequence(0, 0) == (0.0, 1.0)
    low, high = share_confidence_sequence(0, 100)
    assert low == 0.0 and 0.03 < high < 0.08
    mirrored = share_confidence_sequence(100, 100)
    assert mirrored == pytest.approx((1.0 - high, 1.0))
    low, high = share_confidence_sequence(500_000, 1_000_000)
    assert low < 0.5 < high and 0.002 < high - low < 0.006
    with pytest.raises(ValueError, match=r"between 0 and total \(3\)"):
        share_confidence_sequence(4, 3)
