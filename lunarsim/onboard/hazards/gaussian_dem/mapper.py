"""The Gaussian DEM mapper: LiDAR scans in, `HazardMap` out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.gaussian_dem.pooled import PooledDem, pooled_dem
from lunarsim.onboard.hazards.gaussian_dem.samples import SamplePool
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper, map_grid
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety import bounded_safety, plane_stochastic_safety, stochastic_safety
from lunarsim.safety.calibration import Evidence, calibrated_safety
from lunarsim.safety.unseen_rocks import height_curve

Array = NDArray[np.float64]
Judgement = Literal["calibrated", "level", "planes"]


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
        See `GaussianDemMapper`.
    """

    sensor: str = quantity("flash", help="whose scans it maps")
    posting: float = quantity(0.2, "m", gt=0, help="side of a cell of the map")
    size: float = quantity(100.0, "m", gt=0, help="side of the square about the target")
    safety: Judgement = quantity(
        "calibrated",
        help="a frequency, Eqs. 15 to 17 of the paper, or these through the real support planes",
    )

    takes: ClassVar[type] = LidarScan

    def build(self, briefing: Briefing, navigation: Navigation) -> GaussianDemMapper:
        """Return the mapper of one flight."""
        return GaussianDemMapper(
            map_grid(briefing.target, self.size, self.posting, briefing.lander),
            briefing.lander,
            safety=self.safety,
            rocks=briefing.rocks,
        )


class GaussianDemMapper(HazardMapper):
    """Pools flash LiDAR scans into a Gaussian DEM and judges landing safety on it.

    Parameters
    ----------
    grid
        The cells of the map, in the estimated ENU frame.
    lander
        Geometry and limits.
    safety
        ``"calibrated"``: how often such sites are safe, and a bound where that is not known; see
        `lunarsim.safety.calibration`. ``"level"``: the conservative test of Eqs. 15 to 17.
        ``"planes"``: through the real support planes, which keeps safe sites on relief.
    rocks
        What the mission expects; left out, its defaults.
    """

    def __init__(
        self,
        grid: Grid,
        lander: Lander,
        *,
        safety: Judgement = "calibrated",
        rocks: RockExpectation | None = None,
    ) -> None:
        if safety not in {"calibrated", "level", "planes"}:
            raise InputError("safety", safety, "calibrated, level or planes")
        self.grid = grid
        self.lander = lander
        self.safety = safety
        self.rocks = rocks or RockExpectation()
        self.pool = SamplePool(grid)
        self._map: HazardMap | None = HazardMap.unobserved(grid)

    def update(self, measurement: LidarScan, estimate: Estimate) -> None:
        """Add a scan taken at the estimated pose; a scan without returns changes nothing."""
        points = measurement.points(estimate.position, estimate.attitude)
        taken = self.pool.add(
            points,
            measurement.height_sigma(estimate.attitude),
            measurement.spacing(estimate.attitude),
        )
        if taken:
            self._map = None

    def dem(self) -> PooledDem:
        """Return mean and variance of the elevation."""
        return pooled_dem(self.pool)

    def hazard_map(self) -> HazardMap:
        """Return the map as it stands; it is drawn when it is asked for."""
        if self._map is None:
            self._map = self._draw(self.dem())
        return self._map

    def _draw(self, dem: PooledDem) -> HazardMap:
        seen = np.where(dem.observed, dem.mean, np.float32(np.nan))
        map_of = (seen, dem.variance, self.grid, self.lander)
        if self.safety == "calibrated":
            evidence = evidence_of(dem, self.lander, self.rocks)
            p, known = calibrated_safety(evidence)
            return HazardMap(
                self.grid, p, evidence.observed, dem.mean, dem.variance, in_domain=known
            )
        judge = plane_stochastic_safety if self.safety == "planes" else stochastic_safety
        safety = judge(*map_of)
        return HazardMap(self.grid, safety.p_safe, safety.observed, dem.mean, dem.variance)

    @property
    def blank(self) -> bool:
        """Whether no return has fallen on the map yet."""
        return self.pool.base is None

    def recentre(self, centre: Array) -> None:
        """Lay the map about another point (3,), local frame, m."""
        self.grid = self.grid.about(centre)
        self.pool = SamplePool(self.grid)
        self._map = HazardMap.unobserved(self.grid)


def evidence_of(dem: PooledDem, lander: Lander, rocks: RockExpectation) -> Evidence:
    """Return what a map says of its sites.

    Parameters
    ----------
    dem
        The map.
    lander
        Geometry and limits.
    rocks
        What the mission expects.
    """
    seen = np.where(dem.observed, dem.mean, np.float32(np.nan))
    s = dem.sampling
    curve = height_curve(
        s.rises, s.noise, lander.roughness_limit, rocks.cover, rocks.height_ratio[0]
    )
    return Evidence(
        stochastic_safety(seen, dem.variance, dem.grid, lander),
        plane_stochastic_safety(seen, dem.variance, dem.grid, lander),
        bounded_safety(seen, dem.grid, lander),
        lander,
        curve,
        s.density,
        s.noise,
        s.spacing,
    )
