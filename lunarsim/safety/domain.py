"""Where a calibrated probability is a frequency: how far its fit has seen."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError

# Of the sites of a fit, so many lie within what has no end by itself.
_QUANTILE = 0.99
# Noise and spacing are those of a map, of which there are few: so many times beyond them counts as
# seen.
_WIDER = 1.25
# With fewer unseen hazards than this it no longer matters how many, nor with fewer rocks that tilt.
_LEAST_HAZARDS = 1e-3
_LEAST_TILTING = 1e-2


@dataclass(frozen=True)
class Domain:
    """Sites like those of a fit.

    Attributes
    ----------
    hazards, tilting
        Most unseen rocks that may be expected in a footprint and under the pads, see `Evidence`.
    noise
        Least and greatest standard deviation of a sample over the lander's roughness limit.
    spacing
        Least and greatest distance of neighbouring samples over the radius of the legs.

    Raises
    ------
    InputError
        If a number is not finite or negative, or a range ends before it begins.
    """

    hazards: float
    tilting: float
    noise: tuple[float, float]
    spacing: tuple[float, float]

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not (np.isfinite(value).all() and np.min(value) >= 0.0):
                raise InputError(f"domain.{f.name}", value, "finite, and at least 0")
            if np.ndim(value) and value[0] > value[1]:
                raise InputError(f"domain.{f.name}", value, "a least and a greatest number")

    @classmethod
    def of(
        cls, hazards: ArrayLike, tilting: ArrayLike, noise: ArrayLike, spacing: ArrayLike
    ) -> Domain:
        """Return the domain that sites (n,) cover: nearly all of them, and a little beyond.

        Parameters
        ----------
        hazards, tilting, noise, spacing
            As of the attributes, of each site; at least one site.
        """
        h, t = (float(np.quantile(np.asarray(v), _QUANTILE)) for v in (hazards, tilting))
        ranges = [(float(np.min(v)) / _WIDER, float(np.max(v)) * _WIDER) for v in (noise, spacing)]
        return cls(max(h, _LEAST_HAZARDS), max(t, _LEAST_TILTING), *ranges)

    def measured(self, noise: ArrayLike, spacing: ArrayLike) -> NDArray[np.bool_]:
        """Tell where noise and spacing (...) are as in the fit."""
        n, s = np.asarray(noise), np.asarray(spacing)
        inside = (self.noise[0] <= n) & (n <= self.noise[1])
        return np.asarray(inside & (self.spacing[0] <= s) & (s <= self.spacing[1]))

    def few(self, hazards: ArrayLike, tilting: ArrayLike) -> NDArray[np.bool_]:
        """Tell where few enough rocks can stand unseen (...); nowhere where that is NaN."""
        with np.errstate(invalid="ignore"):
            return np.asarray(
                (np.asarray(hazards) <= self.hazards) & (np.asarray(tilting) <= self.tilting)
            )
