"""Samples about tracked rocks: what they show, and how often any other place looks like a rock.

A rock that so many samples have met shows a rise of half its height with one probability; by chance
one lies there with that of any other place of the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.grid import Grid

Array = NDArray[np.float64]

# Samples of one cell are averaged, and neighbours share errors: so many of them count.
INDEPENDENT = 0.5
# Rocks are compared with the highest rise so near, m, of half their height or more; a half
# ellipsoid is that high over three quarters of its area.
_NEAR, _SHOWS, _TOP = 0.35, 0.5, 0.75
# So many rocks are where they seem to be.
_TRUE = 0.8
_RAREST = 1e-3


@dataclass(frozen=True)
class Showing:
    """What speaks for rocks, one by one.

    Attributes
    ----------
    least
        How high a rise has to be to show each (n,), m.
    shows
        Probability that samples show each, if it is a rock (n,).
    chance
        Probability that they seem to at any place of the map (n,).
    """

    least: Array
    shows: Array
    chance: Array

    @property
    def hit(self) -> Array:
        """Probability of a rise as high at a rock, by itself or by chance (n,)."""
        return np.asarray(self.shows + (1.0 - self.shows) * self.chance)


@dataclass(frozen=True)
class Samples:
    """What elevations say of the places of rocks.

    Attributes
    ----------
    rises
        How far the samples of each cell stand above the ground about them (rows, cols), m; NaN
        where there are none.
    density
        Samples on a square metre (rows, cols).
    grid
        Cells of both.
    height_ratio
        Height over diameter of the rocks that the mission expects.
    """

    rises: NDArray[np.float32]
    density: Array
    grid: Grid
    height_ratio: float

    @cached_property
    def top(self) -> NDArray[np.float32]:
        """The highest rise about each cell (rows, cols), m; far below where there is none."""
        half = max(round(_NEAR / self.grid.posting), 1)
        y, x = np.mgrid[-half : half + 1, -half : half + 1]
        near = np.hypot(x, y) * self.grid.posting <= _NEAR
        known = np.where(np.isfinite(self.rises), self.rises, np.float32(-1e6))
        return np.asarray(ndimage.maximum_filter(known, footprint=near, mode="constant", cval=-1e6))

    @cached_property
    def _tops(self) -> NDArray[np.float32]:
        return np.sort(self.top, axis=None)

    def showing(self, height: Array, density: Array) -> Showing:
        """Return how likely samples are to show rocks, and any other place to look like them.

        Parameters
        ----------
        height
            Of the rocks (n,), m.
        density
            Samples on a square metre about each (n,).
        """
        least = _SHOWS * height
        chance = 1.0 - np.searchsorted(self._tops, least) / self.top.size
        area = _TOP * np.pi * (height / (2.0 * self.height_ratio)) ** 2
        shows = _TRUE * -np.expm1(-INDEPENDENT * density * area)
        return Showing(least, shows, np.clip(chance, _RAREST, 1.0 - _RAREST))
