"""Hazard mapping by external software."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.interface.structs import Struct
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.instruments import CameraInstrument, LidarInstrument
from lunarsim.onboard.external.encode import MeasurementWriter, write_estimate, write_grid
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.onboard.external.settings import Connection, LibrarySoftware, ProcessSoftware
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper, is_off_centre, map_grid
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


class ExternalMapper(HazardMapper):
    """Mapper of one flight in external software, which writes the layers of the map.

    Parameters
    ----------
    connection
        Connection to the software.
    grid
        Cells of the map.
    sensor
        Name of the sensor whose measurements the software gets.
    writer
        Writer of the measurements.
    """

    def __init__(
        self, connection: Connection, grid: Grid, sensor: str, writer: MeasurementWriter
    ) -> None:
        self._connection, self._sensor, self._writer = connection, sensor, writer
        self._given, self._answer = Struct("MapperInput"), Struct("MapperOutput")
        self._reset(grid)

    def _reset(self, grid: Grid) -> None:
        """Start an empty map on a grid."""
        self._grid, self._is_empty = grid, True
        write_grid(self._given.parts["grid"], grid)
        self._given.attach(
            p_safe=np.zeros(grid.shape, np.float32),
            observed=np.zeros(grid.shape, np.uint8),
            elevation=np.full(grid.shape, np.nan, np.float32),
        )
        self._map = HazardMap.unobserved(grid)

    def update(self, measurement: Any, estimate: Estimate) -> None:
        """Let the software add one measurement to the map.

        Raises
        ------
        SoftwareFailure
            If the software fails.
        """
        write_estimate(self._given.parts["estimate"], estimate)
        is_scan = isinstance(measurement, LidarScan)
        for name, is_used in (("lidar_scan", is_scan), ("camera_image", not is_scan)):
            for element in self._given.resize_list(name, int(is_used)):
                self._writer.write_one(element, self._sensor, measurement)
        self._answer.clear()
        self._connection.step(self._given, self._answer)
        if not self._answer.get("changed"):
            return
        layers = {name: array.copy() for name, array in self._given.arrays.items()}
        p_safe = layers["p_safe"]
        if not ((p_safe >= 0.0) & (p_safe <= 1.0)).all():
            raise SoftwareFailure("mapper", "invalid-output", "p_safe is not between 0 and 1")
        self._is_empty = False
        observed = layers["observed"] != 0
        self._map = HazardMap(
            self._grid, np.where(observed, p_safe, np.float32(0.0)), observed, layers["elevation"]
        )

    def hazard_map(self) -> HazardMap:
        """Return the current hazard map."""
        return self._map

    @property
    def is_empty(self) -> bool:
        """Whether the map does not contain any measurement yet."""
        return self._is_empty

    def recentre(self, centre: Array) -> None:
        """Move the map to another centre (3,), local frame, m, if it is too far from it.

        A map that is moved starts empty; an empty map is always moved.
        """
        if self._is_empty or is_off_centre(self._grid, centre):
            self._reset(self._grid.about(centre))

    def close(self) -> None:
        """End the software."""
        self._connection.close()


@dataclass(frozen=True)
class _Mapper:
    """Settings of a mapper in external software."""

    sensor: str = quantity("flash", help="LiDAR or camera whose measurements the software maps")
    size: float = quantity(60.0, "m", gt=0, help="side of the square map")
    posting: float = quantity(0.25, "m", gt=0, help="side of a map cell")

    accepts: ClassVar[type] = object

    def build(self, briefing: Briefing, navigation: Navigation) -> ExternalMapper:
        """Build the mapper of one flight.

        Raises
        ------
        InputError
            If the sensor is neither a LiDAR nor a camera, or the map or the software is unsuitable.
        """
        if not isinstance(
            briefing.instruments.get(self.sensor), LidarInstrument | CameraInstrument
        ):
            raise InputError("sensor", self.sensor, "must name a LiDAR or a camera")
        grid = map_grid(briefing.target, self.size, self.posting, briefing.lander)
        connection = self.connect("mapper", briefing)  # type: ignore[attr-defined]
        return ExternalMapper(
            connection, grid, self.sensor, MeasurementWriter(tuple(briefing.instruments))
        )


@dataclass(frozen=True)
class LibraryMapper(_Mapper, LibrarySoftware):
    """Hazard mapping by a shared library."""


@dataclass(frozen=True)
class ProcessMapper(_Mapper, ProcessSoftware):
    """Hazard mapping by a program."""
