"""LiDAR returns of a flight as a PLY point cloud."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.local_frame import scans_in_site_frame
from lunarsim.simulation import Flight


def write_point_cloud(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write the recorded LiDAR returns in the site frame as binary PLY.

    The vertices have the properties x, y, z, m, and time, s. Each scan is moved by the error of the
    estimated position at its time, so that it lies on the true terrain except for errors of range
    and attitude. The options have no effect.

    Raises
    ------
    InputError
        If the record has no scans.
    """
    scans = scans_in_site_frame(flight)
    if not len(scans):
        raise InputError(
            "--format", "pointcloud", "needs LiDAR scans, but the record has none", show_value=False
        )
    properties = "".join(f"property double {name}\n" for name in ("x", "y", "z", "time"))
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        "comment site frame of lunarsim: x east, y north, z up, m; time in s\n"
        f"element vertex {len(scans)}\n{properties}end_header\n"
    )
    data = head.encode() + np.ascontiguousarray(scans, dtype="<f8").tobytes()
    atomic_write(out, lambda part: part.write_bytes(data))
