"""What may stand between the samples of a map: rocks that no return has met.

The share of samples that rise above the ground about them by more than a height is the share of
the ground that does, whatever the spacing: it needs no rock to be resolved. Where nothing, or
little, was seen, the mission's rock law counts as much as a few samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.rocks.laws import golombek_number

Array = NDArray[np.float64]

# Heights at which the share is kept, over the lander's roughness limit.
_HEIGHTS = np.geomspace(0.08, 8.0, 40)
# Heights at which samples are counted, over the limit; those within the noise are left out.
_COUNTED = np.array([0.4, 0.6, 0.8, 1.0])
_NOISE = 3.5
# The rock law counts as much as this many samples.
_PRIOR_SAMPLES = 60.0
_MOST = 0.5
# Diameters of the law, m.
_DIAMETERS = np.geomspace(0.04, 6.0, 240)
# A rock just wider than needed to rise above a height h has a top of about this times h^2 above it.
_TOP = 1.5 * np.pi


@dataclass(frozen=True)
class HeightCurve:
    """Share of the ground that stands higher than so much above the ground about it.

    Attributes
    ----------
    height
        Rising (n,), m.
    share
        Of the ground above each (n,), falling.
    """

    height: Array
    share: Array

    def at(self, height: ArrayLike) -> Array:
        """Return the share above heights (...), m; those beyond the curve count as its ends."""
        h = np.log(np.clip(np.asarray(height, dtype=np.float64), self.height[0], self.height[-1]))
        return np.asarray(np.exp(np.interp(h, np.log(self.height), np.log(self.share))))

    def unseen(self, height: ArrayLike, density: ArrayLike) -> Array:
        """Return how many rocks above a height stand unseen on a square metre (...).

        Rocks are counted by the area of their tops; one is missed by samples that fall at random
        with probability ``exp(-density * top)``.

        Parameters
        ----------
        height
            m; less than the curve's least counts as that.
        density
            Samples on a square metre, broadcast against `height`.
        """
        h = np.clip(np.asarray(height, dtype=np.float64), self.height[0], self.height[-1])
        top = _TOP * h * h
        return self.at(h) / top * np.exp(-np.asarray(density, dtype=np.float64) * top)


def height_curve(
    rises: ArrayLike, noise: float, limit: float, cover: float, height_ratio: float = 0.5
) -> HeightCurve:
    """Return the share of the ground above each height, from samples and the mission's rock law.

    Parameters
    ----------
    rises
        Heights of samples above the ground about them (n,), m.
    noise
        Standard deviation of a sample, m.
    limit
        The lander's roughness limit, m.
    cover, height_ratio
        Of the Golombek law that the mission expects, and of its rocks.
    """
    height = limit * _HEIGHTS
    expected = law_share(height, cover, height_ratio)
    counted = limit * _COUNTED
    counted = counted[counted >= _NOISE * noise]
    if not counted.size:
        counted = limit * _COUNTED[-1:]
    z = np.asarray(rises, dtype=np.float64)
    above = (z[:, None] > counted).sum(axis=0)
    law = np.exp(np.interp(np.log(counted), np.log(height), np.log(expected)))
    found = (above + _PRIOR_SAMPLES * law) / (z.size + _PRIOR_SAMPLES)
    # Beyond what can be counted the law's own shape goes on from there.
    times = np.interp(np.log(height), np.log(counted), np.log(found / law))
    share = np.minimum(expected * np.exp(times), _MOST)
    return HeightCurve(height, np.minimum.accumulate(share))


def law_share(height: ArrayLike, cover: float, height_ratio: float) -> Array:
    """Return the share of ground that rocks of the Golombek law raise above heights (n,), m.

    Rocks are half ellipsoids as wide as they lie on the ground, `height_ratio` times as high.
    """
    h = np.asarray(height, dtype=np.float64)[:, None]
    number = golombek_number(_DIAMETERS, cover)
    diameter = np.sqrt(_DIAMETERS[1:] * _DIAMETERS[:-1])
    top = height_ratio * diameter
    area = 0.25 * np.pi * diameter**2 * np.clip(1.0 - (h / top) ** 2, 0.0, None)
    return np.asarray(np.maximum((area * (number[:-1] - number[1:])).sum(axis=1), 1e-12))
