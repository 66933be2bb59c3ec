"""Interfaces of hazard mappers and of their settings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_raster_size
from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.error_prefix import prefix_input_errors
from lunarsim.onboard.hazards.hazard_map import HazardMap, TerrainSurface
from lunarsim.onboard.hazards.map_evidence import FusionEvidence
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.onboard.result_checks import wrong_result_error

Array = NDArray[np.float64]

# Tilt uncertainty (rad, 1 sigma) below which maps are not corrected: 4 cm of height at 50 m.
NEGLIGIBLE_TILT_RAD = float(np.deg2rad(0.05))
# Maximum number of cells along a side of a map.
_MAX_CELLS_PER_SIDE = 8000


class HazardMapper(ABC):
    """Build a `HazardMap` from measurements."""

    @abstractmethod
    def update(self, measurement: Any, estimate: Estimate) -> None:
        """Process one measurement made at the estimated pose."""

    def take(self, sensor: str, measurement: Any, estimate: Estimate) -> None:
        """Process one measurement of a named sensor made at the estimated pose.

        Mappers of several sensors override this method. The default ignores the sensor name.
        """
        self.update(measurement, estimate)

    @abstractmethod
    def hazard_map(self) -> HazardMap:
        """Return the current map."""

    @property
    @abstractmethod
    def blank(self) -> bool:
        """Whether nothing has been mapped yet."""

    def surface(self) -> TerrainSurface:
        """Return the terrain elevations of the current map.

        A mapper that can provide elevations before it has evaluated their safety overrides this
        method. Until the map is recomputed, the method returns the same object or one with the same
        map.
        """
        return self.hazard_map()

    def recentre(self, centre: Array) -> None:  # noqa: B027
        """Move the map to another centre if the present centre is too far from it.

        Called when navigation has updated the target position. Mapped terrain keeps its
        coordinates; terrain outside the new map may be dropped.

        Parameters
        ----------
        centre
            New centre (3,), local frame, m.
        """

    def level(self, turn: Array, pivot: Array, tilt_sigma: float) -> None:  # noqa: B027
        """Rotate terrain that was mapped before the tilt of the lander was known.

        Called when navigation has corrected the tilt. Terrain that was mapped with a tilt known to
        `NEGLIGIBLE_TILT_RAD` stays.

        Parameters
        ----------
        turn, pivot
            Rotation (3, 3) about a point (3,), local frame, m.
        tilt_sigma
            Present standard deviation of the tilt, rad.
        """

    def terrain_height(self, xy: Array) -> float | None:
        """Return the terrain height at a point if the map itself does not state it.

        The default returns None: the map states the height in the local frame.

        Parameters
        ----------
        xy
            Point (2,), local frame, m.

        Returns
        -------
        height
            Local frame, m; None if the map states the height.
        """
        return None

    def refresh(self, time: float) -> None:  # noqa: B027
        """Do the work due at `time` (s); called once per cycle, after the measurements."""

    def scoreboard(self, site: Array) -> Scoreboard | None:
        """Return the mapper's own ranking of sites; None if it ranks none.

        Parameters
        ----------
        site
            Current target site (3,), local frame, m.
        """
        return None

    def evidence(self) -> FusionEvidence | None:
        """Return the evidence behind the map, for fusion with other maps.

        None if there is none yet. A mapper whose part declares `publishes` overrides this method.
        """
        return None

    @property
    def sources(self) -> frozenset[str]:
        """Names of the mappers whose evidence it fuses; empty if it maps measurements."""
        return frozenset()

    def tables(self) -> dict[str, dict[str, Array]]:
        """Return additional tables for the record: name to columns (n,), local frame."""
        return {}


class MapperPart(Protocol):
    """Settings of a mapper, as a frozen dataclass in the part registry.

    Attributes
    ----------
    takes
        Type of the measurements that it maps.
    navigation
        Optional: navigation part that the mapper requires.
    publishes
        Optional: type of the evidence that it provides for fusion.
    sensor
        Name of the sensor whose measurements it maps.
    sensors
        Optional: names of several sensors, instead of `sensor`.
    """

    takes: ClassVar[type]

    @property
    def sensor(self) -> str:
        """Name of the sensor whose measurements it maps."""
        ...

    def build(self, briefing: Briefing, navigation: Navigation) -> HazardMapper:
        """Return the mapper of one flight, with its map centred on the target.

        Raises
        ------
        InputError
            If the map is smaller than the footprint of the lander or its posting is too coarse.
        """
        ...


def sensor_names(part: Any) -> tuple[str, ...]:
    """Return the names of the sensors whose measurements a mapper uses; empty if none.

    Parameters
    ----------
    part
        Settings of the mapper, a `MapperPart`.
    """
    several = getattr(part, "sensors", ())
    if several:
        return tuple(several)
    return (part.sensor,) if part.sensor else ()


def is_off_centre(grid: Grid, centre: Array) -> bool:
    """Return whether a point lies too far from the map centre to keep the map.

    The limit is an eighth of the side along either axis.

    Parameters
    ----------
    grid
        Cells of the map.
    centre
        Point (2,) or (3,), local frame, m.
    """
    west, east, south, north = grid.extent
    distance = np.abs(np.asarray(centre)[:2] - grid.centre)
    return bool((distance > 0.125 * min(east - west, north - south)).any())


def check_map_size(size: float, posting: float, lander: Lander) -> None:
    """Reject a map that is smaller than the footprint, too coarse or too large.

    Parameters
    ----------
    size, posting
        Sides of the square map and of a cell, m.
    lander
        Lander that the map is for.

    Raises
    ------
    InputError
        Naming ``size_m`` or ``posting_m``.
    """
    if posting > 0.5 * lander.leg_radius:
        raise InputError("posting_m", posting, f"must be at most {0.5 * lander.leg_radius} m")
    if size < 4.0 * lander.leg_radius + 1.0:
        raise InputError("size_m", size, f"must be at least {4.0 * lander.leg_radius + 1.0:.1f} m")
    check_raster_size("size_m", size, posting, _MAX_CELLS_PER_SIDE)


def map_grid(centre: Array, size: float, posting: float, lander: Lander) -> Grid:
    """Return the cells of a hazard map centred on a point.

    Raises
    ------
    InputError
        If the size or the posting is unsuitable, as in `check_map_size`.
    """
    check_map_size(size, posting, lander)
    return Grid.centred(centre, size, posting)


def checked_hazard_map(name: str, part: object, mapper: HazardMapper, time: float) -> HazardMap:
    """Return the hazard map of a mapper after checking its type.

    Parameters
    ----------
    name, part, mapper
        Name, settings and mapper.
    time
        Time for the error message, s.

    Raises
    ------
    InputError
        If the mapper returns another type or a map with invalid arrays; the error names the mapper.
    """
    table = f"mappers.{name}"
    with prefix_input_errors(table):
        found: Any = mapper.hazard_map()
    if not isinstance(found, HazardMap):
        raise wrong_result_error(table, part, "hazard_map", found, "a HazardMap", time)
    return found
