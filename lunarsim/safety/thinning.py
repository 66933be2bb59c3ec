"""Rocks that samples missed and another eye would have seen: how many of them may still be there.

A camera that saw the ground lit where a rock's shadow would fall has not ruled the rock out: it
misses some. Of the rocks that no sample has met, as many stand there still as it misses. That is a
ratio for each size of rocks, place by place: below 1 where the ground was seen lit, above it where
it is dark and nothing that is known throws the shadow, and 1 where nothing was seen.

Rocks above a height are of many sizes. Where they were seen to be fewer, what is left of them is
the mean ratio of the law's rocks above the height, the smallest, which no look can tell of, counted
whole. For this mean not to rise with the height, larger rocks are never taken to be missed more
often than smaller ones.

Where there may be more, what comes on top is counted by what the samples say of each size: in the
dark a large rock may be two hundred times as likely as anywhere, but samples would have met it. As
the mean above, that ratio would be taken for two hundred times as many of the smallest. So it is
added up from class to class, each by the unseen rocks above its own least height. A larger class
has never less on top than a smaller one: then what is left, U(h) times the mean, and for each class
its further excess times U(max(h, its least height)), has no negative part. It never rises with the
height, and never falls with the number before at any height, or with any ratio.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.rocks.laws import golombek_number
from lunarsim.safety._thinning_kernels import mean_ratios

Array = NDArray[np.float64]


class Unseen(Protocol):
    """Unseen rocks above heights, on a square metre or any other area; see `Thinning.left`."""

    def __call__(self, above: Array, where: NDArray[np.bool_] | None = None, /) -> Array:
        """Return them at all sites (rows, cols), or at those of a mask (n,)."""


# Less than any height that is asked for, m.
_LEAST = 0.005
# The law is looked up between so many diameters, m: to a millionth of it.
_TABLE = np.geomspace(1e-3, 30.0, 2**14)
_LOG_TABLE = np.log(_TABLE)


@dataclass(frozen=True)
class Thinning:
    """What another eye leaves of rocks that were not seen.

    Attributes
    ----------
    diameter
        Least one of each class of sizes (n,), rising, m; smaller rocks were not looked for.
    ratio
        Rocks left of each class over those before, the mean over the ground that concerns a site
        (n, rows, cols).
    cover, height_ratio
        Of the Golombek law that the mission expects, and height over diameter of its rocks.

    Raises
    ------
    InputError
        If diameters do not rise, or a ratio is negative or not finite.
    """

    diameter: Array
    ratio: NDArray[np.float32]
    cover: float
    height_ratio: float

    def __post_init__(self) -> None:
        d = np.asarray(self.diameter)
        if not (d.ndim == 1 and d.size and d[0] > 0.0 and (np.diff(d) > 0.0).all()):
            raise InputError("thinning.diameter", self.diameter, "positive lengths that rise")
        if self.ratio.ndim != 3 or len(self.ratio) != d.size:
            raise InputError("thinning.ratio", self.ratio.shape, f"({d.size}, rows, cols)")
        if not (np.isfinite(self.ratio).all() and self.ratio.min(initial=0.0) >= 0.0):
            raise InputError("thinning.ratio", float(self.ratio.min()), "finite, and at least 0")
        if not (np.isfinite(self.height_ratio) and self.height_ratio > 0.0):
            raise InputError("thinning.height_ratio", self.height_ratio, "a positive number")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.ratio.shape[1], self.ratio.shape[2]

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Where any rocks are fewer or more than before (rows, cols)."""
        return np.asarray((self.ratio != 1.0).any(axis=0))

    @cached_property
    def _falling(self) -> Array:
        """Ratios that do not rise from class to class, those not looked for first (n + 1, ...)."""
        return self._falling_of(self.ratio)

    @staticmethod
    def _falling_of(ratio: NDArray[np.float32]) -> Array:
        # Class by class: a running maximum along the first axis takes ten times as long.
        out = np.empty((len(ratio) + 1, *ratio.shape[1:]))
        out[-1] = ratio[-1]
        for n in range(len(ratio) - 1, 0, -1):
            np.maximum(out[n + 1], ratio[n - 1], out=out[n])
        np.maximum(out[1], 1.0, out=out[0])
        return out

    def at(self, height: ArrayLike) -> Array:
        """Return how many of the unseen rocks above heights are left, a share (rows, cols).

        By the sizes of the law alone.

        Parameters
        ----------
        height
            m, () or (rows, cols).
        """
        return self._mean(height, self._falling)

    def left(self, unseen: Unseen, height: ArrayLike) -> Array:
        """Return how many unseen rocks above heights are left (rows, cols).

        Where there may be more of them than before, by what is said of each size.

        Parameters
        ----------
        unseen
            Gives how many were there before above heights, () or (rows, cols), m: (rows, cols); or
            given a mask (rows, cols) too, and heights () or of its cells (n,), of these (n,).
        height
            m, () or (rows, cols).
        """
        h = np.asarray(height, dtype=np.float64)
        out: Array = unseen(h) * self._mean(h, self._fewer)
        for least, (where, further) in zip(self.diameter, self._further, strict=True):
            if len(further):
                above = np.maximum(h[where] if h.ndim else h, self.height_ratio * least)
                out[where] += further * unseen(above, where)
        return out

    def _mean(self, height: ArrayLike, falling: Array) -> Array:
        """Return the mean over the law's rocks above heights of ratios that do not rise."""
        flat = falling.reshape(len(falling), -1)
        out = np.empty(flat.shape[1])
        with threads_for(0.05 * out.size):
            mean_ratios(
                _of_sites(height, self.shape), flat, np.asarray(self.diameter, float),
                _number(self.diameter, self.cover), _LEAST, self.height_ratio, _LOG_TABLE[0],
                _LOG_TABLE[1] - _LOG_TABLE[0], _law(self.cover), out,
            )  # fmt: skip
        return out.reshape(self.shape)

    @cached_property
    def _fewer(self) -> Array:
        """As `_falling`, but nowhere more than before."""
        return self._falling_of(np.minimum(self.ratio, np.float32(1.0)))

    @cached_property
    def _further(self) -> list[tuple[NDArray[np.bool_], Array]]:
        """Where a class has more on top than the next smaller one (rows, cols), and what (n,)."""
        out, before = [], np.zeros(self.shape, np.float32)
        for ratio in self.ratio:
            more = np.maximum(ratio - np.float32(1.0), before)
            where = more > before
            out.append((where, more[where].astype(np.float64) - before[where]))
            before = more
        return out


def _of_sites(height: ArrayLike, shape: tuple[int, int]) -> Array:
    """Return heights () as (1,), and others as those of all sites (rows * cols,)."""
    h = np.asarray(height, dtype=np.float64)
    return h.reshape(1) if h.size == 1 else np.ravel(np.broadcast_to(h, shape))


def _number(diameter: ArrayLike, cover: float) -> Array:
    """Return `golombek_number`, to a millionth."""
    d = np.log(np.asarray(diameter, dtype=np.float64))
    return np.asarray(np.exp(np.interp(d, _LOG_TABLE, _law(cover))))


@lru_cache(maxsize=8)
def _law(cover: float) -> Array:
    """Return the logarithm of the law's number at `_TABLE` (n,)."""
    return np.asarray(np.log(np.maximum(golombek_number(_TABLE, cover), 1e-300)))
