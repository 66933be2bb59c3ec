"""Locate scanned terrain on a prior map by a posterior over horizontal shifts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtr

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.map_features import FeatureTile, MapFeatures, subtract_plane
from lunarsim.onboard.navigation.submap import Submap
from lunarsim.typing import Array, BoolArray, IntArray
from lunarsim.value_checks import check_finite, check_shape, check_time

# Places with a log probability this far below the maximum are not evaluated further.
_MAX_LOG_DEFICIT = 14.0
# Number of places for the estimate of the height.
_HEIGHT_SAMPLE_PLACES = 2048
# Standard deviations of the prior within which places are searched.
_SEARCH_SIGMAS = 3.5
# Maximum number of places with half the grid spacing of the map (with more places, the full spacing
# is used); maximum per side.
_MAX_HALF_POST_PLACES, _MAX_PLACES_PER_SIDE = 250_000, 2000
# Minimum log-likelihood ratio of a tile at an exact fit, in a search with many places.
_MIN_TILE_INFORMATION = 5.0
# Side of a tile (patch of scanned terrain), m; limited to 4 to 16 grid points of the map.
_TILE_M = 8.0
# Time without new grid points after which an incomplete tile is compared, and correlation time of
# the velocity error that lets the shift drift, s.
_IDLE_S, _DRIFT_CORRELATION_S = 1.0, 4.0


@dataclass(frozen=True)
class MapMatch:
    """Estimated place of the scanned terrain on the map, with its uncertainty.

    Attributes
    ----------
    shift
        Shift from local to map coordinates (3,), ENU, m.
    covariance
        Covariance of the shift (3, 3), m^2.
    certainty
        Probability that the true shift lies within 1.5 times the grid spacing of the map.
    agreeing_fraction
        Fraction of the grid points that agree at this place.
    vertical_shift, vertical_shift_variance
        Mean and variance of the vertical shift over all places, weighted by their probability, m
        and m^2. On horizontal terrain the height is known before the place.
    """

    shift: Array
    covariance: Array
    certainty: float
    agreeing_fraction: float
    vertical_shift: float
    vertical_shift_variance: float


@dataclass(frozen=True)
class _SampledTile:
    """Tile of scanned terrain, sampled at every half grid spacing of the map.

    Attributes
    ----------
    first
        Row and column of the first sample, counted in half grid spacings from the first grid point
        of the map.
    samples
        Heights above the local planes, weights and variances at every half grid spacing (r, c).
    terrain_height
        Terrain heights, without a plane subtracted (r, c), m.
    """

    first: tuple[int, int]
    samples: FeatureTile
    terrain_height: Array

    def every_second(self, a: int, b: int) -> FeatureTile:
        """Return every second sample of the tile, starting at row `a` and column `b`."""
        cut = (slice(a, None, 2), slice(b, None, 2))
        return FeatureTile(
            self.samples.height[cut], self.samples.weight[cut], self.samples.variance[cut]
        )


class PlaceSearch:
    """Bayesian search for the horizontal shift of scanned terrain on a prior map.

    The scanned terrain is accumulated in the local frame (`Submap`) and compared tile by tile. The
    likelihood of a tile at a place, relative to its mean over all places, multiplies the posterior;
    flat terrain fits nearly everywhere and gives no information. Each grid point is compared once,
    since its error is the same in every view. A tile that does not fit lowers the probability of a
    place by no more than a factor of `CHANGED_PROBABILITY`. Between searches the
    posterior is blurred by the drift of the local frame.

    Parameters
    ----------
    features
        Features of the map.
    """

    def __init__(self, features: MapFeatures) -> None:
        self.features = features
        self.prior = features.prior
        self._wide = int(np.clip(round(_TILE_M / self.prior.grid.posting), 4, 16))
        self.restart()

    def restart(self) -> None:
        """Delete all scanned terrain and the posterior."""
        g = self.prior.grid
        corner = (g.x0 - 0.5 * g.posting, g.y0 - 0.5 * g.posting)
        self._submap = Submap(*corner, 0.5 * g.posting)
        self._tiles: list[_SampledTile] = []
        self._used: set[tuple[int, int]] = set()
        self._growing: dict[tuple[int, int], tuple[int, float]] = {}
        self._offsets, self._unit = 2, 0.5 * g.posting
        self._origin = (0, 0)
        self._log = np.zeros((0, 0))
        self._time: float | None = None

    @property
    def log_likelihood(self) -> tuple[Array, tuple[int, int]]:
        """Log-likelihood of every place (rows, cols), and the shift of the first place.

        The prior of the position is not included. The shift is (north, east) in units of `spacing`.
        """
        return self._log, self._origin

    @property
    def spacing(self) -> float:
        """Distance between neighbouring places, m.

        The distance is half the grid spacing of the map, or the full spacing if there are many
        places.
        """
        return self._unit

    def add(self, points: Array) -> None:
        """Add the points of a scan to the scanned terrain that is searched for on the map.

        The points are (n, 3), local frame, m; NaN marks missing points.
        """
        self._submap.add(points)

    # --- search ---------------------------------------------------------------------------

    def search(
        self, time: float, mean: Array, covariance: Array, speed_sigma: float = 0.0
    ) -> MapMatch | None:
        """Compare new tiles with the map, and return the most probable place by all tiles.

        Parameters
        ----------
        time
            Time of the search, s.
        mean, covariance
            Prior mean (2,) and covariance (2, 2) of the shift, east and north, m and m^2.
        speed_sigma
            Standard deviation of the drift velocity of the local frame, per axis, m/s.

        Returns
        -------
        match
            Most probable place; None before the first comparison.

        Raises
        ------
        InputError
            If time runs backwards, or an argument is not finite or out of range.
        """
        _check_prior(mean, covariance, speed_sigma)
        check_time("time", time, -np.inf if self._time is None else self._time)
        self._extend_places(mean, covariance)
        self._blur(time, speed_sigma)
        prior_distance = self._prior_distance(mean, covariance)
        complete = self._complete_tiles(time)
        mean_log_ratios = [
            self.features.mean_log_ratio(tile.every_second(0, 0)) for tile in complete
        ]
        information = [
            0.0 if mean is None else self.features.exact_fit_ratio(tile.every_second(0, 0)) - mean
            for tile, mean in zip(complete, mean_log_ratios, strict=True)
        ]
        least = _MIN_TILE_INFORMATION * min(1.0, self._log.size / _MAX_HALF_POST_PLACES)
        # Tiles in order of decreasing information: the others need fewer places then.
        for n in np.argsort(np.negative(information), kind="stable"):
            if mean_log_ratios[n] is not None and information[n] >= least:
                self._apply_tile(complete[n], prior_distance, mean_log_ratios[n])
        self._tiles += complete
        return self._best_match(prior_distance, mean, covariance) if self._tiles else None

    def _extend_places(self, mean: Array, covariance: Array) -> None:
        """Extend the array of places so that it covers the prior of the shift.

        `mean` (2,), m, and `covariance` (2, 2), m^2, are the prior of the shift. New places start
        with a log-likelihood of 0.
        """
        posting = self.prior.grid.posting
        far = _SEARCH_SIGMAS * np.sqrt(np.diag(covariance)) + 2.0 * posting
        if not self._log.size:
            self._offsets = 2 if np.prod(4.0 * far / posting) <= _MAX_HALF_POST_PLACES else 1
            self._unit = posting / self._offsets
        far = np.minimum(far, 0.5 * _MAX_PLACES_PER_SIDE * self._unit)
        low = np.floor((np.asarray(mean) - far) / self._unit).astype(int)[::-1]
        high = np.ceil((np.asarray(mean) + far) / self._unit).astype(int)[::-1]
        if self._log.size:
            low = np.minimum(low, self._origin)
            high = np.maximum(high, np.add(self._origin, self._log.shape) - 1)
        shape = tuple(high - low + 1)
        if shape != self._log.shape:
            grown = np.zeros(shape)
            if self._log.size:
                at = np.subtract(self._origin, low)
                grown[at[0] : at[0] + self._log.shape[0], at[1] : at[1] + self._log.shape[1]] = (
                    self._log
                )
            self._log, self._origin = grown, (int(low[0]), int(low[1]))

    def _blur(self, time: float, speed_sigma: float) -> None:
        """Blur the log-likelihoods of the places by the drift since the last search.

        `time` is in s; `speed_sigma` is the standard deviation of the drift velocity, m/s.
        """
        before, self._time = self._time, time
        if before is None or time <= before or not self._tiles:
            return
        sigma = speed_sigma * np.sqrt((time - before) * _DRIFT_CORRELATION_S) / self._unit
        if sigma > 0.0:
            best = self._log.max()
            p = ndimage.gaussian_filter(np.exp(self._log - best), sigma, mode="nearest")
            self._log = best + np.log(np.maximum(p, 1e-300))

    def _prior_distance(self, mean: Array, covariance: Array) -> Array:
        """Return half the squared Mahalanobis distance of every place from the prior mean.

        `mean` (2,), m, and `covariance` (2, 2), m^2, are the prior of the shift; the result is
        (rows, cols).
        """
        rows, cols = self._log.shape
        y = self._unit * (self._origin[0] + np.arange(rows))[:, None] - mean[1]
        x = self._unit * (self._origin[1] + np.arange(cols))[None, :] - mean[0]
        inverse = np.linalg.inv(covariance)
        return np.asarray(
            0.5 * (inverse[0, 0] * x**2 + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y**2)
        )

    # --- scanned terrain ------------------------------------------------------------------

    def _complete_tiles(self, time: float) -> list[_SampledTile]:
        """Return the tiles that became complete or stopped growing since the last call.

        A tile is complete with 95 % of its grid points; with 25 % it counts after 1 s without new
        ones. Each tile is returned once. `time` is the current time, s.
        """
        height, known = self._submap.block_means()
        if not known.any():
            return []
        first = self._submap.first
        # Count only samples at full grid spacing, the first of the four offsets of half a spacing.
        skip = (first[0] % 2, first[1] % 2)
        kept = subtract_plane(
            height[skip[0] :: 2, skip[1] :: 2], known[skip[0] :: 2, skip[1] :: 2],
            self.features.reach,
        )[1]  # fmt: skip
        row, col = np.nonzero(kept)
        row += (first[0] + skip[0]) // 2
        col += (first[1] + skip[1]) // 2
        place, count = np.unique(
            np.column_stack((row // self._wide, col // self._wide)), axis=0, return_counts=True
        )
        complete = []
        full = self._wide**2
        for key, n in zip(map(tuple, place.tolist()), count.tolist(), strict=True):
            if key in self._used:
                continue
            seen, since = self._growing.get(key, (0, time))
            if n > seen:
                self._growing[key] = (n, time)
                since = time
            old = time - since >= _IDLE_S - 1e-9
            if n >= 0.95 * full or (old and n >= 0.25 * full):
                self._used.add(key)
                complete.append(key)
        return [self._cut_tile(key, height, known) for key in complete]

    def _cut_tile(
        self, tile_index: tuple[int, int], height: Array, known: BoolArray
    ) -> _SampledTile:
        """Cut a tile, sampled at every half grid spacing, out of the scanned terrain.

        `tile_index` is the row and column of the tile, counted in tiles; `height`, m, and `known`
        (rows, cols) are the result of `Submap.block_means`.
        """
        # Margin of half a grid spacing for the four offsets, and of two spacings for slopes.
        side, margin = 2 * self._wide, 2 * self.features.reach + 2
        south, west = (side * tile_index[i] - margin - self._submap.first[i] for i in (0, 1))
        many = side + 2 * margin
        z, seen = _cut_square(height, south, west, many), _cut_square(known, south, west, many)
        above, kept = np.zeros(z.shape), np.zeros(z.shape, np.bool_)
        for a in (0, 1):
            for b in (0, 1):
                above[a::2, b::2], kept[a::2, b::2] = subtract_plane(
                    z[a::2, b::2], seen[a::2, b::2], self.features.reach
                )
        # The true place can differ from a sampled one by half the spacing.
        spread = np.zeros(z.shape)
        for axis in (0, 1):
            rise = np.gradient(above, axis=axis)
            near = ndimage.minimum_filter1d(kept, 3, axis=axis)
            spread += (2.0 / self._offsets * np.where(near, rise, 0.0)) ** 2 / 12.0
        inner = (slice(margin, margin + side),) * 2
        weight, variance = kept.astype(np.float64), self.features.variance + spread
        samples = FeatureTile(above[inner], weight[inner], variance[inner])
        return _SampledTile((side * tile_index[0], side * tile_index[1]), samples, z[inner])

    # --- evidence -------------------------------------------------------------------------

    def _apply_tile(self, tile: _SampledTile, prior_distance: Array, mean_log_ratio: float) -> None:
        """Multiply the posterior of the places by the likelihood of a tile.

        Places that are far less probable than the best one stay unchanged. `prior_distance` (rows,
        cols) is half the squared Mahalanobis distance of each place from the prior mean.
        `mean_log_ratio` is the logarithm of the mean likelihood ratio of the tile over the map.
        """
        log = self._log - prior_distance
        row, col = np.nonzero(log >= log.max() - _MAX_LOG_DEFICIT)
        ratio, covered_fraction = np.zeros(len(row)), np.zeros(len(row))
        north, east, offset_count = row + self._origin[0], col + self._origin[1], self._offsets
        for a in range(offset_count):
            for b in range(offset_count):
                # Shifts by an odd number of half spacings use samples offset by half a spacing.
                selected = np.flatnonzero(
                    ((north + a) % offset_count == 0) & ((east + b) % offset_count == 0)
                )
                ratio[selected], covered_fraction[selected] = self.features.log_likelihood_ratios(
                    tile.every_second(a, b),
                    (north[selected] + a) // offset_count + tile.first[0] // 2,
                    (east[selected] + b) // offset_count + tile.first[1] // 2,
                )
        self._log[row, col] += self.features.log_factor(
            ratio, covered_fraction, mean_log_ratio, log.size
        )

    # --- outcome --------------------------------------------------------------------------

    def _best_match(self, prior_distance: Array, mean: Array, covariance: Array) -> MapMatch:
        """Normalise the posterior and return the most probable place.

        The normalisation includes the prior probability of places beyond those searched. `mean`
        (2,), m, and `covariance` (2, 2), m^2, are the prior of the shift.
        """
        log = self._log - prior_distance
        best = log.max()
        p = np.exp(log - best)
        every = 2.0 * np.pi * np.sqrt(np.linalg.det(covariance)) / self._unit**2
        with np.errstate(divide="ignore"):
            beyond = float(np.log(every * self._prior_beyond(mean, covariance)) - best)
        p /= p.sum() + np.exp(min(beyond, 700.0))
        row, col = np.unravel_index(int(np.argmax(p)), p.shape)
        rows, cols = np.indices(p.shape)
        near = np.hypot(rows - row, cols - col) <= 1.5 * self._offsets + 1e-9
        certainty = float(p[near].sum())
        q = p[near] / certainty
        north = self._unit * (rows[near] + self._origin[0])
        east = self._unit * (cols[near] + self._origin[1])
        middle = np.array([q @ east, q @ north])
        # Add half a grid spacing to the spread for the finite resolution.
        spread = np.array([q @ (east - middle[0]) ** 2, q @ (north - middle[1]) ** 2])
        spread += (0.5 * self.prior.grid.posting) ** 2
        share, rise, error = self._agreement(int(row), int(col))
        up, up_variance = self._vertical_shift(p)
        return MapMatch(
            np.array([*middle, up if rise is None else rise]),
            np.diag([*spread, error]), certainty, share, up, up_variance,
        )  # fmt: skip

    def _prior_beyond(self, mean: Array, covariance: Array) -> float:
        """Return an upper bound of the prior probability outside the searched places.

        The bound is the sum of the tails beyond each side. One minus the sum over the searched
        places would be inaccurate for a prior narrower than their spacing. `mean` (2,), m, and
        `covariance` (2, 2), m^2, are the prior of the shift.
        """
        sigma = np.sqrt(np.diag(covariance))
        low = self._unit * (np.array(self._origin[::-1]) - 0.5)
        high = low + self._unit * np.array(self._log.shape[::-1])
        past = ndtr((low - mean) / sigma) + ndtr((mean - high) / sigma)
        return min(float(past.sum()), 1.0)

    def _map_points_below(
        self, tile: _SampledTile, row: IntArray, col: IntArray
    ) -> tuple[tuple[slice, slice], IntArray, IntArray]:
        """Return the map grid points that lie below a tile at n given places.

        `row` and `col` (n,) are the places, as indices into the array of places. The results are
        the slices of the tile's samples that lie on grid points, and the rows (n, r) and columns
        (n, c) of these points. All places must lie at the same offset from the grid points of the
        map, in half grid spacings.
        """
        north, east = row + self._origin[0], col + self._origin[1]
        ways = self._offsets
        a, b = int(-north[0] % ways), int(-east[0] % ways)
        n = np.arange(self._wide)
        r = ((north + a) // ways + tile.first[0] // 2)[:, None] + n
        c = ((east + b) // ways + tile.first[1] // 2)[:, None] + n
        return (slice(a, None, 2), slice(b, None, 2)), r, c

    def _agreement(self, row: int, col: int) -> tuple[float, float | None, float]:
        """Return fraction of agreeing points, height difference and its variance.

        They refer to the place with the indices `row`, `col`. The height difference is the median
        of map minus scan, m, over the agreeing points of the last six tiles; None without agreeing
        points. The fraction is that of all compared points.
        """
        agreed, compared, rises = 0, 0, []
        for n, tile in enumerate(reversed(self._tiles)):
            cut, r, c = self._map_points_below(tile, np.array([row]), np.array([col]))
            shown, elevation = (
                _values_at(of, r[0], c[0])
                for of in (self.features.feature_height, self.prior.elevation)
            )
            both = (tile.samples.weight[cut] > 0.0) & (
                _values_at(self.features.known, r[0], c[0]) > 0.0
            )
            gap = shown - tile.samples.height[cut]
            agree = both & (gap**2 <= 9.0 * tile.samples.variance[cut])
            agreed, compared = agreed + int(agree.sum()), compared + int(both.sum())
            if n < 6:
                rises.append((elevation - tile.terrain_height[cut])[agree])
        rise = np.concatenate(rises)
        posting, sigma = self.prior.grid.posting, self.prior.sigma
        error = (
            sigma**2 * self.prior.equivalent_correlated_posts / max(len(rise), 1)
            + (0.4 * posting) ** 2
        )
        found = float(np.median(rise)) if len(rise) else None
        return agreed / compared if compared else 0.0, found, float(error)

    def _vertical_shift(self, p: Array) -> tuple[float, float]:
        """Return mean and variance of the vertical shift over all places, m and m^2.

        `p` (rows, cols) is the probability of each place. The shift is map minus scan for the
        latest tile. If the map is unknown there, the results are 0 and infinite.
        """
        # Use only the places at one of the four offsets, and thin them for speed.
        every = self._offsets * max(
            1, int(np.sqrt(p.size / self._offsets**2 / _HEIGHT_SAMPLE_PLACES))
        )
        best = np.unravel_index(int(np.argmax(p)), p.shape)
        row, col = (np.arange(int(b) % every, n, every) for b, n in zip(best, p.shape, strict=True))
        block = (every, every)
        mass = ndimage.uniform_filter(p, block, mode="constant")[np.ix_(row, col)].ravel()
        row, col = (part.ravel() for part in np.meshgrid(row, col, indexing="ij"))
        keep = mass > 1e-6 * mass.max()
        row, col, mass = row[keep], col[keep], mass[keep]
        tile = self._tiles[-1]
        cut, r, c = self._map_points_below(tile, row, col)
        ours = tile.samples.weight[cut] > 0.0
        i, j = np.nonzero(ours)
        some = slice(None, None, max(1, len(i) // 32))
        i, j = i[some], j[some]
        rise = (
            _values_at(self.prior.elevation, r[:, i], c[:, j], paired=True)
            - tile.terrain_height[cut][i, j]
        )
        known = np.isfinite(rise)
        count = known.sum(axis=1)
        mean = np.where(known, rise, 0.0).sum(axis=1) / np.maximum(count, 1)
        weight = np.where(count > 0, mass, 0.0)
        if weight.sum() == 0.0:
            return 0.0, np.inf
        weight /= weight.sum()
        up = float(weight @ mean)
        return up, float(weight @ (mean - up) ** 2)


def _check_prior(mean: Array, covariance: Array, speed_sigma: float) -> None:
    """Raise an `InputError` if an argument of `PlaceSearch.search` is invalid."""
    check_shape("mean", mean, (2,))
    check_finite("mean", mean)
    p = np.asarray(covariance, dtype=np.float64)
    fits = p.shape == (2, 2) and np.isfinite(p).all() and np.allclose(p, p.T, rtol=1e-6)
    if not (fits and p[0, 0] > 0.0 and np.linalg.det(p) > 0.0):
        raise InputError(
            "covariance", covariance, "must be a symmetric positive definite matrix (2, 2)"
        )
    if not 0.0 <= speed_sigma < np.inf:
        raise InputError("speed_sigma", speed_sigma, "must be 0 or more, and finite")


def _cut_square(raster: NDArray[Any], row: int, col: int, side: int) -> NDArray[Any]:
    """Cut a square of `side` cells out of a raster; 0 outside the raster.

    `row` and `col` are the first row and column of the square; they can lie outside the raster.
    """
    out = np.zeros((side, side), raster.dtype)
    r0, r1 = max(row, 0), min(row + side, raster.shape[0])
    c0, c1 = max(col, 0), min(col + side, raster.shape[1])
    if r0 < r1 and c0 < c1:
        out[r0 - row : r1 - row, c0 - col : c1 - col] = raster[r0:r1, c0:c1]
    return out


def _values_at(
    raster: NDArray[Any], row: IntArray, col: IntArray, *, paired: bool = False
) -> Array:
    """Return the values of a raster at given rows and columns; NaN outside.

    The result is (r, c) for rows (r,) and columns (c,). With `paired`, rows and columns have the
    same shape, each pair is one grid point, and the result has this shape.
    """
    if not paired:
        row, col = np.broadcast_arrays(row[:, None], col[None, :])
    inside = (row >= 0) & (row < raster.shape[0]) & (col >= 0) & (col < raster.shape[1])
    out = np.full(row.shape, np.nan)
    out[inside] = raster[row[inside], col[inside]]
    return out
