"""Ratio of rocks missed by samples that another sensor also misses.

A camera that sees lit terrain where a rock's shadow would fall has not excluded the rock, because
it misses some rocks. Of the rocks that no sample has met, the fraction that the camera misses
remains. This ratio is given for each size class and place: below 1 where the terrain was seen lit,
above 1 where it is dark and no known object casts the shadow, and 1 where nothing was seen.

Rocks above a height have many sizes. Where the ratio is below 1, the mean ratio of the
distribution's rocks above the height is used, with a ratio of at least 1 for the smallest rocks,
which no camera detects. To keep this mean from increasing with height, larger rocks are never
assumed to be missed more often than smaller ones.

Where the ratio is above 1, the excess is added class by class. A large rock may be two hundred
times as likely in the dark as elsewhere, but samples would have met it; the mean would apply this
factor to the small rocks. The excess of a class is therefore multiplied by the unseen rocks above
the class's minimum height. A larger class never has a smaller excess than a smaller class. The
result is U(h) times the mean, plus for each class its additional excess times U(max(h, its minimum
height)); all parts are non-negative. It never increases with the height, and never decreases with
the number U at any height, or with any ratio.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.rocks.size_distribution import golombek_number
from lunarsim.safety._undetected_rock_kernels import mean_ratios
from lunarsim.typing import Array, BoolArray


class UnseenRockCount(Protocol):
    """Interface of a function that returns unseen rocks above heights, per area.

    It is the argument `unseen` of `UndetectedRockRatio.remaining_rocks`.
    """

    def __call__(self, above: Array, where: BoolArray | None = None, /) -> Array:
        """Return the number of unseen rocks above the heights `above`, m.

        Without `where`, heights are () or (rows, cols), and the result is (rows, cols). With the
        mask `where` (rows, cols), heights are () or those of its cells (n,), and so is the result.
        """


# Below all requested heights, m.
_MIN_HEIGHT_M = 0.005
# Diameters between which the distribution is interpolated, m, with a relative error of 1e-6.
_TABLE = np.geomspace(1e-3, 30.0, 2**14)
_LOG_TABLE = np.log(_TABLE)


@dataclass(frozen=True)
class UndetectedRockRatio:
    """Fraction of unseen rocks that remain after observation by another sensor.

    The fraction is given per size class and cell; it can exceed 1 in unexplained shadow.

    Attributes
    ----------
    diameter
        Minimum diameter of each size class (n,), increasing, m; smaller rocks are not observed.
    ratio
        Number of remaining rocks over the number before the observation, per class, averaged over
        the terrain relevant for each site (n, rows, cols).
    cover, height_ratio
        Fraction of the terrain covered by rocks in the Golombek distribution that the mission
        expects, and height over diameter of its rocks.

    Raises
    ------
    InputError
        If diameters do not increase, or a ratio is negative or not finite.
    """

    diameter: Array
    ratio: NDArray[np.float32]
    cover: float
    height_ratio: float

    def __post_init__(self) -> None:
        d = np.asarray(self.diameter)
        if not (d.ndim == 1 and d.size and d[0] > 0.0 and (np.diff(d) > 0.0).all()):
            raise InputError(
                "undetected_rock_ratio.diameter",
                self.diameter,
                "must be positive, increasing lengths",
            )
        if self.ratio.ndim != 3 or len(self.ratio) != d.size:
            raise InputError(
                "undetected_rock_ratio.ratio",
                self.ratio.shape,
                f"must have the shape ({d.size}, rows, cols)",
            )
        if not (np.isfinite(self.ratio).all() and self.ratio.min(initial=0.0) >= 0.0):
            raise InputError(
                "undetected_rock_ratio.ratio",
                float(self.ratio.min()),
                "must be 0 or more and finite",
            )
        if not (np.isfinite(self.height_ratio) and self.height_ratio > 0.0):
            raise InputError(
                "undetected_rock_ratio.height_ratio",
                self.height_ratio,
                "must be positive and finite",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of the map."""
        return self.ratio.shape[1], self.ratio.shape[2]

    @property
    def is_changed(self) -> BoolArray:
        """Mask of the cells where the ratio of any size class differs from 1 (rows, cols)."""
        return np.asarray((self.ratio != 1.0).any(axis=0))

    @cached_property
    def _non_increasing_ratio(self) -> Array:
        """Ratio made non-increasing with rock size (n + 1, rows, cols).

        The first entry is for rocks smaller than all classes.
        """
        return self._make_non_increasing(self.ratio)

    @staticmethod
    def _make_non_increasing(ratio: NDArray[np.float32]) -> Array:
        """Raise ratios (n, rows, cols) so that they do not increase with rock size.

        Each class gets the maximum over its ratio and those of larger classes. The result (n + 1,
        rows, cols) begins with rocks smaller than all classes, whose ratio is at least 1.
        """
        # Class by class: a running maximum along the first axis is ten times slower.
        out = np.empty((len(ratio) + 1, *ratio.shape[1:]))
        out[-1] = ratio[-1]
        for n in range(len(ratio) - 1, 0, -1):
            np.maximum(out[n + 1], ratio[n - 1], out=out[n])
        np.maximum(out[1], 1.0, out=out[0])
        return out

    def at(self, height: ArrayLike) -> Array:
        """Return the fraction of unseen rocks above heights that remains (rows, cols).

        The fraction is the mean ratio over the rock sizes of the distribution.

        Parameters
        ----------
        height
            Heights, m, () or (rows, cols).
        """
        return self._mean(height, self._non_increasing_ratio)

    def remaining_rocks(self, unseen: UnseenRockCount, height: ArrayLike) -> Array:
        """Return the number of unseen rocks above heights that remain, per area.

        The result (rows, cols) is the number given by `unseen`, changed by the observation of the
        other sensor. Where the ratio exceeds 1, the excess is added class by class.

        Parameters
        ----------
        unseen
            Function that returns the number before the observation.
        height
            Heights, m, () or (rows, cols).
        """
        h = np.asarray(height, dtype=np.float64)
        out: Array = unseen(h) * self._mean(h, self._capped_non_increasing_ratio)
        for min_diameter, (where, further) in zip(self.diameter, self._excess, strict=True):
            if len(further):
                above = np.maximum(h[where] if h.ndim else h, self.height_ratio * min_diameter)
                out[where] += further * unseen(above, where)
        return out

    def _mean(self, height: ArrayLike, ratios: Array) -> Array:
        """Return the mean of ratios over all rocks above heights (rows, cols).

        `height` is () or (rows, cols), m; `ratios` (n + 1, rows, cols) do not increase with size.
        """
        flat = ratios.reshape(len(ratios), -1)
        out = np.empty(flat.shape[1])
        mean_ratios.run_loop(
            out.size, 0.05,
            _flatten_heights(height, self.shape), flat, np.asarray(self.diameter, float),
            _rock_number(self.diameter, self.cover), _MIN_HEIGHT_M, self.height_ratio,
            _LOG_TABLE[0], _LOG_TABLE[1] - _LOG_TABLE[0], _log_rock_number(self.cover), out,
        )  # fmt: skip
        return out.reshape(self.shape)

    @cached_property
    def _capped_non_increasing_ratio(self) -> Array:
        """Ratio, at most 1, made non-increasing with rock size (n + 1, rows, cols).

        The first entry is for rocks smaller than all classes.
        """
        return self._make_non_increasing(np.minimum(self.ratio, np.float32(1.0)))

    @cached_property
    def _excess(self) -> list[tuple[BoolArray, Array]]:
        """Growth of the excess of the ratio over 1 from each size class to the next.

        The excess is made non-decreasing with rock size. The list has one pair per class: mask of
        the cells where the excess grows (rows, cols), and the growth in these cells (n,).
        """
        out, before = [], np.zeros(self.shape, np.float32)
        for ratio in self.ratio:
            more = np.maximum(ratio - np.float32(1.0), before)
            where = more > before
            out.append((where, more[where].astype(np.float64) - before[where]))
            before = more
        return out


def _flatten_heights(height: ArrayLike, shape: tuple[int, int]) -> Array:
    """Return heights as a flat array: (1,) for one height, else (rows * cols,).

    Several heights are broadcast to the `shape` (rows, cols) of the map.
    """
    h = np.asarray(height, dtype=np.float64)
    return h.reshape(1) if h.size == 1 else np.ravel(np.broadcast_to(h, shape))


def _rock_number(diameter: ArrayLike, cover: float) -> Array:
    """Return the rocks per m^2 above diameters (m) by the Golombek distribution.

    The number is interpolated in a table, with a relative error of 1e-6; `cover` is the fraction of
    terrain covered by rocks.
    """
    d = np.log(np.asarray(diameter, dtype=np.float64))
    return np.asarray(np.exp(np.interp(d, _LOG_TABLE, _log_rock_number(cover))))


@lru_cache(maxsize=8)
def _log_rock_number(cover: float) -> Array:
    """Return the log of rocks per square metre above each diameter of `_TABLE` (n,).

    `cover` is the fraction of terrain covered by rocks of the Golombek distribution.
    """
    return np.asarray(np.log(np.maximum(golombek_number(_TABLE, cover), 1e-300)))
