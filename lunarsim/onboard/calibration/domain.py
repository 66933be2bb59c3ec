"""Domain of a calibrated probability: the range of sites that its fit covers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.onboard.calibration.calibration_files import CalibrationTable
from lunarsim.onboard.calibration.evidence import CalibrationEvidence
from lunarsim.typing import BoolArray

# Quantile of the fit's sites that limits quantities without a natural limit.
_COVERED_QUANTILE = 0.99
# Noise and spacing are constant over a map, and there are few maps: factor by which their range is
# extended.
_RANGE_FACTOR = 1.25
# Minimum limits of the domain: below these, the expected numbers no longer matter.
_MIN_HAZARDS_LIMIT = 1e-3
_MIN_TILTING_LIMIT = 1e-2


@dataclass(frozen=True)
class CalibrationDomain:
    """Range of map and site properties in which a calibration is valid.

    Attributes
    ----------
    hazards, tilting
        Maximum expected number of unobserved rocks in a footprint above the roughness limit, and of
        rocks under the pads that tilt the lander too far.
    noise
        Minimum and maximum standard deviation of a sample over the lander's roughness limit.
    spacing
        Minimum and maximum distance between neighbouring samples over the radius of the legs.

    Raises
    ------
    InputError
        If a number is negative or not finite, or a minimum exceeds its maximum.
    """

    hazards: float
    tilting: float
    noise: tuple[float, float]
    spacing: tuple[float, float]

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not (np.isfinite(value).all() and np.min(value) >= 0.0):
                raise InputError(f"domain.{f.name}", value, "must be 0 or more and finite")
            if np.ndim(value) and value[0] > value[1]:
                raise InputError(
                    f"domain.{f.name}", value, "must be a minimum and a maximum, in this order"
                )

    @classmethod
    def of(
        cls, hazards: ArrayLike, tilting: ArrayLike, noise: ArrayLike, spacing: ArrayLike
    ) -> CalibrationDomain:
        """Return the domain that covers nearly all of the given sites.

        It includes 99 % of their hazards and of their tilting. The ranges of their noise and
        spacing are extended by a factor of 1.25.

        Parameters
        ----------
        hazards, tilting
            Expected number of unobserved rocks above the roughness limit, and of rocks that tilt
            the lander too far, of each site (n,).
        noise, spacing
            Noise over the roughness limit, and sample spacing over the radius of the legs, of each
            site (n,). At least one site.
        """
        h, t = (float(np.quantile(np.asarray(v), _COVERED_QUANTILE)) for v in (hazards, tilting))
        ranges = [
            (float(np.min(v)) / _RANGE_FACTOR, float(np.max(v)) * _RANGE_FACTOR)
            for v in (noise, spacing)
        ]
        return cls(max(h, _MIN_HAZARDS_LIMIT), max(t, _MIN_TILTING_LIMIT), *ranges)

    @classmethod
    def parsed(cls, table: CalibrationTable) -> CalibrationDomain:
        """Return the domain stored in a table of a calibration file."""
        return cls(
            table.number("hazards"), table.number("tilting"),
            table.range("noise"), table.range("spacing"),
        )  # fmt: skip

    def contains(self, evidence: CalibrationEvidence) -> BoolArray:
        """Return which sites of a map are observed and in the domain, in the map's shape."""
        e = evidence
        return np.asarray(
            e.observed
            & e.is_consistent
            & self.is_within_measurements(e.noise_ratio, e.spacing_ratio)
            & self.is_within_counts(e.expected_hazards, e.expected_tilt_violations)
        )

    def is_within_measurements(self, noise: ArrayLike, spacing: ArrayLike) -> BoolArray:
        """Return whether relative noise and spacing (...) are in the range of the fit.

        `noise` is over the roughness limit, `spacing` over the radius of the legs.
        """
        n, s = np.asarray(noise), np.asarray(spacing)
        inside = (self.noise[0] <= n) & (n <= self.noise[1])
        return np.asarray(inside & (self.spacing[0] <= s) & (s <= self.spacing[1]))

    def is_within_counts(self, hazards: ArrayLike, tilting: ArrayLike) -> BoolArray:
        """Return whether few enough unobserved rocks are expected (...); False for NaN.

        `hazards` and `tilting` (...) are the expected numbers of rocks above the roughness limit
        and of rocks that tilt the lander too far, compared with the limits of the domain.
        """
        with np.errstate(invalid="ignore"):
            return np.asarray(
                (np.asarray(hazards) <= self.hazards) & (np.asarray(tilting) <= self.tilting)
            )
