"""Whether samples show a tracked rock, and how often they seem to where there is none.

A rock that so many samples have met shows a rise of half its height with one probability; by chance
one lies there with that of any other place of the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

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


def showing(
    height: Array, density: Array, top: NDArray[np.float32], height_ratio: float
) -> Showing:
    """Return how likely samples are to show rocks, and any other place to look like them.

    Parameters
    ----------
    height
        Of the rocks (n,), m.
    density
        Samples on a square metre about each (n,).
    top
        `highest_near` of the map (rows, cols), m.
    height_ratio
        Height over diameter of the rocks that the mission expects.
    """
    least = _SHOWS * height
    chance = 1.0 - np.searchsorted(np.sort(top, axis=None), least) / top.size
    area = _TOP * np.pi * (height / (2.0 * height_ratio)) ** 2
    shows = _TRUE * -np.expm1(-INDEPENDENT * density * area)
    return Showing(least, shows, np.clip(chance, _RAREST, 1.0 - _RAREST))


def highest_near(rises: NDArray[np.float32], posting: float) -> NDArray[np.float32]:
    """Return the highest rise about each cell (rows, cols), m; far below where there is none.

    Parameters
    ----------
    rises
        How far the samples of each cell stand above the ground about them (rows, cols), m; NaN
        where there are none.
    posting
        Of the cells, m.
    """
    half = max(round(_NEAR / posting), 1)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    known = np.where(np.isfinite(rises), rises, np.float32(-1e6))
    return np.asarray(
        ndimage.maximum_filter(
            known, footprint=np.hypot(x, y) * posting <= _NEAR, mode="constant", cval=-1e6
        )
    )
