"""Events of the flight record for range sensors whose beams miss the map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from lunarsim.frames import quat_rotate
from lunarsim.messages.measurements import Measurements
from lunarsim.models.instruments import AltimeterInstrument, VelocimeterInstrument
from lunarsim.simulation.flight import OFF_MAP, ON_MAP
from lunarsim.vehicle import State
from lunarsim.world import World


class MapEdgeMonitor:
    """Report altimeters and velocimeters whose beams miss the map.

    Parameters
    ----------
    world
        True world. With far terrain, no beam misses the terrain by leaving the map.
    instruments
        Calibrations of the sensors, by name.
    """

    def __init__(self, world: World, instruments: Mapping[str, Any]) -> None:
        self._beams = {
            name: np.atleast_2d(
                i.boresight if isinstance(i, AltimeterInstrument) else i.directions
            )
            for name, i in instruments.items()
            if isinstance(i, AltimeterInstrument | VelocimeterInstrument)
            and world.far_terrain is None
        }  # fmt: skip
        self._bounds = np.array(world.terrain.bounds)
        self._lowest = world.terrain.z_range[0]
        self._off: set[str] = set()

    def events(self, measurements: Measurements, state: State) -> Iterator[dict[str, Any]]:
        """Yield an event for each sensor that begins or ceases to miss the map."""
        for sensor, reading in measurements.items:
            if sensor not in self._beams:
                continue
            found: Any = reading
            is_off = not np.isfinite(found.range).any() and self._misses(sensor, state)
            if is_off != (sensor in self._off):
                self._off ^= {sensor}
                yield {
                    "time": measurements.time, "name": OFF_MAP if is_off else ON_MAP,
                    "sensor": sensor,
                }  # fmt: skip

    def _misses(self, sensor: str, state: State) -> bool:
        """Return whether no beam is over the map at the minimum elevation."""
        beam = quat_rotate(state.attitude, self._beams[sensor])
        beam = beam[beam[:, 2] < 0.0]
        drop = (self._lowest - state.position[2]) / beam[:, 2:]
        foot = state.position[:2] + drop * beam[:, :2]
        west, east, south, north = self._bounds
        over = (np.abs(foot - 0.5 * np.array([west + east, south + north]))
                <= 0.5 * np.array([east - west, north - south])).all(1)  # fmt: skip
        return bool(len(beam) and not over.any())
