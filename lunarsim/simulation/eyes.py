"""What a lander navigates and maps by: LiDAR flashes, pictures, or a sweep that locks onto a map.

Each kind owns its navigation and its mapper and is asked once a control cycle whether to measure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.messages.measurements import LidarScan, Picture
from lunarsim.models.gimbal import gimbal_mount
from lunarsim.onboard.hazards.gaussian_dem import GaussianDemMapper
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.quadtree import QuadtreeMapper
from lunarsim.onboard.hazards.shadows import ShadowMapper
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.onboard.navigation.lidar_inertial import LidarInertialFilter
from lunarsim.onboard.navigation.rock_filter import RockFilter
from lunarsim.sensors.navigation_fix import NavigationErrorModel
from lunarsim.simulation import build
from lunarsim.simulation.build_quadtree import (
    lidar_inertial_of,
    prior_map_of,
    quadtree_mapper_of,
)
from lunarsim.simulation.build_shadows import navigation_of, shadow_mapper_of
from lunarsim.vehicle import State

if TYPE_CHECKING:
    from lunarsim.simulation.simulation import Simulation

Array = NDArray[np.float64]


class Eyes(Protocol):
    """Navigation, sensors and mapper of one kind.

    Attributes
    ----------
    navigation
        Where the estimate comes from.
    """

    navigation: Navigation

    def settle(self, sim: Simulation) -> None:
        """Take the attitude that the lander starts with, and draw the empty map."""
        ...

    @property
    def tied_to_map(self) -> bool:
        """Whether sites are given in the frame of a map that navigation finds its place on."""
        ...

    def look(self, sim: Simulation) -> None:
        """Measure, if it is time to."""
        ...

    def sense(self, before: State, history: Array, step: float) -> None:
        """Take in a stretch of true motion: state before, vectors after each step (n, 15)."""
        ...

    def stop(self) -> None:
        """Measure no more."""
        ...

    def hazard_map(self) -> HazardMap:
        """Return the map as it stands."""
        ...

    @property
    def blank(self) -> bool:
        """Whether nothing has been mapped yet."""
        ...


class FlashEyes:
    """LiDAR flashes at given altitudes, a Gaussian DEM, and navigation by its error budget."""

    tied_to_map = False

    def __init__(self, sim: Simulation) -> None:
        self.navigation: Navigation = NavigationErrorModel(
            build.budget_of(sim.scenario), sim.streams.get("navigation")
        )
        self.mapper: GaussianDemMapper
        self._pending = sorted(sim.scenario.lidar.scan_altitudes_m, reverse=True)
        self._rng = sim.streams.get("lidar")

    def settle(self, sim: Simulation) -> None:
        """Draw the empty map about the site."""
        self.mapper = build.mapper_of(sim.scenario, sim.lander, sim.site)

    def look(self, sim: Simulation) -> None:
        """Flash at the site, or straight down, when an altitude is passed."""
        if not self._pending or sim.altitude > self._pending[0]:
            return
        while self._pending and sim.altitude <= self._pending[0]:
            self._pending.pop(0)
        to_site = sim.site - sim.estimate.position
        down = np.array([0.0, 0.0, -1.0])
        boresight = to_site if sim.scenario.lidar.boresight == "site" else down
        scan = flash(sim, boresight, self._rng)
        self.mapper.update(scan, sim.estimate)
        sim.saw(scan)

    def sense(self, before: State, history: Array, step: float) -> None:
        """Do nothing: the error budget needs no inertial samples."""

    def stop(self) -> None:
        """Flash no more."""
        self._pending.clear()

    def hazard_map(self) -> HazardMap:
        """Return the map as it stands."""
        return self.mapper.hazard_map()

    @property
    def blank(self) -> bool:
        """Whether no scan had a return yet."""
        return self.mapper.dem is None


class CameraEyes:
    """Pictures, rocks by their shadows, inertial unit and altimeter."""

    tied_to_map = False

    def __init__(self, sim: Simulation) -> None:
        self._start(sim)
        self.mapper: ShadowMapper
        self._camera = build.camera_of(sim.scenario)
        self._rng = sim.streams.get("camera")
        self._next = 0.0
        self._seen = False

    def _start(self, sim: Simulation) -> None:
        self.filtered = navigation_of(sim.scenario, sim.world, sim.state, sim.ground, sim.streams)
        self.navigation: Navigation = self.filtered

    @property
    def rocks(self) -> RockFilter:
        """The filter that tracks rocks."""
        found = self.filtered.filter
        assert isinstance(found, RockFilter)
        return found

    def settle(self, sim: Simulation) -> None:
        """Start again, with the same draws, about the attitude that the lander starts with."""
        self._start(sim)
        sim.estimate = self.navigation.update(sim.state, sim.time)
        self.mapper = shadow_mapper_of(sim.scenario, sim.lander, sim.site, self.rocks)

    def look(self, sim: Simulation) -> None:
        """Take a picture of the site when one is due, and update filter and map."""
        section = sim.scenario.camera
        if sim.time < self._next - 1e-9 or not 0.0 < sim.altitude <= section.first_altitude_m:
            return
        self._next = sim.time + 1.0 / section.rate_hz
        limit = np.deg2rad(section.gimbal_limit_deg)
        mount = gimbal_mount(sim.estimate.attitude, sim.site - sim.estimate.position, limit)
        camera = replace(self._camera, mount=mount)
        photo = camera.expose(sim.world, sim.state, sim.time, self._rng)
        self.mapper.update(Picture(sim.time, photo.counts, camera.model), sim.estimate)
        # What the picture told of the lander counts at once.
        sim.estimate = self.navigation.update(sim.state, sim.time)
        if not self._seen:
            sim.recorder.event(sim.time, "first-picture", altitude=sim.altitude)
        self._seen = True
        sim.saw(None)

    def sense(self, before: State, history: Array, step: float) -> None:
        """Feed the inertial unit."""
        self.filtered.sense(before, history, step)

    def stop(self) -> None:
        """Take no more pictures: the rest of the flight goes by inertial unit and altimeter."""
        self._next = np.inf

    def hazard_map(self) -> HazardMap:
        """Return the map as it stands."""
        return self.mapper.hazard_map()

    @property
    def blank(self) -> bool:
        """Whether no picture was taken yet."""
        return not self._seen


class SweepEyes:
    """A LiDAR that sweeps the ground, finds its place on a prior map, and fills a quadtree.

    When the sweep is over it dwells on the site.

    Attributes
    ----------
    on_scan
        Called with every scan and the estimate after it, by studies that want to see them.
    """

    tied_to_map = True

    def __init__(self, sim: Simulation) -> None:
        cycle = sim.scenario.simulation.cycle_s
        for name in ("rate_hz", "dwell_rate_hz"):
            rate = getattr(sim.scenario.sweep, name)
            if rate * cycle > 1.0 + 1e-9:
                raise InputError(
                    f"sweep.{name}", rate, f"at most {1.0 / cycle:g}, one flash a control cycle"
                )
        self._prior = prior_map_of(sim.scenario, sim.world, sim.streams)
        self._start(sim)
        self.mapper: QuadtreeMapper
        self._rng = sim.streams.get("lidar")
        self._next = 0.0
        self._flashes = 0
        self._judged = -np.inf
        self._events = 0
        self.on_scan: Callable[[LidarScan, Estimate], None] | None = None

    def _start(self, sim: Simulation) -> None:
        self.filtered = lidar_inertial_of(
            sim.scenario, sim.world, sim.state, self._prior, sim.streams
        )
        self.navigation: Navigation = self.filtered

    @property
    def filter(self) -> LidarInertialFilter:
        """The navigation filter."""
        found = self.filtered.filter
        assert isinstance(found, LidarInertialFilter)
        return found

    def settle(self, sim: Simulation) -> None:
        """Start again, with the same draws, about the attitude that the lander starts with."""
        self._start(sim)
        sim.estimate = self.navigation.update(sim.state, sim.time)
        self.mapper = quadtree_mapper_of(sim.scenario, sim.lander, sim.site)
        self._centre = sim.site.copy()

    def aim(self, sim: Simulation) -> Array:
        """Return the point on the ground to flash at next (3,), ENU, m."""
        section = sim.scenario.sweep
        if sim.time >= section.duration_s:
            return sim.site
        rows = max(2, round(np.sqrt(section.duration_s * section.rate_hz)))
        row, col = divmod(self._flashes, rows)
        # There and back, like an ox that ploughs; over again if flashes are left.
        row %= rows
        col = col if row % 2 == 0 else rows - 1 - col
        step = section.size_m / (rows - 1)
        offset = np.array([row * step, col * step, 0.0]) - 0.5 * section.size_m * np.array(
            [1, 1, 0]
        )
        return np.asarray(self._centre + offset)

    def look(self, sim: Simulation) -> None:
        """Flash when it is time, navigate by it, and add it to the map."""
        section = sim.scenario.sweep
        if sim.time >= self._next - 1e-9 and sim.altitude > section.last_altitude_m:
            rate = section.rate_hz if sim.time < section.duration_s else section.dwell_rate_hz
            self._next = sim.time + 1.0 / rate
            self._flash_once(sim)
        if sim.time >= self._judged + section.update_s - 1e-9:
            self._judged = sim.time
            self.mapper.select()

    def _flash_once(self, sim: Simulation) -> None:
        before = self.filter.estimate(sim.time, sim.state.mass)
        scan = flash(sim, self.aim(sim) - before.position, self._rng)
        self._flashes += 1
        self.filter.update_scan(scan, sim.time)
        after = self.filter.estimate(sim.time, sim.state.mass)
        self.mapper.correct(before, after)
        self.mapper.update(scan, after)
        if self.on_scan is not None:
            self.on_scan(scan, after)
        sim.estimate = after
        for event in self.filter.events[self._events :]:
            moved = float(np.linalg.norm(event.moved))
            sim.recorder.event(event.time, event.name, moved=moved)
            if event.name == "lock" and sim.scenario.guidance.time_to_go_s is None:
                # A path planned from tens of metres off is planned afresh.
                sim.retime()
        self._events = len(self.filter.events)
        sim.saw(scan if self._flashes % 10 == 1 else None)

    def sense(self, before: State, history: Array, step: float) -> None:
        """Feed the inertial unit."""
        self.filtered.sense(before, history, step)

    def stop(self) -> None:
        """Flash no more."""
        self._next = np.inf

    def hazard_map(self) -> HazardMap:
        """Return the map as it was judged last."""
        if self.mapper.selection is None:
            self.mapper.select()
        return self.mapper.last_map()

    @property
    def blank(self) -> bool:
        """Whether no scan has been mapped yet."""
        return self.mapper.map.count == 0


def flash(sim: Simulation, boresight: Array, rng: np.random.Generator) -> LidarScan:
    """Flash along a direction (3,), ENU, as far as gimbal and estimated attitude let it."""
    # The gimbal is steered by the estimated attitude; the true one decides where it looks.
    limit = np.deg2rad(sim.scenario.lidar.gimbal_limit_deg)
    mount = gimbal_mount(sim.estimate.attitude, boresight, limit)
    return sim.lidar.measure(sim.world, sim.state, sim.time, rng, mount)


KINDS: dict[str, Callable[[Simulation], Eyes]] = {
    "gaussian-dem": FlashEyes,
    "shadow": CameraEyes,
    "quadtree": SweepEyes,
}


def eyes_of(sim: Simulation) -> Eyes:
    """Return the kind that the scenario's mapper asks for."""
    return KINDS[sim.scenario.mapper.kind](sim)
