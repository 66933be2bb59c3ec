"""Conversion of records in the onboard local frame to the site frame."""

from __future__ import annotations

import numpy as np

from lunarsim.simulation import Flight
from lunarsim.simulation.columns import vector_columns
from lunarsim.typing import Array


def local_frame_error(flight: Flight, time: Array) -> Array:
    """Return local minus true coordinates (n, 3), m, at times (n,), s.

    It is the error of the estimated position in the local frame, interpolated between control
    cycles; 0 where the estimate is not finite. Errors of the attitude are not included.
    """
    table = flight.trajectory
    error = vector_columns(table, "estimated") - vector_columns(table, "position")
    error = np.nan_to_num(error, nan=0.0, posinf=0.0, neginf=0.0)
    return np.column_stack([np.interp(time, table["time"], e) for e in error.T])


def scans_in_site_frame(flight: Flight) -> Array:
    """Return the LiDAR returns (n, 4) in the site frame: x, y, z, m, and time, s.

    Points that are not finite are omitted.
    """
    scans = flight.scans.astype(np.float64)
    scans = scans[np.isfinite(scans).all(axis=1)]
    scans[:, :3] -= local_frame_error(flight, scans[:, 3])
    return scans
