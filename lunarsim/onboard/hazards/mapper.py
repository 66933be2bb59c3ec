"""Interfaces of hazard mappers and of their settings; mappers of one flight."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid, check_raster_size
from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.component_errors import prefix_input_errors, wrong_result_error
from lunarsim.onboard.hazards.hazard_map import HazardMap, TerrainSurface
from lunarsim.onboard.hazards.map_evidence import FusionEvidence
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.typing import Array

# Tilt uncertainty (rad, 1 sigma) below which maps are not corrected: 4 cm of height at 50 m.
NEGLIGIBLE_TILT_RAD = float(np.deg2rad(0.05))
# Maximum number of cells along a side of a map.
_MAX_CELLS_PER_SIDE = 8000


class HazardMapper(ABC):
    """Onboard mapper that builds a `HazardMap` from sensor measurements."""

    @abstractmethod
    def update(self, measurement: Any, estimate: Estimate) -> None:
        """Add one measurement, made at the estimated pose of the lander, to the map."""

    def update_from_sensor(self, sensor: str, measurement: Any, estimate: Estimate) -> None:
        """Add one measurement of a named sensor, made at the estimated pose, to the map.

        Mappers of several sensors override this method. The default ignores the sensor name.
        """
        self.update(measurement, estimate)

    @abstractmethod
    def hazard_map(self) -> HazardMap:
        """Return the current hazard map."""

    @property
    @abstractmethod
    def is_empty(self) -> bool:
        """Whether the map does not contain any measurement yet."""

    def terrain_surface(self) -> TerrainSurface:
        """Return the terrain elevations of the current map.

        A mapper that computes elevations before landing safety overrides this method. Until the map
        is recomputed, repeated calls return the same object or an object with the same map.
        """
        return self.hazard_map()

    def recentre(self, centre: Array) -> None:  # noqa: B027
        """Move the map to another centre if its present centre is too far from it.

        Called when navigation has updated the target position. Mapped terrain keeps its
        coordinates; terrain outside the moved map may be dropped. The default does nothing.

        Parameters
        ----------
        centre
            New centre (3,), local frame, m.
        """

    def correct_tilt(self, turn: Array, pivot: Array, tilt_sigma: float) -> None:  # noqa: B027
        """Rotate terrain that was mapped before the tilt of the lander was known.

        Called when navigation has corrected its tilt estimate. Terrain that was mapped while the
        standard deviation of the tilt was at most `NEGLIGIBLE_TILT_RAD` is not rotated. The default
        does nothing.

        Parameters
        ----------
        turn, pivot
            Rotation matrix (3, 3) and the point (3,) about which the terrain is rotated, local
            frame, m.
        tilt_sigma
            Current standard deviation of the tilt, rad.
        """

    def terrain_height(self, xy: Array) -> float | None:
        """Return the terrain height at a point, if the map does not contain elevations.

        The default returns None, for mappers whose map contains the elevations.

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
        """Do the work that is due at a time (s), such as an update of the map.

        Called once per control cycle, after the measurements. The default does nothing.
        """

    def scoreboard(self, site: Array) -> Scoreboard | None:
        """Return the mapper's own ranking of landing sites; None if it ranks none.

        Parameters
        ----------
        site
            Current target site (3,), local frame, m.
        """
        return None

    def evidence(self) -> FusionEvidence | None:
        """Return the measured data behind the map, for fusion with other maps.

        None if there are none yet. A mapper whose settings declare `publishes` overrides this
        method.
        """
        return None

    @property
    def displacement(self) -> Array:
        """Sum of all shifts (3,) of mapped terrain to the positions of newer scans, m.

        Sites that were chosen on the map move with it. The default is zero.
        """
        return np.zeros(3)

    @property
    def source_mappers(self) -> frozenset[str]:
        """Names of the mappers that this mapper fuses; empty if it maps measurements."""
        return frozenset()

    def record_tables(self) -> dict[str, dict[str, Array]]:
        """Return additional tables for the flight record: table name to columns.

        Each table maps column names to arrays (n,); positions are in the local frame.
        """
        return {}


class MapperPart(Protocol):
    """Settings of a hazard mapper, a scenario component selected by `kind`.

    Implementations are frozen dataclasses in the part registry.

    Attributes
    ----------
    accepts
        Type of the measurements that the mapper uses.
    navigation
        Optional: `kind` of the navigation that the mapper requires.
    publishes
        Optional: type of the data that the mapper provides for fusion.
    sensor
        Name of the sensor whose measurements the mapper uses.
    sensors
        Optional: names of several sensors, instead of `sensor`.
    """

    accepts: ClassVar[type]

    @property
    def sensor(self) -> str:
        """Name of the sensor whose measurements the mapper uses."""
        ...

    def build(self, briefing: Briefing, navigation: Navigation) -> HazardMapper:
        """Build the mapper of one flight from the data known before it.

        The map is centred on the target of the briefing. `navigation` is the navigation filter of
        the flight.

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
    """Return whether a point is too far from the map centre to keep the map in place.

    The limit is an eighth of the side of the map along either axis.

    Parameters
    ----------
    grid
        Cells of the map.
    centre
        Desired centre (2,) or (3,), local frame, m.
    """
    west, east, south, north = grid.extent
    distance = np.abs(np.asarray(centre)[:2] - grid.centre)
    return bool((distance > 0.125 * min(east - west, north - south)).any())


def check_map_size(size: float, posting: float, lander: Lander) -> None:
    """Raise InputError if a map is too small, too coarse or too large for the lander.

    Parameters
    ----------
    size, posting
        Sides of the square map and of one cell, m.
    lander
        Lander whose footprint must fit on the map.

    Raises
    ------
    InputError
        Naming ``size_m`` or ``posting_m``.
    """
    if posting > 0.5 * lander.leg_radius:
        raise InputError(
            "posting_m", posting, f"must be at most {0.5 * lander.leg_radius:g} m, half of "
            f"vehicle.leg_radius_m ({lander.leg_radius:g} m)",
        )  # fmt: skip
    if size < 4.0 * lander.leg_radius + 1.0:
        raise InputError(
            "size_m", size, f"must be at least {4.0 * lander.leg_radius + 1.0:g} m, which is 4 "
            f"times vehicle.leg_radius_m ({lander.leg_radius:g} m) plus 1 m",
        )  # fmt: skip
    check_raster_size("size_m", size, posting, _MAX_CELLS_PER_SIDE)


def calibration_path_error(path: Path | str, error: InputError) -> InputError:
    """Convert an error in a calibration file to an error in `calibration_path`.

    `path` is the file and `error` the error raised by the function that reads it. The returned
    error, which the caller raises, names the scenario key `calibration_path`.
    """
    if error.field == "calibration":  # about the file itself
        return error.with_field("calibration_path")
    return InputError("calibration_path", str(path), "must be a valid calibration", str(error))


def map_grid(centre: Array, size: float, posting: float, lander: Lander) -> Grid:
    """Return the cells of a square hazard map centred on a point.

    Parameters
    ----------
    centre
        Centre of the map (2,) or (3,), local frame, m.
    size, posting
        Sides of the square map and of a cell, m.
    lander
        Lander whose footprint must fit on the map.

    Raises
    ------
    InputError
        If the size or the posting is unsuitable, as in `check_map_size`.
    """
    check_map_size(size, posting, lander)
    return Grid.centred(centre, size, posting)


def checked_hazard_map(name: str, part: object, mapper: HazardMapper, time: float) -> HazardMap:
    """Return the hazard map of a mapper, or raise InputError if its type is wrong.

    Parameters
    ----------
    name, part, mapper
        Name of the mapper in the scenario, its settings and the mapper itself.
    time
        Current time for the error message, s.

    Raises
    ------
    InputError
        If the mapper returns another type or fails with an InputError; the error names the mapper.
    """
    table = f"mappers.{name}"
    with prefix_input_errors(table):
        found: Any = mapper.hazard_map()
    if not isinstance(found, HazardMap):
        raise wrong_result_error(table, part, "hazard_map", found, "a HazardMap", time)
    return found


def build_mappers(briefing: Briefing, navigation: Navigation) -> dict[str, HazardMapper]:
    """Build all mappers of a flight; return them by name, in the briefing's order.

    Mappers that use other mappers are built after them. `navigation` is the navigation filter of
    the flight.

    Raises
    ------
    InputError
        If a mapper cannot be built; the error names it.
    """
    parts, mappers = briefing.software.mappers, dict[str, HazardMapper]()
    for name, part in sorted(parts.items(), key=lambda item: _build_stage(item[1])):
        others = (mappers,) if _build_stage(part) else ()
        with prefix_input_errors(f"mappers.{name}"):
            mappers[name] = part.build(briefing, navigation, *others)
    return {name: mappers[name] for name in parts}


def _build_stage(part: Any) -> int:
    """Return the build order of a mapper from its settings: 0 is built first.

    2 for a mapper that fuses others (`inputs`), 1 for a mapper that uses the elevations of another
    (`terrain_mapper`), otherwise 0.
    """
    if hasattr(part, "inputs"):
        return 2
    return 1 if getattr(part, "terrain_mapper", "") else 0
