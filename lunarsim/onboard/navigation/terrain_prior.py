"""Prior knowledge of the terrain height before any measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.value_checks import check_finite

# Name of the block of the terrain height relative to the target elevation, and the length (m) that
# scales its random walk: over this distance heights differ by the slope times this length.
TERRAIN = "ground"
_LENGTH_SCALE_M = 10.0
# Exponent of the height difference over a distance in metres, for a slope measured over 1 m: lunar
# mare up to a kilometre (Rosenburg et al. 2011; highland is rougher, 0.95).
_HURST_EXPONENT = 0.76
# Minimum standard deviation of the terrain height, m.
_MIN_HEIGHT_SIGMA_M = 0.1


@dataclass(frozen=True)
class TerrainPrior:
    """Prior estimate of the terrain height, used to interpret ranges to the terrain.

    Attributes
    ----------
    elevation
        Estimated elevation of the terrain, m.
    sigma
        Standard deviation of the terrain height below the initial position, m; if None, the
        elevation is exact everywhere.
    relief
        Tangent of the typical terrain slope.
    """

    elevation: float = 0.0
    sigma: float | None = 10.0
    relief: float = float(np.tan(np.deg2rad(5.0)))

    def __post_init__(self) -> None:
        for name, value in (("sigma", self.sigma), ("relief", self.relief)):
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"terrain_prior.{name}", value, "must be 0 or more, and finite")
        check_finite("terrain_prior.elevation", self.elevation)

    @classmethod
    def of(cls, briefing: Briefing, relief: float) -> TerrainPrior:
        """Return the prior terrain height below the initial position of a flight.

        The estimate is the target elevation. Its error combines the elevation error stated in the
        briefing and the height difference over the distance to the target; `relief` is the tangent
        of the slope over 1 m.
        """
        distance = float(np.linalg.norm((briefing.start.position - briefing.target)[:2]))
        rise = relief * distance**_HURST_EXPONENT
        sigma = float(np.hypot(briefing.start.target_elevation_sigma, rise))
        return cls(float(briefing.target[2]), max(sigma, _MIN_HEIGHT_SIGMA_M), relief)

    @property
    def growth(self) -> float:
        """Growth of the variance of a terrain-height difference with distance, m^2/m."""
        return self.relief**2 * _LENGTH_SCALE_M
