"""Hyperparameters of the random field, fitted to the variogram of a point cloud."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import curve_fit
from scipy.spatial import cKDTree

from lunarsim.onboard.hazards.gaussian_dem.conventional import check_points
from lunarsim.typing import Array, IntArray

_BIN_COUNT = 24


@dataclass(frozen=True)
class FieldFit:
    """Hyperparameters of a Gaussian random field, fitted to the variogram of terrain.

    Attributes
    ----------
    sigma_f, length_scale
        Standard deviation and length scale of the field, m. Lags much shorter than the length scale
        determine only their combination `growth`.
    growth
        Slope of the variogram at the origin, sigma_f^2 / length_scale, m.
    lag, variogram
        Centres of the distance bins (n,), m, and half the mean squared height difference of the
        pairs of points in each bin (n,), m^2.
    seconds
        Wall-clock time of the fit, s.
    """

    sigma_f: float
    length_scale: float
    growth: float
    lag: Array
    variogram: Array
    seconds: float


def fit_hyperparameters(
    points: ArrayLike,
    sigma_eps: float,
    rng: np.random.Generator,
    *,
    largest_lag: float = 10.0,
    pairs: int = 200_000,
) -> FieldFit:
    """Fit the exponential kernel of a random field to the variogram of a point cloud.

    The model variogram is ``sigma_f^2 (1 - exp(-d / length)) + sigma_eps^2``. Pairs of points are
    sampled at random and their squared height differences are averaged in bins of their distance
    (lag). The model is fitted to the bins, each weighted by its relative error.

    Parameters
    ----------
    points
        East, north, up (n, 3), m; at least 100.
    sigma_eps
        Standard deviation of a sample, m; not fitted.
    rng
        Random generator for the pairs.
    largest_lag
        Maximum distance of the points of a pair, m.
    pairs
        Number of pairs sampled.

    Raises
    ------
    ValueError
        If there are too few points, or no two points within the maximum lag.
    """
    start = time.perf_counter()
    cloud = check_points(points)
    if len(cloud) < 100:
        raise ValueError(f"points: must be at least 100 points, got {len(cloud)}.")
    distance, square = _sample_pairs(cloud, rng, pairs, largest_lag)
    if not distance.size:
        raise ValueError(
            f"largest_lag: must be more than the distance of the closest points, got {largest_lag}."
        )
    lag, variogram, count = _bin_pairs(distance, square, largest_lag)
    sigma_f, length = _fit_model(lag, variogram, count, sigma_eps, largest_lag)
    return FieldFit(
        sigma_f, length, sigma_f**2 / length, lag, variogram, time.perf_counter() - start
    )


def _sample_pairs(
    cloud: Array, rng: np.random.Generator, pairs: int, largest_lag: float
) -> tuple[Array, Array]:
    """Sample point pairs; return their distances and half squared height differences.

    `cloud` (n, 3) are the points, m. At most `pairs` pairs up to the distance `largest_lag`, m, are
    returned: distances (m,), m, and half squared differences (m,), m^2.
    """
    # Random direction and log-uniform lag, so that every bin gets its share.
    first = rng.integers(0, len(cloud), pairs)
    low = 0.02 * largest_lag
    lag = low * (largest_lag / low) ** rng.random(pairs)
    angle = 2.0 * np.pi * rng.random(pairs)
    aim = cloud[first, :2] + lag[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    _, second = cKDTree(cloud[:, :2]).query(aim)
    distance = np.linalg.norm(cloud[first, :2] - cloud[second, :2], axis=1)
    use = (distance > 0.0) & (distance <= largest_lag)
    return distance[use], 0.5 * (cloud[first, 2] - cloud[second, 2])[use] ** 2


def _bin_pairs(distance: Array, square: Array, largest_lag: float) -> tuple[Array, Array, IntArray]:
    """Average point pairs in logarithmic distance bins with at least 30 pairs.

    `distance` (m,), m, and `square` (m,), m^2, are the result of `_sample_pairs`, and `largest_lag`
    is the end of the last bin, m. Returns mean distance, mean of `square` and number of pairs of
    each bin (k,); bins with fewer pairs are omitted.
    """
    edges = np.geomspace(distance.min(), largest_lag, _BIN_COUNT + 1)
    index = np.clip(np.searchsorted(edges, distance) - 1, 0, _BIN_COUNT - 1)
    count = np.bincount(index, minlength=_BIN_COUNT)
    filled = count >= 30
    centre = np.bincount(index, weights=distance, minlength=_BIN_COUNT)[filled] / count[filled]
    height = np.bincount(index, weights=square, minlength=_BIN_COUNT)[filled] / count[filled]
    return centre, height, count[filled]


def _fit_model(
    lag: Array, variogram: Array, count: IntArray, sigma_eps: float, largest_lag: float
) -> tuple[float, float]:
    """Fit the exponential variogram to its bins; return sigma_f and length scale, m.

    `lag`, `variogram` and `count` are the result of `_bin_pairs`; `sigma_eps` is the standard
    deviation of a sample, m. `largest_lag`, m, gives the initial length scale of the fit.
    """

    def model(d: Array, log_sigma: float, log_length: float) -> Array:
        """Return the model variogram, m^2, at distances `d`, m."""
        rise = np.exp(2.0 * log_sigma) * -np.expm1(-d / np.exp(log_length))
        return np.asarray(rise + sigma_eps**2)

    top = max(float(variogram.max() - sigma_eps**2), 1e-8)
    (log_sigma, log_length), _ = curve_fit(
        model,
        lag,
        variogram,
        p0=(0.5 * np.log(top), np.log(0.3 * largest_lag)),
        sigma=variogram / np.sqrt(count) + 1e-12,
        bounds=([np.log(1e-5), np.log(1e-3)], [np.log(1e3), np.log(1e4)]),
        max_nfev=2000,
    )
    return float(np.exp(log_sigma)), float(np.exp(log_length))
