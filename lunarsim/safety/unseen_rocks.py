"""What may stand between the samples of a map: rocks that no return has met.

The share of samples that rise above the ground about them by more than a height is the share of
the ground that does, whatever the spacing: it needs no rock to be resolved. Where nothing, or
little, was seen, the mission's rock law counts as much as a few samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

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
# Rocks are taken to be as high as this share of their width: most are flatter and show more.
_TALLEST = 0.8
# Samples on a square metre for which `missed` is tabled.
_DENSITIES = np.geomspace(0.1, 2000.0, 40)
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

    def missed(self, height: ArrayLike, density: ArrayLike) -> Array:
        """Return how many rocks above a height no sample has met there, on a square metre (...).

        With rocks that are half ellipsoids of one shape, the share of ground above a height h is
        the sum over rocks of ``a (H^2 - h^2)``, a = pi / (4 ratio^2); so that
        ``-dS/dh / (2 a h)`` of them are higher. A sample misses what stands above h of a rock with
        probability ``exp(-density a (H^2 - h^2))``: of a rock that is hardly higher nearly always.
        Never falls as `height` does.

        Parameters
        ----------
        height
            m; less than the curve's least counts as that.
        density
            Samples on a square metre, broadcast against `height`.
        """
        h, rho = np.broadcast_arrays(np.asarray(height, float), np.asarray(density, float))
        top, table = self._missed_table
        at = (
            np.interp(np.log(np.clip(h, top[0], top[-1])), np.log(top), np.arange(len(top))),
            np.interp(np.log(np.clip(rho, _DENSITIES[0], _DENSITIES[-1])), np.log(_DENSITIES),
                      np.arange(len(_DENSITIES))),
        )  # fmt: skip
        found = ndimage.map_coordinates(table, [a.ravel() for a in at], order=1, mode="nearest")
        return np.asarray(np.exp(found).reshape(h.shape))

    @cached_property
    def _missed_table(self) -> tuple[Array, Array]:
        """Logarithm of `missed` at heights (n,) and `_DENSITIES` (n, m)."""
        area = 0.25 * np.pi / _TALLEST**2
        h = np.geomspace(self.height[0], self.height[-1], 4 * len(self.height))
        share = self.at(h)
        steepness = -np.gradient(np.log(share), np.log(h))
        higher = np.maximum(steepness, 0.0) * share / (2.0 * area * h * h)
        # Fewer are higher than a greater height.
        higher = np.maximum.accumulate(higher[::-1])[::-1]
        number, middle = higher[:-1] - higher[1:], np.sqrt(h[:-1] * h[1:])
        seen = area * np.maximum(middle**2 - h[:, None] ** 2, 0.0)
        alone = np.where(middle > h[:, None], number, 0.0)
        table = np.stack([(alone * np.exp(-d * seen)).sum(axis=1) for d in _DENSITIES], axis=-1)
        table = np.maximum.accumulate(table[::-1])[::-1]
        return h, np.log(table + 1e-12)


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
