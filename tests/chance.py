"""Thresholds and sample sizes of statistical tests.

A threshold follows from the chance that a fresh draw exceeds it.

The suite has fewer than 50 such assertions. With the chance below for each of them, it fails on a
fresh draw of all of them once in 2,000 runs, if the program is right.
"""

from __future__ import annotations

import pytest
from scipy.stats import binom, chi2

# Of one assertion.
CHANCE = 1e-5


def ratio_bounds(degrees: int, excess: float = 1.0) -> tuple[float, float]:
    """Return bounds of a sum of normalised squared errors over its degrees of freedom.

    Parameters
    ----------
    degrees
        Degrees of freedom that are independent. Epochs of one flight are not independent, nor are
        flights that share world and noise: such a group counts once.
    excess
        Factor by which the true variance may differ from the stated one, for a filter whose model
        is not exact.
    """
    low, high = chi2.ppf([CHANCE, 1.0 - CHANCE], degrees) / degrees
    return float(low) / excess, float(high) * excess


def proportion_bounds(probability: float, n: int) -> tuple[float, float]:
    """Return bounds of the fraction of n independent trials that succeed."""
    low, high = binom.ppf([CHANCE, 1.0 - CHANCE], n, probability) / n
    return float(low), float(high)


def sample_sizes(small: int, full: int) -> pytest.MarkDecorator:
    """Run a test with a small sample by default, and with the full one with ``-m slow``.

    The test takes the size as the argument `count`.
    """
    return pytest.mark.parametrize("count", [small, pytest.param(full, marks=pytest.mark.slow)])
