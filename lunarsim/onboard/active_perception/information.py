"""Information that an observation gives about a hazard under the lander.

Rocks are a Poisson field, so the expected number of each size that reaches into the footprint of
the lander is known. An observation misses a rock at a rate that depends on its sharpness. The
presence of a rock (X) and its detection (Y) are input and output of a Z-channel without false
detections. Their mutual information divided by the entropy of X is the fraction of uncertainty
that the observation removes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.rocks.size_distribution import golombek_cover
from lunarsim.typing import Array

MAX_ROCK_DIAMETER_M = 4.0  # maximum rock diameter, m
_SIZES = 16


def entropy(p: ArrayLike) -> Array:
    """Return the entropy of binary events with given probabilities (...), bits.

    Examples
    --------
    >>> entropy([0.0, 0.5, 1.0]).tolist()
    [0.0, 1.0, 0.0]
    """
    p = np.clip(np.asarray(p, dtype=np.float64), 0.0, 1.0)
    q = 1.0 - p
    # The subtraction from 0.0 avoids a result of -0.0.
    return 0.0 - (p * np.log2(np.where(p > 0.0, p, 1.0)) + q * np.log2(np.where(q > 0.0, q, 1.0)))


@dataclass(frozen=True)
class ExpectedRocks:
    """Expected density of rocks in classes of size.

    Attributes
    ----------
    radius
        Radius of each class, ascending (n,), m.
    number
        Expected number of rocks of each class per area (n,), 1/m^2.
    """

    radius: Array
    number: Array

    @classmethod
    def golombek(cls, cover: float, min_diameter: float) -> ExpectedRocks:
        """Return the rocks of Golombek's size distribution from a minimum diameter to 4 m.

        Parameters
        ----------
        cover
            Fraction k of the terrain covered by rocks of any size.
        min_diameter
            Minimum diameter, m.

        Raises
        ------
        InputError
            If the cover is not a fraction, or the diameter is not between 0 and 4 m.
        """
        if not 0.0 < min_diameter < MAX_ROCK_DIAMETER_M:
            raise InputError(
                "min_diameter",
                min_diameter,
                f"must be more than 0 and less than {MAX_ROCK_DIAMETER_M:g} m",
            )
        edges = np.geomspace(min_diameter, MAX_ROCK_DIAMETER_M, _SIZES + 1)
        diameter = np.sqrt(edges[1:] * edges[:-1])
        cover_above = golombek_cover(edges, cover)
        number = (cover_above[:-1] - cover_above[1:]) / (0.25 * np.pi * diameter**2)
        return cls(0.5 * diameter, number)

    def count_reaching(self, footprint: float) -> Array:
        """Return the expected number of rocks of each class that reach into a disc (n,).

        `footprint` is the radius of the disc, m.
        """
        return np.asarray(self.number * np.pi * (self.radius + footprint) ** 2)

    def hazard_probability(self, footprint: float) -> float:
        """Return the probability that at least one rock reaches into a disc.

        `footprint` is the radius of the disc, m.
        """
        return float(-np.expm1(-self.count_reaching(footprint).sum()))


def removed_uncertainty(
    rocks: ExpectedRocks,
    footprint: float,
    miss_rate: Callable[[Array], Array],
    sharpness: ArrayLike,
) -> Array:
    """Return the fraction of hazard uncertainty that an observation removes (...).

    The fraction, from 0 to 1, is ``[H(h (1 - m)) - h H(m)] / H(h)``, with the entropy H, the
    probability h of a hazard and the probability m of missing it.

    Parameters
    ----------
    rocks
        Rocks that are hazards.
    footprint
        Radius of the disc that must be free of rocks, m.
    miss_rate
        Function that returns the miss rate of rocks, from radius times sharpness (..., n).
    sharpness
        Sharpness of the observations (...): size of a rock of 1 m radius in the measure of
        `miss_rate`, for instance in pixels.
    """
    weight = rocks.count_reaching(footprint)
    s = np.asarray(sharpness, dtype=np.float64)[..., None]
    m = (miss_rate(s * rocks.radius) * weight).sum(-1) / weight.sum()
    h = rocks.hazard_probability(footprint)
    information = entropy(h * (1.0 - m)) - h * entropy(m)
    return np.asarray(np.clip(information / entropy(h), 0.0, 1.0))
