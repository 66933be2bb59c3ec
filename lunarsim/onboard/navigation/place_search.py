"""Where on a map a patch of scanned ground lies, from tens of metres off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.signal import correlate

from lunarsim.onboard.navigation.surface import Surface

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Match:
    """Where the correlation search finds a patch.

    Attributes
    ----------
    shift
        To be added to the patch (3,), ENU, m.
    covariance
        Of the shift (3, 3), m^2.
    certainty
        Probability that the patch lies within one and a half posts of there.
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


def high_pass(
    height: Array, known: NDArray[np.bool_], reach: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Return heights less their mean over a square of 2 `reach` + 1, and where all of it is known.

    What is left are features; swells and the tilt of a wrong attitude are gone.
    """
    side = 2 * reach + 1
    full = ndimage.uniform_filter(known.astype(np.float64), side, mode="constant") > 1.0 - 1e-9
    filled = np.where(known, height, 0.0)
    return np.where(full, filled - ndimage.uniform_filter(filled, side, mode="constant"), 0.0), full


@dataclass(frozen=True)
class Features:
    """What of a scan stands out from its surroundings.

    Attributes
    ----------
    col, row
        Of the squares (m,).
    height
        Above the mean of the square around (m,), m.
    level
        Height of the scan itself there (m,), m.
    """

    col: IntArray
    row: IntArray
    height: Array
    level: Array


def features_of(surface: Surface, reach: int) -> Features:
    """Return a scan's features: each scan by itself, so that drift between scans leaves no step."""
    if len(surface) == 0:
        return Features(surface.col, surface.row, np.zeros(0), np.zeros(0))
    first = (int(surface.row.min()), int(surface.col.min()))
    shape = (int(surface.row.max()) - first[0] + 1, int(surface.col.max()) - first[1] + 1)
    height, known = np.zeros(shape), np.zeros(shape, np.bool_)
    place = (surface.row - first[0], surface.col - first[1])
    height[place] = surface.position[:, 2]
    known[place] = True
    above, kept = high_pass(height, known, reach)
    row, col = np.nonzero(kept)
    return Features(col + first[1], row + first[0], above[kept], height[kept])


@dataclass(frozen=True)
class ScanPatch:
    """Features of several scans on one raster.

    Attributes
    ----------
    first
        Row and column of its corner.
    height, level
        As in `Features`, averaged (rows, cols), m; 0 where unknown.
    known
        (rows, cols).
    """

    first: tuple[int, int]
    height: Array
    level: Array
    known: NDArray[np.bool_]

    @classmethod
    def merged(cls, scans: list[Features]) -> ScanPatch | None:
        """Return the features of scans together; None if there are none."""
        row = np.concatenate([f.row for f in scans])
        col = np.concatenate([f.col for f in scans])
        if len(row) == 0:
            return None
        first = (int(row.min()), int(col.min()))
        shape = (int(row.max()) - first[0] + 1, int(col.max()) - first[1] + 1)
        place = (row - first[0]) * shape[1] + col - first[1]
        size = shape[0] * shape[1]
        count = np.bincount(place, minlength=size)
        height, level = (
            np.bincount(place, np.concatenate([getattr(f, name) for f in scans]), size)
            / np.maximum(count, 1)
            for name in ("height", "level")
        )
        known = (count > 0).reshape(shape)
        return cls(first, height.reshape(shape), level.reshape(shape), known)


# Places by correlation that are looked at post by post.
_CANDIDATES = 150
# Share of a map that may show another ground than there is, by squares of so many posts.
_CHANGED, _TILE = 0.1, 24
# Size of features, m.
_FEATURE = 0.3


def search(
    patch: ScanPatch,
    elevation: Array,
    posting: float,
    variance: float,
    prior: Array,
    first: Array,
    *,
    reach: int,
    least: int = 60,
) -> Match | None:
    """Find a patch on a map: the posterior over whole-post shifts.

    A matched filter, all shifts at once by correlation, proposes places. Each is then judged post
    by post: how much likelier is what the map shows there if the patch lies there than if not? A
    map's noise agrees with flat ground everywhere, so only features tell; and where a part of the
    map shows another ground altogether, because it is out of date, that part tells nothing.

    Parameters
    ----------
    patch
        What was scanned.
    elevation
        Map (rows, cols), m; NaN for none.
    posting
        Of both, m.
    variance
        Of a residual, m^2.
    prior
        Covariance (2, 2) of the shift beforehand, m^2.
    first
        Shift that puts the patch's corner on the map's (2,), east and north, m.
    reach
        By which the features were found, posts.
    least
        Fewest posts to compare.

    Returns
    -------
    match
        None if the patch is too small, or no shift puts all of it on the map.
    """
    total = float(patch.known.sum())
    if total < least:
        return None
    ground = _Ground.of(elevation, variance, reach)
    shifts = _Shifts.of(patch, ground, posting, prior, first)
    if not shifts.covered.any():
        return None
    row, col = _candidates(patch, ground, shifts)
    log = _evidence(patch, ground, row, col) - 0.5 * shifts.away[row, col]
    place = _Place.of(log, shifts.east[row, col], shifts.north[row, col], shifts, posting)
    rise, agree = _compared(patch, ground, int(row[place.best]), int(col[place.best]))
    up, up_variance = _level(patch, ground, shifts)
    return Match(
        np.array([*place.mean, float(np.median(rise[agree])) if agree.any() else up]),
        np.diag([*place.variance, variance / total + (0.4 * posting) ** 2]),
        place.certainty, float(agree.mean()), up, up_variance,
    )  # fmt: skip


@dataclass(frozen=True)
class _Ground:
    """The map as the search compares it.

    Attributes
    ----------
    elevation
        (rows, cols), m; NaN for none.
    height
        Above the mean of the square around (rows, cols), m.
    known
        Where all of that square is known (rows, cols).
    variance
        Of a residual, m^2.
    """

    elevation: Array
    height: Array
    known: NDArray[np.bool_]
    variance: float

    @classmethod
    def of(cls, elevation: Array, variance: float, reach: int) -> _Ground:
        return cls(elevation, *high_pass(elevation, np.isfinite(elevation), reach), variance)


@dataclass(frozen=True)
class _Shifts:
    """All whole-post shifts at which a patch may lie on the map, (rows, cols) each.

    Attributes
    ----------
    east, north
        m.
    away
        Squared distance from no shift in units of the prior.
    covered
        Whether the map knows all of the ground under the patch.
    """

    east: Array
    north: Array
    away: Array
    covered: NDArray[np.bool_]

    @classmethod
    def of(
        cls, patch: ScanPatch, ground: _Ground, posting: float, prior: Array, first: Array
    ) -> _Shifts:
        known = _slide(patch.known.astype(np.float64), ground.known.astype(np.float64))
        sy, sx = np.meshgrid(
            np.arange(known.shape[0]) * posting + first[1],
            np.arange(known.shape[1]) * posting + first[0],
            indexing="ij",
        )
        inverse = np.linalg.inv(prior)
        away = inverse[0, 0] * sx**2 + 2.0 * inverse[0, 1] * sx * sy + inverse[1, 1] * sy**2
        return cls(sx, sy, away, known > float(patch.known.sum()) - 0.5)


def _slide(template: Array, image: Array) -> Array:
    """Return the correlation of a template with an image wherever it lies on it as a whole."""
    return np.asarray(correlate(image, template, mode="valid", method="fft"))


def _candidates(patch: ScanPatch, ground: _Ground, shifts: _Shifts) -> tuple[IntArray, IntArray]:
    """Return rows and columns (c,) of the places where a matched filter peaks, the best first."""
    # What is higher than features get is not worth more than they.
    limited = np.clip(ground.height, -_FEATURE, _FEATURE)
    proposal = _slide(patch.height, limited) / ground.variance - 0.5 * shifts.away
    proposal[~shifts.covered] = -np.inf
    peaks = np.flatnonzero(shifts.covered & (proposal == ndimage.maximum_filter(proposal, 3)))
    best_first = np.argsort(-proposal.ravel()[peaks], kind="stable")
    row, col = np.unravel_index(peaks[best_first[:_CANDIDATES]], shifts.covered.shape)
    return row, col


def _compared(
    patch: ScanPatch, ground: _Ground, row: int, col: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Return how far the map lies above the patch at a place, and which posts agree (m,)."""
    rows, cols = np.nonzero(patch.known)
    misfit = ground.height[row + rows, col + cols] - patch.height[patch.known]
    rise = ground.elevation[row + rows, col + cols] - patch.level[patch.known]
    return rise, misfit**2 <= 9.0 * ground.variance


@dataclass(frozen=True)
class _Place:
    """The posterior over places, about its best one.

    Attributes
    ----------
    best
        Index of the best candidate.
    mean, variance
        East and north, m, of the candidates next to it, and m^2.
    certainty
        Their probability.
    """

    best: int
    mean: tuple[float, float]
    variance: tuple[float, float]
    certainty: float

    @classmethod
    def of(cls, log: Array, x: Array, y: Array, shifts: _Shifts, posting: float) -> _Place:
        """Weigh candidates (c,) by their log-likelihoods, and all other places by the prior."""
        # Places not looked at are as likely as they were before.
        elsewhere = float(np.exp(-0.5 * shifts.away[shifts.covered] - log.max()).sum())
        p = np.exp(log - log.max())
        best = int(np.argmax(p))
        near = np.hypot(x - x[best], y - y[best]) <= 1.5 * posting + 1e-9
        certainty = float(p[near].sum() / (p.sum() + elsewhere))
        q = np.where(near, p, 0.0) / p[near].sum()
        east, north = float(q @ x), float(q @ y)
        # A post's width is left open besides the spread of the posterior.
        spread = (
            float(q @ (x - east) ** 2) + posting**2,
            float(q @ (y - north) ** 2) + posting**2,
        )
        return cls(best, (east, north), spread, certainty)


def _evidence(patch: ScanPatch, ground: _Ground, row: IntArray, col: IntArray) -> Array:
    """Return the log-likelihood ratio of places (c,): the patch lies there, or it does not.

    Ground changes by parts, and a part that has tells nothing, however many posts it has.
    """
    rows, cols = np.nonzero(patch.known)
    scanned = patch.height[patch.known]
    shown = ground.height[row[:, None] + rows, col[:, None] + cols]
    # Share of the map's posts that are features.
    busy = float(np.mean(np.abs(ground.height[ground.known]) > _FEATURE))
    busy = float(np.clip(busy, 0.01, 0.5))
    wide = ground.variance + _FEATURE**2

    def normal(x: Array, v: float) -> Array:
        return np.asarray(np.exp(-0.5 * x * x / v) / np.sqrt(v))

    def likelihood(x: Array) -> Array:
        return np.asarray((1.0 - busy) * normal(x, ground.variance) + busy * normal(x, wide))

    tile = (rows // _TILE) * (1 + patch.known.shape[1] // _TILE) + cols // _TILE
    order = np.argsort(tile, kind="stable")
    starts = np.flatnonzero(np.diff(tile[order], prepend=-1))
    ratio = likelihood(shown - scanned) / likelihood(shown)
    # Neighbouring posts on one feature agree or fail together: they count half.
    parts = 0.5 * np.add.reduceat(np.log(ratio)[:, order], starts, axis=1)
    return np.asarray(np.logaddexp(parts + np.log1p(-_CHANGED), np.log(_CHANGED)).sum(axis=1))


def _level(patch: ScanPatch, ground: _Ground, shifts: _Shifts) -> tuple[float, float]:
    """Return mean and variance of the vertical shift over all places, by their probability."""
    known = patch.known.astype(np.float64)
    above = _slide(known, np.where(ground.known, ground.elevation, 0.0)) / float(patch.known.sum())
    rise = above - patch.level[patch.known].mean()
    least = shifts.away[shifts.covered].min()
    weight = np.where(shifts.covered, np.exp(-0.5 * (shifts.away - least)), 0.0)
    weight = weight / weight.sum()
    mean = float((weight * rise).sum())
    return mean, float((weight * (rise - mean) ** 2).sum())
