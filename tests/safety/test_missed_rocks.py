"""Rocks that no sample has met: the height curve against rocks that are drawn."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.safety.unseen_rocks import HeightCurve


def drawn(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return heights of rocks, m."""
    return np.minimum(0.1 * (1.0 - rng.random(count)) ** -0.4, 1.2)


def test_missed_rocks_are_those_that_samples_miss():
    rng = np.random.default_rng(0)
    high, ground, ratio = drawn(rng, 4000), 40_000.0, 0.8
    area = np.pi / (4.0 * ratio**2)
    height = np.geomspace(0.03, 3.0, 60)
    above = area * np.maximum(high**2 - height[:, None] ** 2, 0.0)
    curve = HeightCurve(height, np.maximum(above.sum(axis=1) / ground, 1e-12))
    for h in (0.15, 0.25, 0.4):
        for density in (1.0, 10.0, 50.0):
            seen = area * np.maximum(high**2 - h**2, 0.0)
            expected = (np.exp(-density * seen) * (high > h)).sum() / ground
            assert curve.missed(h, density) == pytest.approx(expected, rel=0.25, abs=1e-5)


def test_missed_rocks_never_fall_with_less_height_or_thinner_samples_or_more_rocks():
    rng = np.random.default_rng(1)
    height = np.geomspace(0.02, 2.0, 40)
    for _ in range(20):
        share = np.exp(np.cumsum(-rng.exponential(0.3, 40))) * 0.3
        curve, more = HeightCurve(height, share), HeightCurve(height, 1.5 * share)
        h, density = np.sort(rng.uniform(0.0, 2.2, 50)), np.sort(rng.uniform(0.01, 3000.0, 50))
        assert (np.diff(curve.missed(h, 20.0)) <= 1e-12).all()
        assert (np.diff(curve.missed(0.3, density)) <= 1e-12).all()
        assert (more.missed(h, 20.0) >= curve.missed(h, 20.0)).all()
        assert curve.missed(h[:, None], density).shape == (50, 50)
