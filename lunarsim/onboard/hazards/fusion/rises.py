"""Detection and false-alarm probabilities of tracked rocks in elevation samples.

A rock that was hit by enough samples shows a residual height of half its own height with a known
probability. By chance, any other place of the map shows one with the false-alarm probability.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid

Array = NDArray[np.float64]

# Share of samples that count as independent: samples of a cell are averaged, and neighbours share
# errors.
INDEPENDENT = 0.5
# A rock is compared with the maximum residual height within this distance, m, if it exceeds this
# share of the rock height. A half ellipsoid is that high over this share of its area.
_NEAR, _SHOWS, _TOP = 0.35, 0.5, 0.75
# Probability that a rock is where its track is.
_TRUE = 0.8
_RAREST = 1e-3


@dataclass(frozen=True)
class Showing:
    """Detectability of individual rocks.

    Attributes
    ----------
    least
        Minimum residual height that shows each rock (n,), m.
    shows
        Probability that the samples show each, if it is a rock (n,).
    chance
        False-alarm probability of such a residual height at any place (n,).
    """

    least: Array
    shows: Array
    chance: Array

    @property
    def hit(self) -> Array:
        """Probability of a sufficient residual height at a rock, true or by chance (n,)."""
        return np.asarray(self.shows + (1.0 - self.shows) * self.chance)


@dataclass(frozen=True)
class Samples:
    """Elevation samples at the places of rocks.

    Attributes
    ----------
    rises
        Residual height of the sample of each cell above the local plane (rows, cols), m; NaN
        without a sample.
    density
        Samples per square metre (rows, cols).
    grid
        Cells of both.
    height_ratio
        Height over diameter of the rocks expected by the mission.
    """

    rises: NDArray[np.float32]
    density: Array
    grid: Grid
    height_ratio: float

    @cached_property
    def top(self) -> NDArray[np.float32]:
        """Maximum residual height near each cell (rows, cols), m; -1e6 without a sample."""
        half = max(round(_NEAR / self.grid.posting), 1)
        y, x = np.mgrid[-half : half + 1, -half : half + 1]
        near = np.hypot(x, y) * self.grid.posting <= _NEAR
        known = np.where(np.isfinite(self.rises), self.rises, np.float32(-1e6))
        return np.asarray(ndimage.maximum_filter(known, footprint=near, mode="constant", cval=-1e6))

    @cached_property
    def _tops(self) -> NDArray[np.float32]:
        return np.sort(self.top, axis=None)

    def showing(self, height: Array, density: Array) -> Showing:
        """Return the detection and false-alarm probabilities of rocks.

        Parameters
        ----------
        height
            Heights of the rocks (n,), m.
        density
            Samples per square metre near each (n,).
        """
        least = _SHOWS * height
        chance = 1.0 - np.searchsorted(self._tops, least) / self.top.size
        area = _TOP * np.pi * (height / (2.0 * self.height_ratio)) ** 2
        shows = _TRUE * -np.expm1(-INDEPENDENT * density * area)
        return Showing(least, shows, np.clip(chance, _RAREST, 1.0 - _RAREST))
