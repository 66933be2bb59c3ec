"""Hazard maps of a flight as GeoTIFF."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lunarsim.errors import InputError
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.frames_and_times import moon_frame
from lunarsim.exports.geotiff import write_geotiff
from lunarsim.simulation import Flight


def write_maps(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write the last hazard map of each mapper as ``NAME.tif`` into the folder `out`.

    The bands are p_safe, no data where not observed, and the elevation above the origin of the site
    frame, no data where unknown. Maps are moved by their error, so that they lie on the true
    terrain.

    Raises
    ------
    InputError
        If the record has no maps.
    """
    if not flight.maps:
        raise InputError(
            "--format", "maps", "needs hazard maps, but the record has none", show_value=False
        )
    frame = moon_frame(flight, options.longitude)
    out.mkdir(parents=True, exist_ok=True)
    for name, record in flight.maps.items():
        found, (x, y, z) = record.hazard_map, record.error
        height = np.full(found.grid.shape, np.nan) if found.elevation is None else found.elevation
        bands = {
            ("p_safe", "1"): np.where(found.observed, found.p_safe, np.nan).astype(np.float32),
            ("elevation above the origin of the site frame", "m"): (height - z).astype(np.float32),
        }
        grid = replace(found.grid, x0=found.grid.x0 - x, y0=found.grid.y0 - y)
        write_geotiff(out / f"{name}.tif", bands, grid, frame)
