"""Rasters in the site frame as GeoTIFF, with a place on the Moon if it is known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lunarsim.atomic_files import atomic_write
from lunarsim.grid import Grid
from lunarsim.world.ephemeris import MOON_RADIUS_M

if TYPE_CHECKING:
    from lunarsim.exports.frames_and_times import ExportFrame

_LOCAL = 'LOCAL_CS["lunarsim site frame, ENU",UNIT["metre",1.0]]'


def write_geotiff(
    out: Path,
    bands: Mapping[tuple[str, str], NDArray[np.float32]],
    grid: Grid,
    frame: ExportFrame | None = None,
) -> None:
    """Write rasters of the site frame as one GeoTIFF atomically.

    Parameters
    ----------
    out
        File to write.
    bands
        Values (rows, cols), row 0 south, by description and unit; NaN: no data.
    grid
        Positions of the values, site frame.
    frame
        Frame fixed to the Moon, which places the site. The reference system is then azimuthal
        equidistant about the site on a sphere of 1,737,400 m. None: a local reference system.
    """
    import rasterio  # noqa: PLC0415  (loads slowly)
    from rasterio.io import MemoryFile  # noqa: PLC0415

    west, _, _, north = grid.extent
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=grid.cols, height=grid.rows, count=len(bands), dtype="float32",
            crs=rasterio.CRS.from_wkt(_LOCAL if frame is None else _moon_crs(frame)),
            nodata=np.nan, compress="deflate", predictor=3,
            transform=rasterio.Affine(grid.posting, 0.0, west, 0.0, -grid.posting, north),
        ) as file:  # fmt: skip
            for k, ((description, _), values) in enumerate(bands.items(), 1):
                file.write(values[::-1], k)
                file.set_band_description(k, description)
            file.units = tuple(unit for _, unit in bands)
        data = bytes(memory.getbuffer())
    atomic_write(out, lambda part: part.write_bytes(data))


def _moon_crs(frame: ExportFrame) -> str:
    """Return the reference system about the site of a frame as WKT."""
    latitude, longitude = np.rad2deg([frame.latitude, frame.longitude])
    return (
        'PROJCS["Moon, azimuthal equidistant about the landing site",GEOGCS["GCS_Moon_2000",'
        f'DATUM["D_Moon_2000",SPHEROID["Moon_2000_IAU_IAG",{MOON_RADIUS_M:.1f},0.0]],'
        'PRIMEM["Reference_Meridian",0.0],UNIT["Degree",0.0174532925199433]],'
        'PROJECTION["Azimuthal_Equidistant"],'
        f'PARAMETER["latitude_of_center",{latitude:.9f}],'
        f'PARAMETER["longitude_of_center",{longitude:.9f}],'
        'PARAMETER["false_easting",0.0],PARAMETER["false_northing",0.0],UNIT["metre",1.0]]'
    )
