"""Rocks that samples missed and another eye would have seen: how many of them may still be there.

A camera that saw the ground lit where a rock's shadow would fall has not ruled the rock out: it
misses some. Of the rocks that no sample has met, as many stand there still as it misses. That is a
ratio for each size of rocks, place by place: below 1 where the ground was seen lit, above it where
it is dark and nothing that is known throws the shadow, and 1 where nothing was seen.

Rocks above a height are of many sizes. What is left of them is the mean ratio of the law's rocks
above the height, the smallest, which no look can tell of, counted whole. For this mean not to rise
with the height, larger rocks are never taken to be missed more often than smaller ones: then the
number left never rises with the height, with the number before, or with any ratio.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.rocks.laws import golombek_number

Array = NDArray[np.float64]

# Less than any height that is asked for, m.
_LEAST = 0.005


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
        from_above = np.maximum.accumulate(self.ratio[::-1].astype(np.float64), axis=0)[::-1]
        return np.concatenate((np.maximum(from_above[:1], 1.0), from_above))

    def at(self, height: ArrayLike) -> Array:
        """Return how many of the unseen rocks above heights are left, a share (rows, cols).

        Parameters
        ----------
        height
            m, () or (rows, cols).
        """
        d = np.maximum(np.asarray(height, dtype=np.float64), _LEAST) / self.height_ratio
        number = golombek_number(d, self.cover)
        left: Array = self._falling[0].copy()
        for n, least in enumerate(self.diameter, start=1):
            # Share of the rocks above the height that are of this class or a larger one.
            larger = golombek_number(np.maximum(d, least), self.cover)
            share = np.divide(larger, number, out=np.ones_like(number), where=number > 0.0)
            left += (self._falling[n] - self._falling[n - 1]) * share
        return left
