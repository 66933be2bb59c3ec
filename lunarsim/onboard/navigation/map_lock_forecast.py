"""Forecast from a prior map whether scans can be located on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.signal import fftconvolve

from lunarsim.errors import InputError
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation.map_features import FeatureSettings, MapFeatures
from lunarsim.typing import Array

# Number of scales, in doublings of the grid spacing; minimum size of a feature in standard
# deviations of the noise (one in 16,000 grid points exceeds this size without a feature).
_SCALES, _THRESHOLD_SIGMAS = 4, 4.0


@dataclass(frozen=True)
class LockForecast:
    """Forecast whether scans of a planned area can be located on the prior map.

    Attributes
    ----------
    expected
        Expected log-likelihood ratio of the true place to the most probable wrong place.
    needed
        Log-likelihood ratio needed to locate the scans, given the number of possible places.
    rival
        Offset of the most probable wrong place, east and north (2,), m.
    """

    expected: float
    needed: float
    rival: tuple[float, float]

    @property
    def can_lock(self) -> bool:
        """Whether the expected likelihood ratio suffices to locate the scans."""
        return self.expected >= self.needed

    def __str__(self) -> str:
        word = "can lock" if self.can_lock else "cannot lock"
        east, north = self.rival
        return (
            f"{word}: log-likelihood ratio of the right place to the most probable wrong one "
            f"({east:+.0f} m east, {north:+.0f} m north): {self.expected:.0f} expected, "
            f"{self.needed:.0f} needed"
        )


def forecast_lock(
    prior: PriorMap,
    centre: tuple[float, float],
    side: float,
    place_sigma: float,
    *,
    certainty: float = 0.99999,
    settings: FeatureSettings | None = None,
) -> LockForecast:
    """Forecast from a prior map whether scans of a square area can be located on it.

    The terrain features of the square are separated from the noise of the map, scale by scale, with
    a threshold that noise rarely exceeds. At the true place, a scan of these features fits better
    than flat terrain by the sum of their squares over twice the variance. At a wrong place the gain
    is smaller by the mismatch with the map there. The probability of changed terrain and the
    correlation of errors are taken into account. Features below the noise are neglected, so the
    forecast is conservative.

    Parameters
    ----------
    prior
        Prior map.
    centre
        Centre of the square to be scanned (east, north), m.
    side
        Side of the square, m.
    place_sigma
        Prior standard deviation of the position, per axis, m.
    certainty
        Required probability of the best place.
    settings
        Parameters of the comparison between terrain and map.
    """
    _check_arguments(side, place_sigma, certainty)
    features = MapFeatures(prior, settings)
    posting = prior.grid.posting
    reach = max(2, int(np.ceil(3.0 * place_sigma / posting)))
    features_window, added, shown = (
        _cut_window(of, prior, centre, side, reach)
        for of in (*_extract_features(features), features.feature_height * features.known)
    )
    inner = (slice(reach, features_window.shape[0] - reach),) * 2
    template = features_window[inner]
    alike = fftconvolve(shown, template[::-1, ::-1], mode="valid")
    # Noise that passes the threshold correlates with itself.
    mismatch = alike[reach, reach] - float(added[inner].sum()) - alike
    log_ratio = 0.5 * np.maximum(mismatch, 0.0) / (features.variance * features.correlated_count)
    expected = (1.0 - features.settings.changed_probability) * log_ratio
    n = np.arange(-reach, reach + 1)
    is_far = np.hypot(*np.meshgrid(n, n)) > 3.0
    # A more distant wrong place has a lower prior probability.
    prior_cost = 0.5 * posting**2 * (n[:, None] ** 2 + n[None, :] ** 2) / place_sigma**2
    cost = np.where(is_far, expected + prior_cost, np.inf)
    row, col = np.unravel_index(int(np.argmin(cost)), cost.shape)
    places = max(2.0 * np.pi * (place_sigma / posting) ** 2, 1.0)
    needed = float(np.log(places) - np.log1p(-certainty))
    return LockForecast(
        float(expected[row, col]), needed, (float(n[col] * posting), float(n[row] * posting))
    )


def _check_arguments(side: float, place_sigma: float, certainty: float) -> None:
    """Raise an `InputError` if an argument of `forecast_lock` is out of range.

    `side` and `place_sigma` are in m; `certainty` is a probability.
    """
    if not (np.isfinite(side) and side > 0.0):
        raise InputError("side_m", side, "must be positive and finite")
    if not (np.isfinite(place_sigma) and place_sigma > 0.0):
        raise InputError("place_sigma_m", place_sigma, "must be positive and finite")
    if not 0.0 < certainty < 1.0:
        raise InputError("certainty", certainty, "must be more than 0 and less than 1")


def _cut_window(
    raster: NDArray[Any], prior: PriorMap, centre: tuple[float, float], side: float, margin: int
) -> Array:
    """Cut a square with a margin out of a raster; the result is 0 outside the map.

    `raster` (rows, cols) is on the grid of the map. The square has its centre at `centre` (east,
    north), m, the side `side`, m, and a margin of `margin` grid points.
    """
    row, col = (int(part) for part in prior.grid.cell(centre))
    half = max(1, round(0.5 * side / prior.grid.posting)) + margin
    out = np.zeros((2 * half + 1, 2 * half + 1))
    r0, r1 = max(row - half, 0), min(row + half + 1, raster.shape[0])
    c0, c1 = max(col - half, 0), min(col + half + 1, raster.shape[1])
    if r0 < r1 and c0 < c1:
        top, left = r0 - row + half, c0 - col + half
        out[top : top + r1 - r0, left : left + c1 - c0] = raster[r0:r1, c0:c1]
    return out


def _extract_features(features: MapFeatures) -> tuple[Array, Array]:
    """Return the terrain features of a map above the noise threshold (rows, cols), m.

    The second array is the covariance of the noise left in these features with the noise of the map
    (rows, cols), m^2. The method is hard thresholding of undecimated wavelets, which are
    differences of binomial smoothings (Donoho and Johnstone 1994).
    """
    left: Array = np.asarray(features.feature_height * features.known, np.float64)
    impulse: Array = np.zeros((129, 129))
    impulse[64, 64] = 1.0
    alike = features.prior.correlation / features.prior.grid.posting / np.sqrt(2.0)
    if alike > 0.0:
        impulse = np.asarray(ndimage.gaussian_filter(impulse, min(alike, 16.0)), np.float64)
        impulse /= np.sqrt((impulse**2).sum())
    limit = _THRESHOLD_SIGMAS * np.sqrt(features.variance)
    out, added, full_impulse = np.zeros(left.shape), np.zeros(left.shape), impulse
    for scale in range(_SCALES + 1):
        last = scale == _SCALES
        smooth, spread = (0.0 * of if last else _smoothed(of, 2**scale) for of in (left, impulse))
        response, detail = impulse - spread, left - smooth
        clear = np.abs(detail) > limit * np.sqrt((response**2).sum())
        out += np.where(clear, detail, 0.0)
        added += np.where(clear, features.variance * float((full_impulse * response).sum()), 0.0)
        left, impulse = smooth, spread
    return out, added


def _smoothed(raster: Array, step: int) -> Array:
    """Smooth a raster by five binomial weights per axis, on grid points `step` apart."""
    kernel = np.zeros(4 * step + 1)
    kernel[::step] = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    for axis in (0, 1):
        raster = ndimage.convolve1d(raster, kernel, axis=axis, mode="constant")
    return np.asarray(raster)
