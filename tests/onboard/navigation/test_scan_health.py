"""Test spike removal and noise estimation of scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.messages.measurements import LidarScan
from lunarsim.onboard.navigation.scan_health import is_noisy, range_noise, remove_spikes
from lunarsim.onboard.navigation.scan_odometry import remove_implausible_ranges


def scan_of(image, sigma=0.01):
    r = np.asarray(image, dtype=np.float64)
    direction = np.tile([0.0, 0.0, 1.0], (r.size, 1))
    return LidarScan(0.0, r.ravel(), direction, np.eye(3), np.full(r.size, sigma), r.shape)


def slope(rows=40, cols=50):
    row, col = np.mgrid[:rows, :cols]
    return 200.0 + 0.7 * row - 0.4 * col


def spikes_by_hand(r, sigma):
    """Return pixels too far from three of their neighbours in one direction."""
    out = np.zeros(r.shape, bool)
    for i in range(r.shape[0]):
        for j in range(r.shape[1]):
            near = [
                r[a, b]
                for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1))
                if 0 <= a < r.shape[0] and 0 <= b < r.shape[1]
            ]
            gaps = np.array([r[i, j] - v for v in near if np.isfinite(v)])
            far = 1.0 + 6.0 * sigma
            out[i, j] = np.sum(gaps > far) >= 3 or np.sum(gaps < -far) >= 3
    return out


@pytest.mark.parametrize("sigma", [0.0, 0.05])
def test_spikes_are_those_found_pixel_by_pixel(sigma):
    rng = np.random.default_rng(1)
    r = slope() + 0.05 * rng.standard_normal((40, 50))
    off = rng.random(r.shape) < 0.1
    r[off] += rng.choice([-1.0, 1.0], off.sum()) * rng.uniform(0.8, 6.0, off.sum())
    r[rng.random(r.shape) < 0.05] = np.nan
    scan = scan_of(r, sigma)
    expected = spikes_by_hand(r, sigma)
    assert expected.sum() > 50
    found = remove_spikes(scan).range.reshape(r.shape)
    assert np.array_equal(np.isnan(found), np.isnan(r) | expected)
    assert np.array_equal(found[~np.isnan(found)], r[~np.isnan(found)])


def test_terrain_has_no_spikes():
    r = slope()
    r[10:14, 20:23] -= 2.0  # a rock of a few pixels
    r[:, 40:] += 5.0  # the edge of a cliff
    scan = scan_of(r)
    assert remove_spikes(scan) is scan
    small = scan_of(np.full((2, 9), 50.0))
    assert remove_spikes(small) is small


@pytest.mark.parametrize("sigma", [0.02, 0.3, 1.0])
def test_noise_is_what_ranges_scatter_by(sigma):
    rng = np.random.default_rng(2)
    r = slope(128, 128) + sigma * rng.standard_normal((128, 128))
    r[rng.random(r.shape) < 0.2] = np.nan
    assert range_noise(scan_of(r)) == pytest.approx(sigma, rel=0.05)


def test_a_scan_is_noisy_where_it_scatters_beyond_what_is_stated():
    rng = np.random.default_rng(3)
    r = slope() + 0.5 * rng.standard_normal((40, 50))
    assert is_noisy(scan_of(r, 0.02))
    assert not is_noisy(scan_of(r, 0.1)), "three sigmas and rough terrain"
    assert is_noisy(scan_of(slope(), 0.2)), "so much noise is too much, stated or not"
    assert not is_noisy(scan_of(slope(), 0.02))
    assert not is_noisy(scan_of(np.full((40, 50), np.nan)))
    assert np.isnan(range_noise(scan_of(np.full((9, 9), 10.0)))), "too few pixels"


def test_rows_and_columns_that_are_not_those_of_the_pixels_are_refused():
    with pytest.raises(InputError, match=r"scan\.shape"):
        remove_spikes(replace(scan_of(slope()), shape=(40, 49)))


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [("shape", (-40, -50), "shape"), ("shape", (2000,), "shape"), ("shape", (40, 25, 2), "shape"),
     ("shape", (40.0, 50.0), "shape"), ("shape", None, "shape"), ("shape", (40, 49), "range"),
     ("range", [200.0] * 2000, "range"), ("range", None, "range"),
     ("range", np.full(2000, 200.0 + 0j), "range"), ("range", np.full(2000, "200"), "range"),
     ("range", np.ma.masked_equal(np.full(2000, 200.0), 200.0), "range"),
     ("sigma", np.ma.masked_equal(np.full(2000, 0.01), 0.01), "sigma"),
     ("mount", np.eye(3).astype(object), "mount")],
)  # fmt: skip
def test_arrays_that_are_none_of_a_scan_are_refused_by_name(field, value, match):
    scan = replace(scan_of(slope()), **{field: value})
    with pytest.raises(InputError, match=rf"scan\.{match}"):
        remove_implausible_ranges(scan)
    with pytest.raises(InputError, match=rf"scan\.{match}"):
        scan.check(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize("sigma", [np.nan, -0.01, np.inf])
def test_range_without_sigma_is_ignored(sigma):
    scan = scan_of(slope())
    broken = scan.sigma.copy()
    broken[::3] = sigma
    found = remove_implausible_ranges(replace(scan, sigma=broken))
    assert np.isnan(found.range[::3]).all() and np.isfinite(found.range[1::3]).all()
