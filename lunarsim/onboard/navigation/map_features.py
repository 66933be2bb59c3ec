"""Features of a prior map, and the likelihood of scanned terrain at a place on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation import _place_kernels as k
from lunarsim.onboard.navigation.features import subtract_plane
from lunarsim.typing import Array, IntArray

# Up to this grid spacing rocks and small craters are visible, m; a scan covers many of them.
_MAX_FINE_POSTING_M = 1.0
# Number of places that represent the entire map in the mean likelihood of a tile.
_SAMPLE_PLACES = 2048


@dataclass(frozen=True)
class FeatureSettings:
    """Parameters of the likelihood comparison between scanned terrain and a map.

    Attributes
    ----------
    width
        Maximum width of a terrain feature, m. The half width is limited to 4 to 8 grid points; with
        a large grid spacing the features are undulations, which the swept area must cover.
    changed_probability
        Probability that the terrain below a tile has changed since the map was made.
    outlier
        Fraction of disagreeing grid points in a matching tile, from rock shadows and single
        changes.
    model_sigma
        Standard deviation of the difference between the mean height of a scan over the cell of a
        map grid point and the map height, apart from the map's noise, m.
    correlation_length
        Correlation length of the agreement of grid points, m: a rock hides the terrain behind it.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    width: float = 50.0
    changed_probability: float = 0.2
    outlier: float = 0.05
    model_sigma: float = 0.03
    correlation_length: float = 0.7

    def __post_init__(self) -> None:
        for name in ("changed_probability", "outlier"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(
                    f"features.{name}", getattr(self, name), "must be more than 0 and less than 1"
                )
        for name in ("width", "model_sigma", "correlation_length"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(
                    f"features.{name}", getattr(self, name), "must be positive and finite"
                )


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
    settings
        Parameters of the comparison.

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

    def __init__(self, prior: PriorMap, settings: FeatureSettings | None = None) -> None:
        self.prior = prior
        self.settings = settings or FeatureSettings()
        posting = prior.grid.posting
        half = 0.5 * self.settings.width / posting
        self.reach = 4 if posting <= _MAX_FINE_POSTING_M else int(np.clip(round(half), 4, 8))
        self.correlated_count = max(
            1.0,
            (self.settings.correlation_length / posting) ** 2,
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
        """Variance of the height residual at a grid point that is evenly scanned, m^2."""
        return self.prior.sigma**2 + self.settings.model_sigma**2

    def likelihood(self, tile: FeatureTile, row: IntArray, col: IntArray) -> tuple[Array, Array]:
        """Return log-likelihood ratios and covered fractions of a tile at places.

        A tile is a patch of scanned terrain. Both results are (n,). `row` and `col` (n,) are those
        of the map grid point below the first grid point of the tile. The covered fraction is that
        of the tile's points with a known map height.
        """
        total = float(tile.weight.sum())
        if total == 0.0 or len(row) == 0:
            return np.zeros(len(row)), np.zeros(len(row))
        s = self.settings
        level = np.log((1.0 - s.outlier) / np.sqrt(2.0 * np.pi * tile.variance))
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
            np.float32(np.log(s.outlier)),
            np.ascontiguousarray(row),
            np.ascontiguousarray(col),
        )
        return ratio / self.correlated_count, covered / total

    def mean_log_ratio(self, tile: FeatureTile) -> float | None:
        """Return the log of a tile's likelihood ratio averaged over the entire map.

        A tile is a patch of scanned terrain. The result is None if no place covers more than half
        of the tile.
        """
        middle = np.array(tile.height.shape) // 2
        ratio, share = self.likelihood(
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
            Log-likelihood ratios and covered fractions (n,), from `likelihood`.
        mean_log_ratio
            Logarithm of the mean likelihood ratio, from `mean_log_ratio`.
        place_count
            Number of possible places.
        """
        changed = self.settings.changed_probability
        top = max(mean_log_ratio, float(ratio.max(initial=-np.inf)) - float(np.log(place_count)))
        return np.asarray(
            np.logaddexp(ratio - covered_fraction * top + np.log1p(-changed), np.log(changed))
        )
