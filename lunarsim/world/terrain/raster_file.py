"""Open raster files of a few formats, within one folder and offline."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rasterio
from affine import TransformNotInvertibleError
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader

from lunarsim.errors import InputError, error_reason
from lunarsim.world.terrain.netcdf_file import check_axes, check_links

# GDAL's names of the accepted formats. Formats that refer to other files (VRT) or to the network
# are excluded.
DRIVERS = ("GTiff", "PDS", "PDS4", "ISIS3", "ENVI", "AAIGrid", "netCDF")
# Exceptions raised by GDAL, PROJ and the parsing of their texts.
_ERRORS = (
    RasterioError, CRSError, CPLE_BaseError, TransformNotInvertibleError, OSError,
    UnicodeError, np.linalg.LinAlgError,
)  # fmt: skip
# Label files that describe a raster of the same name.
_LABEL_SUFFIXES = (".lbl", ".LBL", ".xml", ".XML")
# Bytes searched for file names; labels, including attached ones, are shorter.
_LABEL_BYTES = 2**20
# A sidecar file can contain a URL: all names are blocked, and requests go to a closed port.
_CLOSED_PROXY = "http://127.0.0.1:1"
_GDAL_OPTIONS = {
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
    "GDAL_HTTP_PROXY": _CLOSED_PROXY,
    "GDAL_HTTPS_PROXY": _CLOSED_PROXY,
    "GDAL_HTTP_MAX_RETRY": "0",
    "GDAL_CACHEMAX": 64,  # MB; a raster is read once, from top to bottom
    "AAIGRID_DATATYPE": "Float64",  # float32 would round heights from the body's centre
}


@contextmanager
def open_raster(path: Path) -> Iterator[DatasetReader]:
    """Open a raster file with one band as a context manager.

    Errors of GDAL become InputError.
    A data file with a detached PDS label (`ldem.img` and `ldem.lbl`) is opened through its label.
    """
    if not path.is_file():
        raise InputError("terrain.path", str(path), "must be an existing raster file")
    with rasterio.Env(**_GDAL_OPTIONS), warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        _check_proj()
        try:
            _check_siblings(path)
            check_links(path)
            with _opened(path) as source:
                _check_files(path, source)
                _check_band(path, source)
                check_axes(source)
                yield source
        except InputError as error:
            if error.field == "terrain.path":  # report the path as the user gave it
                raise InputError(
                    error.field, str(path), error.problem, error.remedy, error.show_value
                ) from None
            raise
        except _ERRORS as error:
            problem = f"cannot be read by GDAL ({_first_line(error.__cause__ or error)})"
            remedy = (
                "The file, or a file to which it refers, may be damaged, incomplete or missing: "
                "copy or download it again. Files on the network are not read."
            )
            raise InputError("terrain.path", str(path), problem, remedy) from None


def _opened(path: Path) -> DatasetReader:
    """Open a raster directly, or else through a label file of the same name."""
    try:
        return DatasetReader(path.absolute(), driver=list(DRIVERS))
    except _ERRORS as error:
        labels = [p for p in map(path.with_suffix, _LABEL_SUFFIXES) if p != path and p.is_file()]
        if not labels:
            raise _not_a_raster(path, error) from None
        label = labels[0]
    try:
        source = DatasetReader(label.absolute(), driver=list(DRIVERS))
    except _ERRORS as error:
        raise InputError(
            "terrain.path", str(path),
            f"has a label {label.name} that GDAL cannot read ({_first_line(error)})",
        ) from None  # fmt: skip
    if path.resolve() not in [Path(name).resolve() for name in source.files]:
        source.close()
        raise InputError(
            "terrain.path", str(path), f"has a label {label.name} that names another file"
        )
    return source


def _first_line(error: BaseException) -> str:
    """Return the first line of an error's message, without a period at its end."""
    return error_reason(error).rstrip(".")


def _not_a_raster(path: Path, error: Exception) -> InputError:
    """Return the error for a file that GDAL cannot open in any accepted format."""
    with path.open("rb") as file:
        start = file.read(4096)
    formats = ", ".join(DRIVERS)
    if b"<VRTDataset" in start:
        problem = "must not be a VRT, which refers to other files"
    elif path.suffix.lower() in (".img", ".dat"):
        label = path.with_suffix(".lbl").name
        problem = f"must be a raster of {formats}, or have a label {label}"
        return InputError(
            "terrain.path", str(path), problem, f"GDAL reports: {_first_line(error)}."
        )
    elif b"PDS_VERSION_ID" in start or b"Product_Observational" in start:
        problem = "is a PDS label that GDAL cannot read, alone or with its raster: "
        problem += _first_line(error)
        return InputError(
            "terrain.path", str(path), problem, "Correct the label, or download both files again."
        )
    else:
        problem = f"must be a raster of {formats}"
    remedy = "Convert the file: `gdal_translate -of GTiff FILE out.tif`."
    return InputError("terrain.path", str(path), problem, remedy)


def _check_proj() -> None:
    """Raise InputError if PROJ's data are missing: coordinates would be wrong."""
    try:
        CRS.from_epsg(4326)
    except _ERRORS as error:
        for name in ("PROJ_DATA", "PROJ_LIB"):
            if name in os.environ:
                raise InputError(
                    name, os.environ[name],
                    "must not name a folder without the file proj.db of the installed rasterio",
                    f"Unset this environment variable: `unset {name}`.",
                ) from None  # fmt: skip
        raise InputError(
            "rasterio", rasterio.__version__,
            f"must include the data of PROJ, which are missing ({error})", "Reinstall rasterio.",
        ) from None  # fmt: skip


def _check_siblings(path: Path) -> None:
    """Raise InputError for pipes and devices that belong to a raster.

    GDAL would open them and wait for ever. Files belong to the raster if their names begin with
    its name or if its label names them.
    """
    siblings = path.absolute().parent.iterdir()
    odd = [p for p in siblings if p.exists() and not p.is_file() and not p.is_dir()]
    if not odd:
        return
    with path.open("rb") as file:
        start = file.read(_LABEL_BYTES)
    for part in odd:
        if part.name.startswith(path.stem) or os.fsencode(part.name) in start:
            raise InputError(
                "terrain.path", str(path),
                f"must not have the pipe or device {part.name} in its folder",
                f"Remove {part.name}.",
            )  # fmt: skip


def _check_files(path: Path, source: DatasetReader) -> None:
    """Raise InputError unless all files of a raster lie in its folder or below."""
    parts = [Path(name).resolve() for name in source.files]
    outside = [
        [part for part in parts if not (part.is_file() and part.is_relative_to(folder))]
        for folder in (path.absolute().parent.resolve(), path.resolve().parent)
    ]
    if all(outside):
        name = source.files[parts.index(outside[0][0])]
        problem = f"must refer only to files in its own folder, but refers to {name}"
        if Path(name) == path:
            problem = f"must not be a link to another folder ({outside[0][0]})"
        raise InputError(
            "terrain.path", str(path), problem,
            "Put all parts of a raster into one folder, without links.",
        )  # fmt: skip


def _check_band(path: Path, source: DatasetReader) -> None:
    """Raise InputError unless a file has exactly one raster with one real band."""
    if source.subdatasets:
        first = source.subdatasets[0]
        raise InputError(
            "terrain.path", str(path), f"must contain one raster, not {len(source.subdatasets)}",
            f"Extract one: `gdal_translate '{first}' heights.tif`.",
        )  # fmt: skip
    if source.count != 1:
        raise InputError(
            "terrain.path", str(path), f"must have one band of elevations, not {source.count} "
            "bands", "Extract band N: `gdal_translate -b N FILE out.tif`.",
        )  # fmt: skip
    if "complex" in source.dtypes[0]:
        raise InputError(
            "terrain.path",
            str(path),
            "must have heights that are real numbers, not complex numbers",
        )
