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

from lunarsim.rocks.laws import golombek_number

Array = NDArray[np.float64]

# Heights at which the share is kept, over the lander's roughness limit.
_HEIGHTS = np.geomspace(0.08, 8.0, 40)
# Heights at which samples are counted, over the limit; those within the noise are left out.
_COUNTED = np.array([0.4, 0.6, 0.8, 1.0])
# The same for gravel, which tilts a lander on a slope; the regressions were fitted without.
_GRAVEL = np.array([0.2, 0.3, 0.4, 0.6, 0.8, 1.0])
_NOISE = 3.5
# The rock law counts as much as this many samples.
_PRIOR_SAMPLES = 60.0
_MOST = 0.5
# Cover of holes over that of rocks, before any sample.
_HOLES = 0.1
# Diameters of the law, m.
_DIAMETERS = np.geomspace(0.04, 6.0, 240)
# Rocks are taken to be as high as this share of their width: most are flatter and show more.
_TALLEST = 0.8
# Of the most rocks that a share lets stand: where it falls as a power of 3 to 6 of the height.
_OF_MOST = 0.25
# Samples thin rocks of heights H above h out as if H^2 / h^2 - 1 had this mean.
_SPREAD = 1.0 / 3.0
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
    counted
        Least height above which samples were counted for it, m; 0: all.
    gravel, gravel_counted
        Share (n,) by counts of low rises too, and the least height of these; None: the other
        holds for all heights.
    """

    height: Array
    share: Array
    counted: float = 0.0
    gravel: Array | None = None
    gravel_counted: float = 0.0

    @cached_property
    def careful(self) -> HeightCurve:
        """The same with gravel as it was counted, and no less than the law's below that.

        That there are few high rocks says nothing of low ones.
        """
        return self if self.gravel is None else HeightCurve(self.height, self.gravel)

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

        A rock that is half an ellipsoid of height H raises ``a (H^2 - x^2)`` of ground above a
        height x, a = pi / (4 ratio^2). So no more than ``S(x) / (a (h^2 - x^2))`` are higher than
        h, whichever x below h is taken; the least of these counts, and of it what a share that
        falls as a power of x would have. A sample misses what stands above h of a rock with
        probability ``exp(-density a (H^2 - h^2))``: of a rock that is hardly higher nearly always.
        With H^2 - h^2 spread exponentially, as of a law, that leaves
        ``1 / (1 + density a mean)``. Never falls as `height` or `density` does, nor where the share
        rises at any height: neither more rocks nor higher ones ever make it less.

        Parameters
        ----------
        height
            m; less than twice the curve's least counts as that.
        density
            Samples on a square metre, broadcast against `height`.
        """
        h = np.clip(np.asarray(height, dtype=np.float64), 2.0 * self.height[0], self.height[-1])
        area = 0.25 * np.pi / _TALLEST**2
        tops, log_most = self._most
        most = np.exp(np.interp(np.log(h), np.log(tops), log_most))
        seen = np.asarray(density, dtype=np.float64) * area * _SPREAD * h * h
        return np.asarray(most / (1.0 + seen))

    def sunk(self, depth: ArrayLike, density: ArrayLike, width: float) -> Array:
        """Return how many holes that deep no sample has met, on a square metre (...).

        For a curve of how far the ground lies below that about it. Holes are counted as squares of
        a width (m), the least that matters: narrower ones swallow nothing.

        Parameters
        ----------
        depth
            m; less than the curve's least counts as that.
        density
            Samples on a square metre, broadcast against `depth`.
        width
            m.
        """
        area = width * width
        missed = np.exp(-np.asarray(density, dtype=np.float64) * area)
        return np.asarray(self.at(depth) / area * missed)

    @cached_property
    def _most(self) -> tuple[Array, Array]:
        """Heights (n,), m, and the logarithm of how many rocks are higher on a square metre."""
        area = 0.25 * np.pi / _TALLEST**2
        h = np.geomspace(2.0 * self.height[0], self.height[-1], 2 * len(self.height))
        below = np.minimum(self.height, 0.95 * h[:, None])
        most = self.at(below) / (area * (h[:, None] ** 2 - below**2))
        return h, np.log(_OF_MOST * most.min(axis=1) + 1e-12)


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
    law = law_share(height, cover, height_ratio)
    z = np.asarray(rises, dtype=np.float64)
    times, counted = _times_law(z, noise, limit * _COUNTED, height, law)
    lower, least = _times_law(z, noise, limit * _GRAVEL, height, law)
    lower = np.where(height < least, np.maximum(lower, 1.0), lower)
    share = _falling(law * times)
    return HeightCurve(height, share, counted, _falling(np.maximum(law * lower, share)), least)


def _falling(share: Array) -> Array:
    """Return shares (n,) that are possible and fall with height."""
    return np.asarray(np.minimum.accumulate(np.minimum(share, _MOST)))


def _times_law(
    z: Array, noise: float, counted: Array, height: Array, law: Array
) -> tuple[Array, float]:
    """Return how many times the law's share stands above heights (n,), and the least counted.

    Samples count above some heights, of which those within the noise are left out; beyond these
    the law's own shape goes on from there.
    """
    above_noise = counted[counted >= _NOISE * noise]
    counted = above_noise if above_noise.size else counted[-1:]
    above = (z[:, None] > counted).sum(axis=0)
    expected = np.exp(np.interp(np.log(counted), np.log(height), np.log(law)))
    found = (above + _PRIOR_SAMPLES * expected) / (z.size + _PRIOR_SAMPLES)
    times = np.interp(np.log(height), np.log(counted), np.log(found / expected))
    return np.exp(times), float(counted[0])


def depth_curve(
    rises: ArrayLike, noise: float, limit: float, cover: float, height_ratio: float = 0.5
) -> HeightCurve:
    """Return the share of the ground that lies deeper than each depth below that about it.

    As `height_curve`. The mission says nothing of holes: some are expected all the same, a tenth of
    what rocks are.
    """
    return height_curve(-np.asarray(rises), noise, limit, _HOLES * cover, height_ratio)


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
