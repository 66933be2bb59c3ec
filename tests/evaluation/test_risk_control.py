"""Threshold of p_safe that bounds the risk of chosen sites."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom

from lunarsim.errors import InputError
from lunarsim.evaluation.risk_control import risk_threshold


def draw(rng, n):
    """Chosen sites whose p_safe is too high: a site fails with twice its stated probability."""
    p = rng.uniform(0.5, 1.0, n)
    return p, rng.random(n) < np.minimum(2.0 * (1.0 - p), 1.0)


def true_risk(threshold):
    """Probability that p reaches the threshold and the site fails, for `draw`."""
    if threshold > 1.0:
        return 0.0
    # p is uniform on 0.5 to 1 with density 2; the failure probability is 2 (1 - p).
    return 2.0 * (1.0 - max(threshold, 0.5)) ** 2


def test_the_risk_is_bounded_in_the_stated_fraction_of_draws():
    rng, draws, exceeded, thresholds = np.random.default_rng(1), 500, 0, []
    for _ in range(draws):
        found = risk_threshold(*draw(rng, 150), max_risk=0.08, confidence=0.9)
        exceeded += true_risk(found.threshold) > 0.08
        thresholds.append(found.threshold)
    assert exceeded <= binom.ppf(0.999, draws, 0.1)
    # It is not vacuous: the threshold with exactly this risk is 0.8.
    assert 0.8 < np.median(thresholds) < 0.88
    assert exceeded > 0.03 * draws


def test_the_threshold_is_the_lowest_whose_exact_bound_holds():
    p, failed = draw(np.random.default_rng(2), 400)
    found = risk_threshold(p, failed, max_risk=0.05, confidence=0.95)
    assert found.used == np.count_nonzero(p >= found.threshold)
    assert found.failed == np.count_nonzero(failed[p >= found.threshold])
    # Clopper-Pearson: with a risk of the bound, as few failures have a probability of 5 %.
    assert binom.cdf(found.failed, 400, found.upper_bound) == pytest.approx(0.05)
    lower = p[p < found.threshold].max()
    more = np.count_nonzero(failed[p >= lower])
    assert binom.cdf(more, 400, 0.05) > 0.05 >= binom.cdf(found.failed, 400, 0.05)


@pytest.mark.parametrize(("worlds", "exists"), [(58, False), (59, True)])
def test_too_few_worlds_give_no_threshold_and_say_how_many_are_needed(worlds, exists):
    found = risk_threshold(np.full(worlds, 0.9), np.zeros(worlds, bool))
    assert found.needed_worlds == 59
    assert math.isfinite(found.threshold) == exists
    assert found.used == (worlds if exists else 0)


def test_worlds_without_a_site_are_no_failures_and_equal_values_are_used_together():
    p = np.array([0.9] * 50 + [0.8] * 50 + [np.nan] * 100)
    failed = np.zeros(200, bool)
    failed[50:53] = True  # with 0.8
    found = risk_threshold(p, failed, max_risk=0.03)
    assert (found.threshold, found.used, found.failed) == (0.9, 50, 0)
    found = risk_threshold(p, failed, max_risk=0.05)
    assert (found.threshold, found.used, found.failed) == (0.8, 100, 3)


@pytest.mark.parametrize(
    ("p", "failed", "levels", "field"),
    [
        ([], [], {}, "p_safe"),
        ([0.5, 0.6], [True], {}, "failed"),
        ([0.5], [True], {"max_risk": 0.0}, "max_risk"),
        ([0.5], [True], {"confidence": 1.0}, "confidence"),
    ],
)
def test_wrong_input_is_named(p, failed, levels, field):
    with pytest.raises(InputError, match=field):
        risk_threshold(p, np.array(failed, bool), **levels)
