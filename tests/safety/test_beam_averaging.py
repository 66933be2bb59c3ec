"""Test the correction for the width of a LiDAR beam against numerical averages."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.safety.beam_averaging import (
    peak_ratio,
    sharpened_elevation,
    unaveraged_height,
    variogram_ratio,
)


def beam_offsets(sigma, count=200_000):
    """Return random points (n, 2) of a beam's footprint, m."""
    return np.random.default_rng(1).normal(0.0, sigma, (count, 2))


@pytest.mark.parametrize("sigma", [0.002, 0.05, 0.2, 1.0])
def test_peak_ratio_is_the_mean_height_over_the_beam(sigma):
    radius = 0.3
    r = np.linalg.norm(beam_offsets(sigma), axis=1)
    mean = np.sqrt(np.maximum(1.0 - (r / radius) ** 2, 0.0)).mean()
    assert float(peak_ratio(radius, sigma)) == pytest.approx(mean, rel=0.02)
    assert float(peak_ratio(1e-6 * sigma, sigma)) < 1e-10


def test_unaveraged_height_inverts_the_averaging():
    height = np.array([0.02, 0.1, 0.3, 1.0])
    measured = height * peak_ratio(height, 0.08)  # hemispheres
    found = unaveraged_height(np.concatenate((measured, -measured, [0.0])), 0.08, 0.5)
    assert found == pytest.approx(np.concatenate((height, -height, [0.0])), rel=1e-3)
    assert (unaveraged_height(measured, 0.1, 0.5) > height).all()


def test_sharpening_raises_peaks_lowers_holes_and_keeps_planes():
    x, y = np.meshgrid(np.arange(20) * 0.2, np.arange(15) * 0.2)
    plane = 0.1 * x - 0.2 * y
    assert sharpened_elevation(plane, 0.2, 0.05) == pytest.approx(plane, abs=1e-12)
    wave = plane + 0.1 * np.sin(4.0 * x)
    wider = [np.abs(sharpened_elevation(wave, 0.2, s) - plane)[:, 1:-1].max() for s in (0.02, 0.1)]
    assert 0.1 * np.exp(-16.0 * 0.1**2 / 2) < 0.1 < wider[0] < wider[1]
    holed = wave.copy()
    holed[7, 7] = np.nan
    assert np.isnan(sharpened_elevation(holed, 0.2, 0.1)).sum() == 1


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.5])
def test_variogram_ratio_is_that_of_a_linear_variogram(sigma):
    distance = 0.25
    apart = np.sqrt(2.0) * beam_offsets(sigma)
    far = np.hypot(apart[:, 0] + distance, apart[:, 1]).mean()
    near = np.hypot(*apart.T).mean()
    expected = (far - near) / distance
    assert variogram_ratio(distance, sigma) == pytest.approx(expected, abs=0.01)


def test_a_line_beam_changes_no_bit():
    z = np.random.default_rng(1).normal(size=(9, 9)).astype(np.float32)
    assert sharpened_elevation(z, 0.2, 0.0) is z
    assert np.array_equal(unaveraged_height(z.ravel(), 0.0, 0.5), z.ravel().astype(np.float64))
    assert (peak_ratio(np.array([0.0, 0.1]), 0.0) == 1.0).all()
    assert variogram_ratio(0.2, 0.0) == 1.0
