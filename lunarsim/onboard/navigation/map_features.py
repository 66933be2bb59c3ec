"""Features of a prior map, and the likelihood of scanned terrain at a place on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation import _registration_kernels as k
from lunarsim.typing import Array, BoolArray, IntArray

# Minimum known fraction of the square around a grid point.
_MIN_KNOWN_SHARE = 0.6
# Side of the terrain seen by a lander without a sweep, approximate, m.
_DEFAULT_SWEEP_M = 40.0


def subtract_plane(height: Array, known: BoolArray, reach: int) -> tuple[Array, BoolArray]:
    """Subtract from each raster height the plane fitted to its neighbourhood.

    The neighbourhood is a square centred on the grid point. The subtraction removes long
    undulations and the tilt by an attitude error, and leaves local terrain features. A few unknown
    heights hardly change the plane.

    Parameters
    ----------
    height
        Heights (rows, cols), m; unknown ones may have any value.
    known
        Whether each height is known (rows, cols).
    reach
        Half width of the square; it has 2 `reach` + 1 grid points per side.

    Returns
    -------
    above
        Heights above the planes (rows, cols), m; 0 without a plane.
    kept
        Whether there is a plane (rows, cols): the grid point and 60 % of its square are known, and
        the known points surround it.
    """
    side = 2 * reach + 1
    offset = np.arange(-reach, reach + 1, dtype=np.float64) / max(reach, 1)
    ones = np.ones(side)
    weight = known.astype(np.float64)
    filled = np.where(known, height, 0.0)

    def moment(of: Array, east: int, north: int) -> Array:
        along = ndimage.correlate1d(of, ones * offset**east, axis=1, mode="constant")
        return np.asarray(ndimage.correlate1d(along, ones * offset**north, axis=0, mode="constant"))

    n = moment(weight, 0, 0)
    x, y = moment(weight, 1, 0), moment(weight, 0, 1)
    xx, xy, yy = moment(weight, 2, 0), moment(weight, 1, 1), moment(weight, 0, 2)
    z, xz, yz = moment(filled, 0, 0), moment(filled, 1, 0), moment(filled, 0, 1)
    # Height of the plane at the central grid point by Cramer's rule.
    a, b, c = xx * yy - xy * xy, x * yy - y * xy, x * xy - y * xx
    det = n * a - x * b + y * c
    # Limit the variance of the plane: it is large if all known points lie on one side.
    kept = known & (n >= _MIN_KNOWN_SHARE * side * side)
    kept &= a <= 4.0 * det / (_MIN_KNOWN_SHARE * side * side)
    safe = np.where(kept, det, 1.0)
    plane = (z * a - xz * b + yz * c) / safe
    return np.where(kept, filled - plane, 0.0), kept


# Up to this grid spacing rocks and small craters are visible, m; a scan covers many of them.
_MAX_FINE_POSTING_M = 1.0
# Number of places that represent the entire map in the mean likelihood of a tile.
_SAMPLE_PLACES = 2048
# Standard deviation of the difference between the mean height of a scan over the cell of a map grid
# point and the map height, apart from the map's noise, m: occlusion by rocks, uneven sampling.
MODEL_SIGMA_M = 0.03
# Maximum width of a terrain feature, m. The half width is limited to 4 to 8 grid points; with a
# large grid spacing the features are undulations, which the swept area must cover.
_WIDTH_M = 50.0
# Probability that the terrain below a tile has changed since the map was made, and fraction of
# disagreeing grid points in a matching tile, from rock shadows and single changes.
CHANGED_PROBABILITY, OUTLIER_FRACTION = 0.2, 0.05
# Correlation length of the agreement of grid points, m: a rock hides the terrain behind it.
CORRELATION_LENGTH_M = 0.7


@dataclass(frozen=True)
class FeatureTile:
    """Patch of scanned terrain that is compared with the map as a unit.

    Heights are given at the spacing of the map grid.

    Attributes
    ----------
    height
        Heights above the local planes (r, c), m.
    weight
        1 for grid points to be compared, else 0 (r, c).
    variance
        Variance of the height residuals (r, c), m^2.
    """

    height: Array
    weight: Array
    variance: Array


@dataclass(frozen=True)
class _HeightDensity:
    """Probability density of heights above the local planes of a map.

    Attributes
    ----------
    height
        Ascending heights (n,), m.
    negative_log
        Negative logarithm of the density at these heights (n,), for a density in 1/m.
    """

    height: Array
    negative_log: Array

    @classmethod
    def of(cls, values: Array, sigma: float) -> _HeightDensity:
        """Estimate the density of heights `values` (n,), m, by a smoothed histogram.

        `sigma` is the standard deviation of the noise of a map height, m. The width of the bins is
        a fifth of it.
        """
        width = 0.2 * sigma
        top = float(np.abs(values).max()) if len(values) else sigma
        top = min(top + 4.0 * sigma, 2000.0 * width)
        edges = np.arange(-top, top + width, width)
        count, _ = np.histogram(np.clip(values, -top, top), edges)
        density = ndimage.gaussian_filter1d(count / (max(len(values), 1) * width), 1.5)
        # Heights that do not occur on the map can still occur in reality.
        density += 1e-3 / (2.0 * top)
        return cls(0.5 * (edges[1:] + edges[:-1]), -np.log(density))

    def negative_log_density(self, height: Array) -> Array:
        """Return the negative logarithm of the density (1/m) at given heights, m."""
        return np.asarray(np.interp(height, self.height, self.negative_log))


class MapFeatures:
    """Prior map prepared for likelihoods of scanned terrain at places on the map.

    A place is a position of a tile (patch of scanned terrain) on the map grid. The likelihood of
    the map heights for a tile at a place is divided by their density over the entire map. Noise
    agrees with flat terrain everywhere, so only terrain features give information. Since features
    occur in clusters, the likelihood of a tile is also divided by its mean over places all over the
    map.

    Parameters
    ----------
    prior
        Prior map.

    Attributes
    ----------
    feature_height, known
        Heights above the planes fitted around each grid point, m, and 1 where they exist, else 0
        (rows, cols).
    reach
        Half width of the squares for the fitted planes, in grid points.
    correlated_count
        Number of grid points whose agreement is correlated; they count as one.
    """

    def __init__(self, prior: PriorMap) -> None:
        self.prior = prior
        posting = prior.grid.posting
        half = 0.5 * _WIDTH_M / posting
        self.reach = 4 if posting <= _MAX_FINE_POSTING_M else int(np.clip(round(half), 4, 8))
        self.correlated_count = max(
            1.0,
            (CORRELATION_LENGTH_M / posting) ** 2,
            prior.equivalent_correlated_posts,
        )
        shown, kept = subtract_plane(prior.elevation, np.isfinite(prior.elevation), self.reach)
        self.feature_height = np.ascontiguousarray(shown, np.float32)
        self.known = np.ascontiguousarray(kept, np.float32)
        self._density = _HeightDensity.of(shown[kept], prior.sigma)
        self._negative_log_density = np.ascontiguousarray(
            self._density.negative_log_density(shown), np.float32
        )
        row, col = np.nonzero(kept)
        some = slice(None, None, max(1, len(row) // _SAMPLE_PLACES))
        self._places = row[some], col[some]

    @property
    def variance(self) -> float:
        """Variance of the height of a scan minus the map at a grid point, m^2.

        It contains the noise of the map and the model error for a scan that covers the cell of the
        grid point evenly.
        """
        return self.prior.sigma**2 + MODEL_SIGMA_M**2

    def log_likelihood_ratios(
        self, tile: FeatureTile, row: IntArray, col: IntArray
    ) -> tuple[Array, Array]:
        """Return log-likelihood ratios and covered fractions of a tile at n places.

        A tile is a patch of scanned terrain. The ratio compares the map heights below the tile,
        given the tile, with their density over the entire map: it is positive where the tile fits
        better than terrain from anywhere. Both results are (n,). `row` and `col` (n,) are those of
        the map grid point below the first grid point of the tile. The covered fraction is that of
        the tile's points with a known map height. Both results are 0 for a tile without points to
        compare.
        """
        total = float(tile.weight.sum())
        if total == 0.0 or len(row) == 0:
            return np.zeros(len(row)), np.zeros(len(row))
        level = np.log((1.0 - OUTLIER_FRACTION) / np.sqrt(2.0 * np.pi * tile.variance))
        height, weight, sharp, density = (
            np.ascontiguousarray(part, np.float32)
            for part in (tile.height, tile.weight, 0.5 / tile.variance, level)
        )
        ratio, covered = k.tile_log_likelihoods(
            self.feature_height,
            self._negative_log_density,
            self.known,
            height,
            weight,
            sharp,
            density,
            np.float32(np.log(OUTLIER_FRACTION)),
            np.ascontiguousarray(row),
            np.ascontiguousarray(col),
        )
        return ratio / self.correlated_count, covered / total

    def mean_log_ratio(self, tile: FeatureTile) -> float | None:
        """Return the log of a tile's likelihood ratio averaged over the entire map.

        A tile is a patch of scanned terrain. The average is over a sample of places with more than
        half of the tile on known heights, scaled to the complete tile; None if there is no such
        place.
        """
        middle = np.array(tile.height.shape) // 2
        ratio, share = self.log_likelihood_ratios(
            tile, self._places[0] - middle[0], self._places[1] - middle[1]
        )
        if not (share > 0.5).any():
            return None
        scaled = ratio[share > 0.5] / share[share > 0.5]
        best = scaled.max()
        return float(best + np.log(np.mean(np.exp(scaled - best))))

    def exact_fit_ratio(self, tile: FeatureTile) -> float:
        """Return the log-likelihood ratio of a tile at a place that it would fit exactly.

        A tile is a patch of scanned terrain. All its height residuals are zero at such a place.
        """
        fits = self._density.negative_log_density(tile.height) - 0.5 * np.log(
            2.0 * np.pi * tile.variance
        )
        return float((tile.weight * fits).sum()) / self.correlated_count

    def log_factor(
        self, ratio: Array, covered_fraction: Array, mean_log_ratio: float, place_count: float
    ) -> Array:
        """Return the log of the factor by which a tile changes the probability of places.

        A tile is a patch of scanned terrain; the result is (n,). Unknown parts of the map give no
        information. The probability of changed terrain limits how much a tile can lower the
        probability of a place. The factor that raises it is limited to the number of places.

        Parameters
        ----------
        ratio, covered_fraction
            Log-likelihood ratios and covered fractions (n,), from `log_likelihood_ratios`.
        mean_log_ratio
            Logarithm of the mean likelihood ratio, from `mean_log_ratio`.
        place_count
            Number of possible places.
        """
        changed = CHANGED_PROBABILITY
        top = max(mean_log_ratio, float(ratio.max(initial=-np.inf)) - float(np.log(place_count)))
        return np.asarray(
            np.logaddexp(ratio - covered_fraction * top + np.log1p(-changed), np.log(changed))
        )


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
        """Whether the expected log-likelihood ratio is at least the needed one."""
        return self.expected >= self.needed

    def __str__(self) -> str:
        word = "can lock" if self.can_lock else "cannot lock"
        east, north = self.rival
        return (
            f"{word}: log-likelihood ratio of the right place to the most probable wrong one "
            f"({east:+.0f} m east, {north:+.0f} m north): {self.expected:.0f} expected, "
            f"{self.needed:.0f} needed"
        )


def lock_forecast(briefing: Briefing) -> LockForecast | None:
    """Forecast whether LiDAR scans will match the prior map at one place only.

    `briefing` has the data known before flight. Return None if navigation uses no prior map.
    """
    software = briefing.software
    if briefing.prior_map is None or not software.navigation.uses_prior_map:
        return None
    sizes = [float(getattr(part, "size", 0.0)) for part in software.tasking.values()]
    swept = max(sizes, default=0.0) or _DEFAULT_SWEEP_M
    east, north = (float(v) for v in briefing.target[:2])
    sigma = max(briefing.start.position_sigma, briefing.prior_map.grid.posting)
    return forecast_lock(briefing.prior_map, (east, north), swept, sigma)


def forecast_lock(
    prior: PriorMap,
    centre: tuple[float, float],
    side: float,
    place_sigma: float,
    *,
    certainty: float = 0.99999,
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
    """
    from scipy.signal import fftconvolve  # noqa: PLC0415  (takes half a second)

    _check_arguments(side, place_sigma, certainty)
    features = MapFeatures(prior)
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
    expected = (1.0 - CHANGED_PROBABILITY) * log_ratio
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
