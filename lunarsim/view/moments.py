"""State of a recorded flight at any time, interpolated between control cycles."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from lunarsim.simulation.columns import vector_columns
from lunarsim.simulation.flight import Flight
from lunarsim.typing import Array
from lunarsim.view.chase_view import Moment


class FlightMoments:
    """True states of a recorded flight at any time.

    Positions are cubic between control cycles, attitudes turn at a constant rate, and the site is
    that of the last cycle.

    Parameters
    ----------
    flight
        Record of the flight.
    """

    def __init__(self, flight: Flight) -> None:
        t = flight.trajectory
        # A flight that ends in its first cycle has one row, and an interrupted one may repeat it.
        self._time, rows = np.unique(t["time"], return_index=True)
        position, velocity = flight.positions[rows], vector_columns(t, "velocity")[rows]
        self._attitudes = Rotation.from_quat(vector_columns(t, "attitude", "xyzw")[rows])
        self._is_single = len(rows) == 1
        if self._is_single:
            self._position, self._velocity = position, velocity
        else:
            self._path = CubicHermiteSpline(self._time, position, velocity)
            self._turn = Slerp(self._time, self._attitudes)
        self._scalars = {name: t[name][rows] for name in ("mass", "thrust")}
        estimated = np.column_stack([t[f"estimated_{axis}"] for axis in "xyz"])[rows]
        self.local_sites = flight.sites[rows]
        self.local_errors = estimated - position

    @property
    def duration(self) -> float:
        """Duration of the flight, s."""
        return float(self._time[-1])

    def row(self, time: float) -> int:
        """Return the last row of the trajectory at or before a time, s."""
        return max(int(np.searchsorted(self._time, time + 1e-9)) - 1, 0)

    def at(self, time: float) -> Moment:
        """Return the state at a time, s; times outside the flight give its start or end."""
        time = float(np.clip(time, self._time[0], self._time[-1]))
        mass, thrust = (float(np.interp(time, self._time, v)) for v in self._scalars.values())
        if self._is_single:
            position, velocity = self._position[0], self._velocity[0]
            attitude: Array = self._attitudes.as_quat()[0]
        else:
            position, velocity = self._path(time), self._path(time, 1)
            attitude = self._turn(time).as_quat()
        row = self.row(time)
        site = self.local_sites[row] - self.local_errors[row]
        is_flying = time < self._time[-1]
        return Moment(position, velocity, attitude, mass, thrust, site, is_flying)
