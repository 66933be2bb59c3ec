"""Checks of netCDF files that GDAL omits: links to other files, and axes.

GDAL assumes that the last dimension points east and that the axes are evenly spaced.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rasterio.io import DatasetReader

from lunarsim.errors import InputError, error_reason
from lunarsim.world.terrain.raster_heights import metres_in

# Tolerance over one step: coordinates may be rounded to single precision.
_MAX_UNEVENNESS = 0.1
_EAST_NAMES = {"projection_x_coordinate", "longitude", "grid_longitude", "x", "lon", "easting"}
_NORTH_NAMES = {"projection_y_coordinate", "latitude", "grid_latitude", "y", "lat", "northing"}


def check_links(path: Path) -> None:
    """Raise InputError for an HDF5 file whose samples are stored in other files.

    The error is also raised for an HDF5 file that cannot be read. Files of other formats pass.
    """
    import h5py  # noqa: PLC0415  (loads slowly)

    if not h5py.is_hdf5(path):
        return
    outside: list[str] = []

    def note_link(name: str, link: Any) -> None:
        if isinstance(link, h5py.ExternalLink):
            outside.append(name)

    def note_samples(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
            outside.append(name)

    try:
        with h5py.File(path) as file:
            file.visititems_links(note_link)
            file.visititems(note_samples)
    except (RuntimeError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            "terrain.path", str(path), f"cannot be read ({error_reason(error)})"
        ) from None
    if outside:
        raise InputError(
            "terrain.path", str(path), f"has a variable {outside[0]!r} stored in another file",
            "Copy the samples into one file.",
        )  # fmt: skip


def check_axes(source: DatasetReader) -> None:
    """Raise InputError if a netCDF file has axes that GDAL misinterprets.

    GDAL assumes evenly spaced axes, with the last dimension pointing east. Files of other formats
    and axes without coordinates pass.

    Raises
    ------
    InputError
        If rows and columns are exchanged, an axis is not evenly spaced, the unit of an axis differs
        from the unit of the coordinate reference system, or the axes cannot be read.
    """
    if source.driver != "netCDF":
        return
    import xarray as xr  # noqa: PLC0415  (loads slowly)

    name = source.tags(1).get("NETCDF_VARNAME", "")
    try:
        with xr.open_dataset(source.name, decode_cf=False) as file:
            axes = [file.coords.get(dim) for dim in file[name].dims[-2:]]
            parts = [None if axis is None else (axis.attrs, axis.values) for axis in axes]
            dims = [str(dim) for dim in file[name].dims[-2:]]
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise _refusal(
            source, f"has axes that xarray cannot read ({error_reason(error)})"
        ) from None
    t = source.transform
    wrong_names, map_steps = (_EAST_NAMES, _NORTH_NAMES), (t.e, t.a)
    for dim, part, wrong, step in zip(dims, parts, wrong_names, map_steps, strict=True):
        if part is None:
            continue
        attributes, places = part
        names = {str(attributes.get(key, "")).lower() for key in ("standard_name", "axis")}
        if wrong & (names | {dim.lower()}):
            raise _refusal(
                source, f"has dimensions ({', '.join(dims)}), but rows must be northings",
                f"Exchange the dimensions: `ncpdq -a {dims[1]},{dims[0]} FILE out.nc`.",
            )  # fmt: skip
        _check_axis(source, dim, np.asarray(places, dtype=np.float64), attributes, step)


def _check_axis(
    source: DatasetReader, dim: str, coordinates: Any, attributes: dict[str, Any], map_step: float
) -> None:
    """Raise InputError if an axis has uneven steps or another step than the map.

    `dim` is the name of the axis, `coordinates` (n,) are its coordinates, `attributes` include its
    unit, and `map_step` is the step that GDAL reads, in units of the coordinate reference system.
    The step is not compared without a unit or a reference system.
    """
    crs, unit = source.crs, str(attributes.get("units", "")).lower()
    if len(coordinates) < 2:
        return
    steps = np.diff(coordinates)
    if crs is not None and crs.is_geographic:
        steps = (steps + 180.0) % 360.0 - 180.0
    step = float(steps.mean())
    if not np.abs(np.cumsum(steps - step)).max() <= _MAX_UNEVENNESS * abs(step):
        raise _refusal(
            source, f"has an axis {dim!r} that is not evenly spaced", "Interpolate to even steps."
        )
    if crs is None or not unit:
        return
    length = np.radians(1.0) if unit.startswith("degree") else metres_in(unit)
    true_step = abs(map_step) * crs.units_factor[1]
    if length is None or abs(abs(step) * length - true_step) > 1e-3 * true_step:
        raise _refusal(
            source, f"has an axis {dim!r} in {unit!r}, but a coordinate reference system (as read "
            f"by GDAL) in {crs.units_factor[0]}", "Make them agree, or add the attribute crs_wkt.",
        )  # fmt: skip


def _refusal(source: DatasetReader, problem: str, remedy: str = "") -> InputError:
    return InputError("terrain.path", source.name, problem, remedy)
