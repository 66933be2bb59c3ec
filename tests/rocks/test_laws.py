from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest

from lunarsim.errors import InputError
from lunarsim.rocks.size_distribution import golombek_cover, golombek_number, sample_diameters
from tests.chance import CHANCE


@pytest.mark.parametrize("k", [0.01, 0.05, 0.2])
def test_number_integrates_cover(k):
    # N(D) = integral of -dF / (pi D^2 / 4)
    q = 1.79 + 0.152 / k
    for d in (0.1, 0.5, 1.5):
        density = lambda s: k * q * np.exp(-q * s) / (np.pi * s * s / 4)  # noqa: E731
        assert golombek_number(d, k) == pytest.approx(quad(density, d, np.inf)[0], rel=1e-6)


@pytest.mark.statistical
def test_sampled_diameters_follow_the_law():
    k, low, high = 0.05, 0.15, 3.0
    d = sample_diameters(40_000.0, k, low, high, np.random.default_rng(1))
    total = golombek_number(low, k) - golombek_number(high, k)
    assert abs(len(d) - 40_000.0 * total) < 5.0 * np.sqrt(40_000.0 * total)

    def cdf(x):
        return 1.0 - (golombek_number(x, k) - golombek_number(high, k)) / total

    assert kstest(d, cdf).pvalue > CHANCE
    assert (np.diff(d) <= 0).all()
    covered = np.sum(np.pi * d**2 / 4) / 40_000.0
    law = golombek_cover(low, k) - golombek_cover(high, k)
    assert covered == pytest.approx(float(law), rel=0.05)


def test_impossible_law_is_refused():
    with pytest.raises(InputError, match=r"rocks\.cover"):
        golombek_cover(0.1, 0.0)
    with pytest.raises(InputError, match="min_diameter"):
        sample_diameters(1.0, 0.05, 2.0, 1.0, np.random.default_rng(1))
