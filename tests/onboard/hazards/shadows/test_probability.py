from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.shadows import (
    cover_probability,
)
from tests.reference.shadows import rice


def test_rice_form_equals_the_reference():
    rng = np.random.default_rng(2)
    for _ in range(60):
        sigma, mean = rng.uniform(0.02, 0.6), rng.uniform(0.1, 1.5)
        spread, d = rng.uniform(0.02, 0.4) * mean, rng.uniform(0.0, 3.0)
        found = cover_probability([[d]], [sigma], [mean], [spread])[0, 0]
        assert found == pytest.approx(rice(d, sigma, mean, spread), abs=2e-3)


@pytest.mark.parametrize("away", [4.5, 4.99, 5.01, 6.0, 8.0, 20.0])
def test_far_from_a_rock_the_form_is_as_good_as_near_it(away):
    """Where the distance is taken as normal, about the radius at which that tells."""
    rng = np.random.default_rng(round(100 * away))
    for _ in range(30):
        sigma, share = rng.uniform(0.05, 0.6), rng.uniform(0.25, 2.0)
        d, spread = away * sigma, share * sigma
        mean = max(d + rng.uniform(-3.0, 3.0) * np.hypot(sigma, spread), 0.05)
        found = cover_probability([[d]], [sigma], [mean], [spread])[0, 0]
        assert found == pytest.approx(rice(d, sigma, mean, spread), abs=7e-4)


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


@pytest.mark.parametrize("form", ["exact", "Gaussian", None])
def test_a_form_that_there_is_not_is_refused(form):
    with pytest.raises(InputError, match="cover_model"):
        cover_probability([[1.0]], [0.2], [0.5], [0.1], form)
