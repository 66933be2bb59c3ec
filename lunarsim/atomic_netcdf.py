"""Write NetCDF files atomically.

HDF5 ends the process with a segmentation fault if it cannot close a file on a full disk. The file
is therefore created in memory and written by Python.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lunarsim.atomic_files import atomic_write

if TYPE_CHECKING:
    import xarray as xr


def atomic_write_netcdf(
    path: Path, dataset: xr.Dataset, encoding: Mapping[Hashable, Mapping[str, Any]] | None = None
) -> None:
    """Write an xarray dataset as a NetCDF file atomically (complete or absent).

    Parameters
    ----------
    path
        File to write.
    dataset
        Contents of the file.
    encoding
        Compression of each variable, in the format of `xarray.Dataset.to_netcdf`.
    """
    data = dataset.to_netcdf(engine="h5netcdf", encoding=dict(encoding or {}))
    atomic_write(path, lambda part: part.write_bytes(data))
