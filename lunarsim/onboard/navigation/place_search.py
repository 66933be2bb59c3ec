"""Where on a map the scanned ground lies, from tens of metres off: a posterior over all places."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ndtr

from lunarsim.errors import InputError
from lunarsim.onboard.navigation.features import above_plane
from lunarsim.onboard.navigation.map_features import MapFeatures, Tile
from lunarsim.onboard.navigation.submap import Submap

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Places whose logarithm of the probability lies so far below the best's are not compared further.
_HOPELESS = 14.0
# Places that the height is told by.
_SAMPLE = 2048
# Deviations of the prior within which places are looked at.
_DEVIATIONS = 3.5
# Up to so many places are told apart by half posts, more by whole ones; and at most so many a side.
_BY_HALVES, _WIDEST = 250_000, 2000
# Where there are so many places, what tells less even if it fits exactly is not compared.
_LEAST_TOLD = 5.0


@dataclass(frozen=True)
class SearchSettings:
    """How tiles are cut out of what was scanned, and what drifts.

    Attributes
    ----------
    tile
        Side of the tiles that are compared as one, m; 4 to 16 posts.
    deaf_s
        A tile that grows no more for so long is compared as it is, s.
    held_s
        A speed that is wrong stays so for so long, s: what places drift by.

    Raises
    ------
    InputError
        If one is not positive.
    """

    tile: float = 8.0
    deaf_s: float = 1.0
    held_s: float = 4.0

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not 0.0 < value < np.inf:
                raise InputError(f"search.{f.name}", value, "a positive number")


@dataclass(frozen=True)
class Match:
    """Where the scanned ground lies on the map.

    Attributes
    ----------
    shift
        To be added to local coordinates (3,), ENU, m.
    covariance
        Of the shift (3, 3), m^2.
    certainty
        Probability that it lies within one and a half posts of there.
    share
        Of the posts that agree there.
    up, up_variance
        Mean and variance of the vertical shift over all places, by their probability, m and m^2: on
        level ground the height is known before the place.
    """

    shift: Array
    covariance: Array
    certainty: float
    share: float
    up: float
    up_variance: float


@dataclass(frozen=True)
class _Tile:
    """A tile at every half post.

    Attributes
    ----------
    first
        Row and column of the first post, in halves of a post from the map's first.
    whole
        Heights, weights and variances at every half post (r, c).
    level
        Of the ground itself (r, c), m.
    """

    first: tuple[int, int]
    whole: Tile
    level: Array

    def lay(self, a: int, b: int) -> Tile:
        """Return every other post, from the first or from half a post farther north and east."""
        cut = (slice(a, None, 2), slice(b, None, 2))
        return Tile(self.whole.height[cut], self.whole.weight[cut], self.whole.variance[cut])


class PlaceSearch:
    """Posterior over shifts from the local frame to a map, kept over a flight.

    The ground scanned is gathered in the local frame (`Submap`) and compared tile by tile. A tile's
    likelihood at a place, relative to what it is at all places on average, multiplies the
    posterior: level ground fits nearly anywhere and tells nothing. A post is compared once: seen
    again it would only tell its own error again. Where the map may have changed a tile that fails
    speaks against a place no more than `changed` allows. Between searches the posterior is blurred
    by the drift of the local frame.

    Parameters
    ----------
    features
        The map's.
    settings
        How tiles are cut, and what drifts.
    """

    def __init__(self, features: MapFeatures, settings: SearchSettings | None = None) -> None:
        self.features = features
        self.prior = features.prior
        self.settings = settings or SearchSettings()
        self._wide = int(np.clip(round(self.settings.tile / self.prior.grid.posting), 4, 16))
        self.restart()

    def restart(self) -> None:
        """Forget all that was scanned."""
        g = self.prior.grid
        corner = (g.x0 - 0.5 * g.posting, g.y0 - 0.5 * g.posting)
        self._submap = Submap(*corner, 0.5 * g.posting)
        self._tiles: list[_Tile] = []
        self._used: set[tuple[int, int]] = set()
        self._fresh: dict[tuple[int, int], tuple[int, float]] = {}
        self._ways, self._unit = 2, 0.5 * g.posting
        self._origin = (0, 0)
        self._log = np.zeros((0, 0))
        self._time: float | None = None

    @property
    def evidence(self) -> tuple[Array, tuple[int, int]]:
        """Logarithm of the evidence at every place (rows, cols), and the shift of its first.

        Shifts north and east, in whole or half posts: see `spacing`.
        """
        return self._log, self._origin

    @property
    def spacing(self) -> float:
        """Distance of the places, m: half a post, or a whole one where there are many."""
        return self._unit

    def add(self, points: Array) -> None:
        """Take in a scan's points in the local frame (n, 3), m; NaN for none."""
        self._submap.add(points)

    # --- search ---------------------------------------------------------------------------

    def search(
        self, time: float, mean: Array, covariance: Array, speed_sigma: float = 0.0
    ) -> Match | None:
        """Compare what is new, and return the place by all that was compared so far.

        Parameters
        ----------
        time
            s.
        mean, covariance
            Of the shift as the rest of navigation knows it (2,), (2, 2), east and north, m and m^2.
        speed_sigma
            Deviation of the speed at which the local frame drifts, an axis, m/s.

        Returns
        -------
        match
            None before anything was compared.

        Raises
        ------
        InputError
            If time runs backwards, or what is known is no number, covariance or deviation.
        """
        _check_known(mean, covariance, speed_sigma)
        if not (np.isfinite(time) and (self._time is None or time >= self._time)):
            raise InputError("time", time, f"at least {self._time} s: time does not run backwards")
        self._cover(mean, covariance)
        self._blur(time, speed_sigma)
        away = self._away(mean, covariance)
        due = self._due(time)
        usual = [self.features.usual(tile.lay(0, 0)) for tile in due]
        told = [
            0.0 if mean is None else self.features.exact(tile.lay(0, 0)) - mean
            for tile, mean in zip(due, usual, strict=True)
        ]
        least = _LEAST_TOLD * min(1.0, self._log.size / _BY_HALVES)
        # What tells most comes first: the rest need be compared at fewer places.
        for n in np.argsort(np.negative(told), kind="stable"):
            if usual[n] is not None and told[n] >= least:
                self._compare(due[n], away, usual[n])
        self._tiles += due
        return self._match(away, mean, covariance) if self._tiles else None

    def _cover(self, mean: Array, covariance: Array) -> None:
        """Make the posterior reach as far as the prior does; what is new has told nothing yet."""
        posting = self.prior.grid.posting
        far = _DEVIATIONS * np.sqrt(np.diag(covariance)) + 2.0 * posting
        if not self._log.size:
            self._ways = 2 if np.prod(4.0 * far / posting) <= _BY_HALVES else 1
            self._unit = posting / self._ways
        far = np.minimum(far, 0.5 * _WIDEST * self._unit)
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
        """Let places drift since the last search."""
        before, self._time = self._time, time
        if before is None or time <= before or not self._tiles:
            return
        sigma = speed_sigma * np.sqrt((time - before) * self.settings.held_s) / self._unit
        if sigma > 0.0:
            best = self._log.max()
            p = ndimage.gaussian_filter(np.exp(self._log - best), sigma, mode="nearest")
            self._log = best + np.log(np.maximum(p, 1e-300))

    def _away(self, mean: Array, covariance: Array) -> Array:
        """Return half the squared distance of every place from the mean, in units of the prior."""
        rows, cols = self._log.shape
        y = self._unit * (self._origin[0] + np.arange(rows))[:, None] - mean[1]
        x = self._unit * (self._origin[1] + np.arange(cols))[None, :] - mean[0]
        inverse = np.linalg.inv(covariance)
        return np.asarray(
            0.5 * (inverse[0, 0] * x**2 + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y**2)
        )

    # --- what was scanned -----------------------------------------------------------------

    def _due(self, time: float) -> list[_Tile]:
        """Return the tiles that are whole by now, or grow no more."""
        height, known = self._submap.posts()
        if not known.any():
            return []
        first = self._submap.first
        # Whole posts only are counted: the first of the four ways to lay posts over the squares.
        skip = (first[0] % 2, first[1] % 2)
        whole = above_plane(
            height[skip[0] :: 2, skip[1] :: 2], known[skip[0] :: 2, skip[1] :: 2],
            self.features.reach,
        )[1]  # fmt: skip
        row, col = np.nonzero(whole)
        row += (first[0] + skip[0]) // 2
        col += (first[1] + skip[1]) // 2
        place, count = np.unique(
            np.column_stack((row // self._wide, col // self._wide)), axis=0, return_counts=True
        )
        due = []
        full = self._wide**2
        for key, n in zip(map(tuple, place.tolist()), count.tolist(), strict=True):
            if key in self._used:
                continue
            seen, since = self._fresh.get(key, (0, time))
            if n > seen:
                self._fresh[key] = (n, time)
                since = time
            old = time - since >= self.settings.deaf_s - 1e-9
            if n >= 0.95 * full or (old and n >= 0.25 * full):
                self._used.add(key)
                due.append(key)
        return [self._cut(key, height, known) for key in due]

    def _cut(self, key: tuple[int, int], height: Array, known: NDArray[np.bool_]) -> _Tile:
        """Return a tile at every half post, out of what was scanned."""
        # A half post more on either side, for the four ways to lay posts, and two for slopes.
        side, room = 2 * self._wide, 2 * self.features.reach + 2
        south, west = (side * key[i] - room - self._submap.first[i] for i in (0, 1))
        many = side + 2 * room
        z, seen = _cut(height, south, west, many), _cut(known, south, west, many)
        above, kept = np.zeros(z.shape), np.zeros(z.shape, np.bool_)
        for a in (0, 1):
            for b in (0, 1):
                above[a::2, b::2], kept[a::2, b::2] = above_plane(
                    z[a::2, b::2], seen[a::2, b::2], self.features.reach
                )
        # A place lies up to half a spacing beside the truth.
        spread = np.zeros(z.shape)
        for axis in (0, 1):
            rise = np.gradient(above, axis=axis)
            near = ndimage.minimum_filter1d(kept, 3, axis=axis)
            spread += (2.0 / self._ways * np.where(near, rise, 0.0)) ** 2 / 12.0
        inner = (slice(room, room + side),) * 2
        weight, variance = kept.astype(np.float64), self.features.variance + spread
        whole = Tile(above[inner], weight[inner], variance[inner])
        return _Tile((side * key[0], side * key[1]), whole, z[inner])

    # --- evidence -------------------------------------------------------------------------

    def _compare(self, tile: _Tile, away: Array, usual: float) -> None:
        """Multiply the posterior by the likelihood of a tile."""
        log = self._log - away
        row, col = np.nonzero(log >= log.max() - _HOPELESS)
        ratio, share = np.zeros(len(row)), np.zeros(len(row))
        north, east, ways = row + self._origin[0], col + self._origin[1], self._ways
        for a in range(ways):
            for b in range(ways):
                # A shift by an odd number of halves takes posts that begin a half later.
                mine = np.flatnonzero(((north + a) % ways == 0) & ((east + b) % ways == 0))
                ratio[mine], share[mine] = self.features.likelihood(
                    tile.lay(a, b), (north[mine] + a) // ways + tile.first[0] // 2,
                    (east[mine] + b) // ways + tile.first[1] // 2,
                )  # fmt: skip
        self._log[row, col] += self.features.factor(ratio, share, usual, log.size)

    # --- outcome --------------------------------------------------------------------------

    def _match(self, away: Array, mean: Array, covariance: Array) -> Match:
        """Weigh all places, and all that lie farther off by what was known before."""
        log = self._log - away
        best = log.max()
        p = np.exp(log - best)
        every = 2.0 * np.pi * np.sqrt(np.linalg.det(covariance)) / self._unit**2
        with np.errstate(divide="ignore"):
            beyond = float(np.log(every * self._beyond(mean, covariance)) - best)
        p /= p.sum() + np.exp(min(beyond, 700.0))
        row, col = np.unravel_index(int(np.argmax(p)), p.shape)
        rows, cols = np.indices(p.shape)
        near = np.hypot(rows - row, cols - col) <= 1.5 * self._ways + 1e-9
        certainty = float(p[near].sum())
        q = p[near] / certainty
        north = self._unit * (rows[near] + self._origin[0])
        east = self._unit * (cols[near] + self._origin[1])
        middle = np.array([q @ east, q @ north])
        # Half a post's width is left open besides the spread of the posterior.
        spread = np.array([q @ (east - middle[0]) ** 2, q @ (north - middle[1]) ** 2])
        spread += (0.5 * self.prior.grid.posting) ** 2
        share, rise, error = self._agreement(int(row), int(col))
        up, up_variance = self._level(p)
        return Match(
            np.array([*middle, up if rise is None else rise]),
            np.diag([*spread, error]), certainty, share, up, up_variance,
        )  # fmt: skip

    def _beyond(self, mean: Array, covariance: Array) -> float:
        """Return the share of the prior beyond the places searched, at most.

        By its tails past each side, and not by what places within add up to: of a prior narrower
        than their distance that may be anything.
        """
        sigma = np.sqrt(np.diag(covariance))
        low = self._unit * (np.array(self._origin[::-1]) - 0.5)
        high = low + self._unit * np.array(self._log.shape[::-1])
        past = ndtr((low - mean) / sigma) + ndtr((mean - high) / sigma)
        return min(float(past.sum()), 1.0)

    def _under(
        self, tile: _Tile, row: IntArray, col: IntArray
    ) -> tuple[tuple[slice, slice], IntArray, IntArray]:
        """Return which posts of a tile lie on posts of the map at places, and on which (n, r, c).

        All places given must ask for the same of the four ways to lay posts.
        """
        north, east = row + self._origin[0], col + self._origin[1]
        ways = self._ways
        a, b = int(-north[0] % ways), int(-east[0] % ways)
        n = np.arange(self._wide)
        r = ((north + a) // ways + tile.first[0] // 2)[:, None] + n
        c = ((east + b) // ways + tile.first[1] // 2)[:, None] + n
        return (slice(a, None, 2), slice(b, None, 2)), r, c

    def _agreement(self, row: int, col: int) -> tuple[float, float | None, float]:
        """Return the share of posts that agree at a place, and how far the map lies above, m.

        The height is that of the last tiles, with its variance.
        """
        agreed, offered, rises = 0, 0, []
        for n, tile in enumerate(reversed(self._tiles)):
            cut, r, c = self._under(tile, np.array([row]), np.array([col]))
            shown, elevation = (
                _at(of, r[0], c[0]) for of in (self.features.shown, self.prior.elevation)
            )
            both = (tile.whole.weight[cut] > 0.0) & (_at(self.features.kept, r[0], c[0]) > 0.0)
            gap = shown - tile.whole.height[cut]
            agree = both & (gap**2 <= 9.0 * tile.whole.variance[cut])
            agreed, offered = agreed + int(agree.sum()), offered + int(both.sum())
            if n < 6:
                rises.append((elevation - tile.level[cut])[agree])
        rise = np.concatenate(rises)
        posting, sigma = self.prior.grid.posting, self.prior.sigma
        error = sigma**2 * self.prior.together / max(len(rise), 1) + (0.4 * posting) ** 2
        found = float(np.median(rise)) if len(rise) else None
        return agreed / offered if offered else 0.0, found, float(error)

    def _level(self, p: Array) -> tuple[float, float]:
        """Return mean and variance of the vertical shift over all places, by their probability."""
        # Places of one lay of posts stand for all, thinned to what is quick.
        every = self._ways * max(1, int(np.sqrt(p.size / self._ways**2 / _SAMPLE)))
        best = np.unravel_index(int(np.argmax(p)), p.shape)
        row, col = (np.arange(int(b) % every, n, every) for b, n in zip(best, p.shape, strict=True))
        block = (every, every)
        mass = ndimage.uniform_filter(p, block, mode="constant")[np.ix_(row, col)].ravel()
        row, col = (part.ravel() for part in np.meshgrid(row, col, indexing="ij"))
        keep = mass > 1e-6 * mass.max()
        row, col, mass = row[keep], col[keep], mass[keep]
        tile = self._tiles[-1]
        cut, r, c = self._under(tile, row, col)
        ours = tile.whole.weight[cut] > 0.0
        i, j = np.nonzero(ours)
        some = slice(None, None, max(1, len(i) // 32))
        i, j = i[some], j[some]
        rise = _at(self.prior.elevation, r[:, i], c[:, j], paired=True) - tile.level[cut][i, j]
        known = np.isfinite(rise)
        count = known.sum(axis=1)
        mean = np.where(known, rise, 0.0).sum(axis=1) / np.maximum(count, 1)
        weight = np.where(count > 0, mass, 0.0)
        if weight.sum() == 0.0:
            return 0.0, np.inf
        weight /= weight.sum()
        up = float(weight @ mean)
        return up, float(weight @ (mean - up) ** 2)


def _check_known(mean: Array, covariance: Array, speed_sigma: float) -> None:
    """Refuse what cannot be known of a place."""
    if np.shape(mean) != (2,) or not np.isfinite(mean).all():
        raise InputError("mean", mean, "two numbers, m")
    p = np.asarray(covariance, dtype=np.float64)
    fits = p.shape == (2, 2) and np.isfinite(p).all() and np.allclose(p, p.T, rtol=1e-6)
    if not (fits and p[0, 0] > 0.0 and np.linalg.det(p) > 0.0):
        raise InputError("covariance", covariance, "a positive definite matrix (2, 2), m^2")
    if not 0.0 <= speed_sigma < np.inf:
        raise InputError("speed_sigma", speed_sigma, "0 or a positive number, m/s")


def _cut(of: NDArray[Any], row: int, col: int, side: int) -> NDArray[Any]:
    """Return a square of a raster, 0 where it lies beyond."""
    out = np.zeros((side, side), of.dtype)
    r0, r1 = max(row, 0), min(row + side, of.shape[0])
    c0, c1 = max(col, 0), min(col + side, of.shape[1])
    if r0 < r1 and c0 < c1:
        out[r0 - row : r1 - row, c0 - col : c1 - col] = of[r0:r1, c0:c1]
    return out


def _at(of: NDArray[Any], row: IntArray, col: IntArray, *, paired: bool = False) -> Array:
    """Return a raster at rows (r,) by columns (c,), or at pairs of them; NaN beyond it."""
    if not paired:
        row, col = np.broadcast_arrays(row[:, None], col[None, :])
    inside = (row >= 0) & (row < of.shape[0]) & (col >= 0) & (col < of.shape[1])
    out = np.full(row.shape, np.nan)
    out[inside] = of[row[inside], col[inside]]
    return out
