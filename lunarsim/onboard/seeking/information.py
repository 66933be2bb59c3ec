"""How much a look says of whether a hazard lies under the lander.

Rocks are a Poisson field. Of each size so many are expected to reach into the lander's footprint;
a look misses one at a rate that depends on how sharp it is. Whether any is there (X) and whether
the look shows one (Y) are the two ends of a Z-channel: nothing is shown where nothing is. Their
mutual information over the entropy of X is the share of the uncertainty that the look takes away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.rocks.laws import golombek_cover

Array = NDArray[np.float64]

LARGEST = 4.0  # diameter, m
_SIZES = 16


def entropy(p: ArrayLike) -> Array:
    """Return the entropy of events of given probabilities (...), bits.

    Examples
    --------
    >>> entropy([0.0, 0.5, 1.0]).tolist()
    [0.0, 1.0, 0.0]
    """
    p = np.clip(np.asarray(p, dtype=np.float64), 0.0, 1.0)
    q = 1.0 - p
    # Nought, not minus nought, where nothing is uncertain.
    return 0.0 - (p * np.log2(np.where(p > 0.0, p, 1.0)) + q * np.log2(np.where(q > 0.0, q, 1.0)))


@dataclass(frozen=True)
class ExpectedRocks:
    """Rocks of some sizes that are expected.

    Attributes
    ----------
    radius
        Rising (n,), m.
    number
        On a square metre (n,).
    """

    radius: Array
    number: Array

    @classmethod
    def of(cls, cover: float, least_diameter: float) -> ExpectedRocks:
        """Return those of Golombek's law from a diameter (m) on, up to 4 m.

        Parameters
        ----------
        cover
            Share k of the ground under rocks of any size.
        least_diameter
            m.

        Raises
        ------
        InputError
            If the cover is no fraction, or the diameter not from 0 to 4 m.
        """
        if not 0.0 < least_diameter < LARGEST:
            raise InputError("least_diameter", least_diameter, f"more than 0, less than {LARGEST}")
        edges = np.geomspace(least_diameter, LARGEST, _SIZES + 1)
        diameter = np.sqrt(edges[1:] * edges[:-1])
        share = golombek_cover(edges, cover)
        number = (share[:-1] - share[1:]) / (0.25 * np.pi * diameter**2)
        return cls(0.5 * diameter, number)

    def reaching(self, footprint: float) -> Array:
        """Return how many of each size reach into a disc of a radius, m (n,)."""
        return np.asarray(self.number * np.pi * (self.radius + footprint) ** 2)

    def hazard(self, footprint: float) -> float:
        """Return the probability that any reaches into a disc of a radius, m."""
        return float(-np.expm1(-self.reaching(footprint).sum()))


def told_by_look(
    rocks: ExpectedRocks, footprint: float, missed: Callable[[Array], Array], sharpness: ArrayLike
) -> Array:
    """Return the share of the uncertainty that a look of a sharpness takes away (...), 0 to 1.

    ``[H(h (1 - m)) - h H(m)] / H(h)``, h the probability of a hazard and m that of missing it.

    Parameters
    ----------
    rocks
        That are hazards.
    footprint
        Radius of the disc into which none may reach, m.
    missed
        From radius times sharpness (..., n) to the rate at which such rocks are missed.
    sharpness
        Of the looks (...), for a metre of radius.
    """
    weight = rocks.reaching(footprint)
    s = np.asarray(sharpness, dtype=np.float64)[..., None]
    m = (missed(s * rocks.radius) * weight).sum(-1) / weight.sum()
    h = rocks.hazard(footprint)
    told = entropy(h * (1.0 - m)) - h * entropy(m)
    return np.asarray(np.clip(told / entropy(h), 0.0, 1.0))
