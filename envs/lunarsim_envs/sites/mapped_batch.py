"""Simulate many landers in kernels with simulated scans and Gaussian DEM maps."""

from __future__ import annotations

from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.onboard.hazards.gaussian_dem.mapper import GaussianDemMapperSettings
from lunarsim.onboard.hazards.mapper import map_grid
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.scenario import Scenario
from lunarsim.typing import BoolArray
from lunarsim.vehicle import State
from lunarsim_envs.sites import _map_kernels as m
from lunarsim_envs.sites.batch import SiteDescentBatch
from lunarsim_envs.sites.field_of_view import deciding_mapper


class MappedDescentBatch(SiteDescentBatch):
    """Landers that fly in parallel with simulated scans and ``gaussian-dem`` maps.

    Unlike `SiteDescentBatch`, which samples map errors from a statistical model, LiDAR scans of the
    terrain are simulated and mapped. Arguments are those of `SiteDescentBatch`, except
    that the grid spacing is always that of the mapper.

    Raises
    ------
    InputError
        If decisions of the scenario use another kind of mapper.
    """

    def __init__(self, count: int, scenario: Scenario, *arguments: Any, **settings: Any) -> None:
        part = gaussian_dem_of(scenario)
        self._part, self._scenario = part, scenario
        self._lidar = scenario.sensors[part.sensor].make()
        self._rocks = scenario.expected_rocks.make()
        self._mappers: list[GaussianDemMapper | None] = [None] * count
        super().__init__(count, scenario, *arguments, **(settings | {"posting": part.posting}))

    def begin(self, mask: BoolArray) -> None:
        """Start new flights of the landers of `mask` (n,); fly to their first decisions."""
        for lane in np.flatnonzero(mask):
            self._mappers[int(lane)] = None
        super().begin(mask)

    def scan(self, due: BoolArray) -> None:
        """Simulate a LiDAR scan for the landers of `due` (n,) and update their maps."""
        for lane in np.flatnonzero(due):
            self._simulate_scan(int(lane))
        m.record_scans(due, self.time, self.guidance, self.maps)

    def _simulate_scan(self, i: int) -> None:
        """Simulate a LiDAR scan of lander `i` and update its map."""
        mapper = self._mappers[i]
        if mapper is None:
            mapper = self._mappers[i] = GaussianDemMapper(
                map_grid(self.target[i], self._part.size, self._part.posting, self.lander),
                self.lander, safety=self._part.safety, refit=self._part.calibration(),
                rocks=self._rocks,
            )  # fmt: skip
        y, time = self.y[i], float(self.time[i])
        place, velocity = (one[i] for one in self.estimated_state)
        seed = (int(self._keys[i]), int(self._flight_counts[i]), int(self.guidance.scan_count[i]))
        limit = self._lidar.calibration().gimbal_limit
        mount = gimbal_mount(y[6:10], self.guidance.site[i] - place, limit)
        scan: LidarScan = self._lidar.measure(
            self.pool.worlds[self.world[i]], State.from_vector(y), time,
            np.random.default_rng(seed), mount,
        )  # fmt: skip
        covariance = np.zeros((9, 9))
        mapper.update(
            scan,
            Estimate(time, place, velocity, y[6:10].copy(), y[10:13].copy(), y[13], covariance),
        )
        mapper.refresh(time)
        drawn = mapper.hazard_map()
        self.maps.corner[i] = drawn.grid.x0, drawn.grid.y0
        self.maps.p[i] = np.where(drawn.observed, drawn.p_safe, np.float32(0.0))
        self.maps.seen[i] = drawn.observed
        if drawn.elevation is not None:
            self.maps.height[i] = drawn.elevation

    @property
    def lander(self) -> Any:
        """Parameters of the lander: masses, engine, geometry and limits."""
        return self.craft.dynamics.lander


def gaussian_dem_of(scenario: Scenario) -> GaussianDemMapperSettings:
    """Return the settings of the mapper that decisions use, a Gaussian DEM mapper.

    Raises
    ------
    InputError
        If decisions use another kind of mapper.
    """
    name = deciding_mapper(scenario)
    part = scenario.mappers[name].make()
    if not isinstance(part, GaussianDemMapperSettings):
        kind = scenario.mappers[name].kind
        raise InputError(
            f"mappers.{name}.kind", kind,
            "must be 'gaussian-dem' for this perception",
            "Otherwise use perception='onboard'.",
        )  # fmt: skip
    return part
