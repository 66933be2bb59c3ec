"""Whether scans can be told their place on a map at all, from the map alone."""

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

Array = NDArray[np.float64]

# Scales at which features are looked for, in doublings of a post; and by how many deviations of
# noise they must stand out: one in 16,000 posts does without any.
_SCALES, _SURE = 4, 4.0


@dataclass(frozen=True)
class LockForecast:
    """What a map tells of the ground planned to be scanned.

    Attributes
    ----------
    expected
        Logarithm of how much likelier the right place is expected to become than the likeliest
        wrong one.
    needed
        What that must be for a lock, with so many places to tell apart.
    rival
        By how much the likeliest wrong place is off, east and north (2,), m.
    """

    expected: float
    needed: float
    rival: tuple[float, float]

    @property
    def can_lock(self) -> bool:
        """Whether it suffices."""
        return self.expected >= self.needed

    def __str__(self) -> str:
        word = "can lock" if self.can_lock else "cannot lock"
        east, north = self.rival
        return (
            f"{word}: the map tells the right place from the likeliest wrong one "
            f"({east:+.0f} m east, {north:+.0f} m north) by {self.expected:.0f} nats, "
            f"{self.needed:.0f} are needed"
        )


def can_lock(
    prior: PriorMap,
    middle: tuple[float, float],
    swept: float,
    place_sigma: float,
    *,
    certainty: float = 0.99999,
    settings: FeatureSettings | None = None,
) -> LockForecast:
    """Forecast from a map alone whether a sweep can be told its place on it.

    The features of the swept square are freed from the map's noise, scale by scale: what noise
    would hardly ever show is kept. A scan of them fits the map at its right place by the sum of
    their squares over twice the variance better than level ground would, and at a wrong place by
    the less the less the map is like them there. Counted are the share of the map that is held to
    be up to date and errors that are alike. Features that drown in the noise one by one are not
    seen: a forecast errs towards "cannot lock".

    Parameters
    ----------
    prior
        The map.
    middle
        Of the square to be swept (east, north), m.
    swept
        Its side, m.
    place_sigma
        Deviation of the place before, an axis, m.
    certainty
        Probability of the best place that a lock takes.
    settings
        How places are judged.
    """
    _check(swept, place_sigma, certainty)
    features = MapFeatures(prior, settings)
    posting = prior.grid.posting
    reach = max(2, int(np.ceil(3.0 * place_sigma / posting)))
    ground, added, shown = (
        _window(of, prior, middle, swept, reach)
        for of in (*_denoised(features), features.shown * features.kept)
    )
    inner = (slice(reach, ground.shape[0] - reach),) * 2
    template = ground[inner]
    alike = fftconvolve(shown, template[::-1, ::-1], mode="valid")
    # The noise that is kept along with features fits itself.
    gap = alike[reach, reach] - float(added[inner].sum()) - alike
    told = 0.5 * np.maximum(gap, 0.0) / (features.variance * features.together)
    expected = (1.0 - features.settings.changed) * told
    n = np.arange(-reach, reach + 1)
    far = np.hypot(*np.meshgrid(n, n)) > 3.0
    # A wrong place farther off is the less likely from the beginning.
    away = 0.5 * posting**2 * (n[:, None] ** 2 + n[None, :] ** 2) / place_sigma**2
    total = np.where(far, expected + away, np.inf)
    row, col = np.unravel_index(int(np.argmin(total)), total.shape)
    places = max(2.0 * np.pi * (place_sigma / posting) ** 2, 1.0)
    needed = float(np.log(places) - np.log1p(-certainty))
    return LockForecast(
        float(expected[row, col]), needed, (float(n[col] * posting), float(n[row] * posting))
    )


def _check(swept: float, place_sigma: float, certainty: float) -> None:
    """Refuse what no sweep can be."""
    if not (np.isfinite(swept) and swept > 0.0):
        raise InputError("swept_m", swept, "a positive length in metres")
    if not (np.isfinite(place_sigma) and place_sigma > 0.0):
        raise InputError("place_sigma_m", place_sigma, "a positive deviation in metres")
    if not 0.0 < certainty < 1.0:
        raise InputError("certainty", certainty, "a probability between 0 and 1")


def _window(
    of: NDArray[Any], prior: PriorMap, middle: tuple[float, float], swept: float, reach: int
) -> Array:
    """Return the swept square and so many posts around it, 0 beyond the map."""
    row, col = (int(part) for part in prior.grid.cell(middle))
    half = max(1, round(0.5 * swept / prior.grid.posting)) + reach
    out = np.zeros((2 * half + 1, 2 * half + 1))
    r0, r1 = max(row - half, 0), min(row + half + 1, of.shape[0])
    c0, c1 = max(col - half, 0), min(col + half + 1, of.shape[1])
    if r0 < r1 and c0 < c1:
        top, left = r0 - row + half, c0 - col + half
        out[top : top + r1 - r0, left : left + c1 - c0] = of[r0:r1, c0:c1]
    return out


def _denoised(features: MapFeatures) -> tuple[Array, Array]:
    """Return what of a map's features noise would hardly ever show (rows, cols), m.

    And the mean product of what noise is kept with the map's own (rows, cols), m^2.

    Undecimated wavelets (differences of binomial smoothings), of which is kept what exceeds some
    deviations of the noise at its scale: hard thresholds, as of Donoho and Johnstone (1994).
    """
    left: Array = np.asarray(features.shown * features.kept, np.float64)
    impulse: Array = np.zeros((129, 129))
    impulse[64, 64] = 1.0
    alike = features.prior.correlation / features.prior.grid.posting / np.sqrt(2.0)
    if alike > 0.0:
        impulse = np.asarray(ndimage.gaussian_filter(impulse, min(alike, 16.0)), np.float64)
        impulse /= np.sqrt((impulse**2).sum())
    limit = _SURE * np.sqrt(features.variance)
    out, added, whole = np.zeros(left.shape), np.zeros(left.shape), impulse
    for scale in range(_SCALES + 1):
        last = scale == _SCALES
        smooth, spread = (0.0 * of if last else _smoothed(of, 2**scale) for of in (left, impulse))
        response, detail = impulse - spread, left - smooth
        clear = np.abs(detail) > limit * np.sqrt((response**2).sum())
        out += np.where(clear, detail, 0.0)
        added += np.where(clear, features.variance * float((whole * response).sum()), 0.0)
        left, impulse = smooth, spread
    return out, added


def _smoothed(of: Array, step: int) -> Array:
    """Return a raster smoothed by binomial weights that lie `step` apart."""
    kernel = np.zeros(4 * step + 1)
    kernel[::step] = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    for axis in (0, 1):
        of = ndimage.convolve1d(of, kernel, axis=axis, mode="constant")
    return np.asarray(of)
