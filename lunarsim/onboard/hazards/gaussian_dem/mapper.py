"""The Gaussian DEM mapper: LiDAR scans in, `HazardMap` out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.gaussian_dem.gaussian import GaussianDem, fuse, gaussian_dem
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper, map_grid
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import quantity
from lunarsim.safety import plane_stochastic_safety, stochastic_safety

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GaussianDemMapping:
    """A Gaussian DEM of LiDAR returns, judged by a stochastic safety test.

    Attributes
    ----------
    sensor
        Whose scans it maps.
    posting, size
        Of the map, m.
    safety
        "level" or "planes", see `GaussianDemMapper`.
    sigma_f, length_scale
        Hyper-parameters of the random field, m.
    """

    sensor: str = quantity("flash", help="whose scans it maps")
    posting: float = quantity(0.2, "m", gt=0, help="side of a cell of the map")
    size: float = quantity(100.0, "m", gt=0, help="side of the square about the target")
    safety: Literal["level", "planes"] = quantity(
        "level", help="Eqs. 15 to 17 of the paper, or through the real support planes"
    )
    sigma_f: float = quantity(0.5, "m", gt=0, help="deviation of the random field")
    length_scale: float = quantity(30.0, "m", gt=0, help="of the random field")

    takes: ClassVar[type] = LidarScan

    def build(self, briefing: Briefing, navigation: Navigation) -> GaussianDemMapper:
        """Return the mapper of one flight."""
        return GaussianDemMapper(
            map_grid(briefing.target, self.size, self.posting, briefing.lander),
            briefing.lander,
            sigma_f=self.sigma_f,
            length_scale=self.length_scale,
            safety=self.safety,
        )


class GaussianDemMapper(HazardMapper):
    """Fuses flash LiDAR scans into a Gaussian DEM and judges landing safety on it.

    Parameters
    ----------
    grid
        The cells of the map, in the estimated ENU frame.
    lander
        Geometry and limits.
    sigma_f, length_scale
        Hyper-parameters of the random field, m.
    safety
        ``"level"``: the conservative test of Eqs. 15 to 17. ``"planes"``: through the real
        support planes, which keeps safe sites on relief.
    """

    def __init__(
        self,
        grid: Grid,
        lander: Lander,
        *,
        sigma_f: float = 0.5,
        length_scale: float = 30.0,
        safety: Literal["level", "planes"] = "level",
    ) -> None:
        self.grid = grid
        self.lander = lander
        self.sigma_f = sigma_f
        self.length_scale = length_scale
        self.safety = safety
        self.dem: GaussianDem | None = None
        self._map = HazardMap.unobserved(grid)

    def update(self, measurement: LidarScan, estimate: Estimate) -> None:
        """Add a scan taken at the estimated pose; a scan without returns changes nothing."""
        points = measurement.points(estimate.position, estimate.attitude)
        if not np.isfinite(points).all(axis=1).any():
            return
        scan = gaussian_dem(
            points,
            self.grid,
            sigma_f=self.sigma_f,
            length_scale=self.length_scale,
            sigma_eps=max(float(np.nanmedian(measurement.sigma)), 1e-4),
            image_shape=measurement.shape,
        )
        self.dem = scan if self.dem is None else fuse(self.dem, scan)
        seen = np.where(self.dem.observed, self.dem.mean, np.float32(np.nan))
        judge = plane_stochastic_safety if self.safety == "planes" else stochastic_safety
        safety = judge(seen, self.dem.variance, self.grid, self.lander)
        self._map = HazardMap(
            self.grid, safety.p_safe, safety.observed, self.dem.mean, self.dem.variance
        )

    def hazard_map(self) -> HazardMap:
        """Return the map as it stands."""
        return self._map

    @property
    def blank(self) -> bool:
        """Whether no scan had a return yet."""
        return self.dem is None

    def recentre(self, centre: Array) -> None:
        """Lay the map about another point (3,), local frame, m."""
        self.grid = self.grid.about(centre)
        self._map = HazardMap.unobserved(self.grid)
