"""Rocks that may stand between the samples of a map.

The fraction of samples above a height over the surrounding terrain estimates the fraction of
terrain above it at any sample spacing; rocks need not be resolved. Where few or no samples are
above, the mission's rock distribution has the weight of a number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.rocks.field import Shape
from lunarsim.rocks.size_distribution import golombek_number
from lunarsim.typing import Array

# Heights at which the fraction is tabulated, over the lander's roughness limit.
_HEIGHTS = np.geomspace(0.08, 8.0, 40)
# Heights at which samples are counted, over the limit; those within the noise are omitted.
_COUNT_HEIGHTS = np.array([0.4, 0.6, 0.8, 1.0])
# The same including gravel, which tilts a lander on a slope; the regressions were fitted without.
_GRAVEL_COUNT_HEIGHTS = np.array([0.2, 0.3, 0.4, 0.6, 0.8, 1.0])
# Minimum counted height over the noise of a sample.
_MIN_HEIGHT_SIGMAS = 3.5
# Weight of the rock distribution, in samples.
_PRIOR_SAMPLES = 60.0
_MAX_FRACTION = 0.5
# Cover of holes over that of rocks, before any sample.
_HOLE_COVER_RATIO = 0.1
# Diameters of the distribution, m.
_DIAMETERS = np.geomspace(0.04, 6.0, 240)
# Assumed height of rocks over their width: most are flatter and cover more terrain.
_ROCK_HEIGHT_RATIO = 0.8
# Number of rocks over the maximum compatible with a fraction, if the fraction falls with the 3rd to
# 6th power of the height.
_FRACTION_OF_MAX = 0.25
# Effective mean of H^2 / h^2 - 1 for the heights H of the rocks above h.
_SPREAD = 1.0 / 3.0
# Area of rocks above a height h over the base of a rock of height h: most are a little wider.
_TOP_RATIO = 1.5
# The same for faceted rocks, whose tops are narrower: the mean area above h of irregular rocks is
# 0.6 of that of half ellipsoids, for Golombek distributions with 2 to 10 % cover.
_FACETED_TOP_RATIO = 0.6 * _TOP_RATIO


@dataclass(frozen=True)
class ExceedanceCurve:
    """Fraction of the terrain that rises above its surroundings by more than a height.

    Attributes
    ----------
    height
        Increasing heights (n,), m.
    share
        Fraction of the terrain above each height (n,), decreasing.
    min_counted_height
        Minimum height at which samples were counted, m; 0: all heights.
    gravel, min_counted_gravel_height
        Fraction (n,) that also uses counts at low heights, and the minimum height of these, m;
        None: `share` applies to all heights.
    rock_height_ratio
        Expected height of the rocks over their diameter.
    top_ratio
        Mean area of the rocks above a height over the base of a rock of this height.
    """

    height: Array
    share: Array
    min_counted_height: float = 0.0
    gravel: Array | None = None
    min_counted_gravel_height: float = 0.0
    rock_height_ratio: float = 0.5
    top_ratio: float = _TOP_RATIO

    @cached_property
    def with_gravel(self) -> ExceedanceCurve:
        """Curve that also uses counts of samples at low heights (gravel).

        On a slope, low rocks too can tilt the lander too far. Below the counted heights, the curve
        is at least the rock distribution that the mission expects: few high rocks do not imply few
        low rocks. Without `gravel`, it is this curve itself.
        """
        if self.gravel is None:
            return self
        return replace(self, share=self.gravel, min_counted_height=0.0, gravel=None)

    def at(self, height: ArrayLike) -> Array:
        """Return the fraction of terrain above heights (...), m.

        Heights are clipped to the range of the curve.
        """
        h = np.log(np.clip(np.asarray(height, dtype=np.float64), self.height[0], self.height[-1]))
        return np.asarray(np.exp(np.interp(h, np.log(self.height), np.log(self.share))))

    def unseen_rocks(self, height: ArrayLike, density: ArrayLike) -> Array:
        """Return the number of unseen rocks above a height, per square metre (...).

        The number is the fraction of terrain above the height, divided by the area `top` of a
        rock's top, times the probability ``exp(-density * top)`` that random samples miss a rock.
        The top is `top_ratio` times the base of a rock of this height and the expected height
        ratio.

        Parameters
        ----------
        height
            Height, m; clipped to the curve.
        density
            Samples per square metre, broadcast against `height`.
        """
        h = np.clip(np.asarray(height, dtype=np.float64), self.height[0], self.height[-1])
        top = self.top_ratio * 0.25 * np.pi * (h / self.rock_height_ratio) ** 2
        return self.at(h) / top * np.exp(-np.asarray(density, dtype=np.float64) * top)

    def missed_rocks(self, height: ArrayLike, density: ArrayLike) -> Array:
        """Return an upper estimate of rocks above a height that samples miss, per m^2.

        The result has the shape (...) of both arguments broadcast.

        A rock that is half an ellipsoid of height H raises ``a (H^2 - x^2)`` of terrain above a
        height x, a = pi / (4 ratio^2). Hence at most ``S(x) / (a (h^2 - x^2))`` rocks are higher
        than h, for every x below h; the minimum over x is used, multiplied by a constant for a
        fraction that is a power of x. A sample misses the part of a rock above h with probability
        ``exp(-density a (H^2 - h^2))``: rocks slightly higher than h are nearly always missed. With
        an exponential distribution of H^2 - h^2, this gives ``1 / (1 + density a mean)``. The
        result never increases with `height` or `density`, and never decreases where the fraction
        increases at any height: neither more nor higher rocks ever reduce it.

        Parameters
        ----------
        height
            Height, m; at least twice the curve's minimum.
        density
            Samples per square metre, broadcast against `height`.
        """
        h = np.clip(np.asarray(height, dtype=np.float64), 2.0 * self.height[0], self.height[-1])
        area = 0.25 * np.pi / _ROCK_HEIGHT_RATIO**2
        tops, log_most = self._max_numbers
        max_number = np.exp(np.interp(np.log(h), np.log(tops), log_most))
        seen = np.asarray(density, dtype=np.float64) * area * _SPREAD * h * h
        return np.asarray(max_number / (1.0 + seen))

    def missed_holes(self, depth: ArrayLike, density: ArrayLike, width: float) -> Array:
        """Return the number of holes deeper than a depth that all samples miss, per m^2.

        The curve must be the fraction of terrain deeper than each depth. Holes are counted as
        squares of the minimum relevant width: a pad does not sink into narrower holes.

        Parameters
        ----------
        depth
            Depth, m; clipped to the curve.
        density
            Samples per square metre, broadcast against `depth`.
        width
            Minimum relevant width of a hole, m.
        """
        area = width * width
        missed = np.exp(-np.asarray(density, dtype=np.float64) * area)
        return np.asarray(self.at(depth) / area * missed)

    @cached_property
    def _max_numbers(self) -> tuple[Array, Array]:
        """Heights (n,), m, and the log of the upper estimate of higher rocks per m^2 (n,).

        The estimate is `_FRACTION_OF_MAX` times the maximum number compatible with the curve.
        """
        area = 0.25 * np.pi / _ROCK_HEIGHT_RATIO**2
        h = np.geomspace(2.0 * self.height[0], self.height[-1], 2 * len(self.height))
        below = np.minimum(self.height, 0.95 * h[:, None])
        max_number = self.at(below) / (area * (h[:, None] ** 2 - below**2))
        return h, np.log(_FRACTION_OF_MAX * max_number.min(axis=1) + 1e-12)


def height_curve(
    rises: ArrayLike,
    noise: float,
    limit: float,
    cover: float,
    height_ratio: float = 0.5,
    shape: Shape = "hemisphere",
) -> ExceedanceCurve:
    """Return the fraction of terrain above each height, from samples and a prior.

    Heights are above the surrounding terrain. The prior is the rock distribution that the mission
    expects; it has the weight of 60 samples.

    Parameters
    ----------
    rises
        Heights of samples above the surrounding terrain (n,), m.
    noise
        Standard deviation of a sample, m.
    limit
        The lander's roughness limit, m.
    cover, height_ratio, shape
        Fraction of the terrain covered by rocks in the Golombek distribution that the mission
        expects, and height over diameter and shape of its rocks.
    """
    height = limit * _HEIGHTS
    law = distribution_fraction(height, cover, height_ratio)
    z = np.asarray(rises, dtype=np.float64)
    times, counted = _ratio_to_distribution(z, noise, limit * _COUNT_HEIGHTS, height, law)
    lower, min_counted = _ratio_to_distribution(
        z, noise, limit * _GRAVEL_COUNT_HEIGHTS, height, law
    )
    lower = np.where(height < min_counted, np.maximum(lower, 1.0), lower)
    share = _non_increasing(law * times)
    return ExceedanceCurve(
        height, share, counted, _non_increasing(np.maximum(law * lower, share)), min_counted,
        height_ratio, _FACETED_TOP_RATIO if shape in ("irregular", "mixed") else _TOP_RATIO,
    )  # fmt: skip


def _non_increasing(share: Array) -> Array:
    """Reduce fractions (n,) so that none exceeds the previous or `_MAX_FRACTION`."""
    return np.asarray(np.minimum.accumulate(np.minimum(share, _MAX_FRACTION)))


def _ratio_to_distribution(
    sample_heights: Array, noise: float, counted: Array, height: Array, distribution: Array
) -> tuple[Array, float]:
    """Return the ratio of counted samples to the rock distribution, by height (n,).

    `sample_heights` are heights above the surrounding terrain with standard deviation `noise`, m.
    Samples are counted above each of the heights `counted`, except those within the noise; below
    and above these heights the ratio is constant. `distribution` (n,) is the distribution's
    fraction of terrain above each `height` (n,). The second result is the minimum height at which
    samples were counted, m.
    """
    above_noise = counted[counted >= _MIN_HEIGHT_SIGMAS * noise]
    counted = above_noise if above_noise.size else counted[-1:]
    above = (sample_heights[:, None] > counted).sum(axis=0)
    expected = np.exp(np.interp(np.log(counted), np.log(height), np.log(distribution)))
    found = (above + _PRIOR_SAMPLES * expected) / (sample_heights.size + _PRIOR_SAMPLES)
    times = np.interp(np.log(height), np.log(counted), np.log(found / expected))
    return np.exp(times), float(counted[0])


def depth_curve(
    rises: ArrayLike, noise: float, limit: float, cover: float, height_ratio: float = 0.5
) -> ExceedanceCurve:
    """Return the fraction of terrain deeper than each depth below its surroundings.

    The mission does not specify holes; it is assumed that holes cover a tenth of the area that
    rocks cover.

    Parameters
    ----------
    rises
        Heights of samples above the surrounding terrain (n,), m; negative in holes.
    noise
        Standard deviation of a sample, m.
    limit
        The lander's roughness limit, m.
    cover, height_ratio
        Fraction of the terrain covered by rocks in the Golombek distribution that the mission
        expects, and height over diameter of its rocks.
    """
    return height_curve(-np.asarray(rises), noise, limit, _HOLE_COVER_RATIO * cover, height_ratio)


def distribution_fraction(height: ArrayLike, cover: float, height_ratio: float) -> Array:
    """Return the fraction of terrain higher than each height because of rocks (n,).

    `height` (n,) is in m; `cover` is the fraction of terrain covered by rocks of the Golombek
    distribution. Rocks are half ellipsoids with circular outlines, `height_ratio` times as high as
    wide. The result is at least 1e-12, so that its logarithm exists.
    """
    h = np.asarray(height, dtype=np.float64)[:, None]
    number = golombek_number(_DIAMETERS, cover)
    diameter = np.sqrt(_DIAMETERS[1:] * _DIAMETERS[:-1])
    top = height_ratio * diameter
    area = 0.25 * np.pi * diameter**2 * np.clip(1.0 - (h / top) ** 2, 0.0, None)
    return np.asarray(np.maximum((area * (number[:-1] - number[1:])).sum(axis=1), 1e-12))
