"""Write tables of a recorded flight, and read its folder, which may be damaged.

Every file is compared with its digest in ``flight.json``. Types, columns and shapes are checked
before use, and sizes before anything is decompressed.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from lunarsim.atomic_files import atomic_write
from lunarsim.core.touchdown import VALUES
from lunarsim.errors import InputError, error_reason
from lunarsim.grid import Grid
from lunarsim.scenario.errors import plain_problem
from lunarsim.scenario.files import parsed_toml
from lunarsim.simulation.columns import (
    COMMANDS,
    NAVIGATION,
    SCHEMA_VERSION,
    Table,
)
from lunarsim.typing import Array
from lunarsim.untrusted_files import check_no_links, read_json

# Maximum decompressed size of a table or layer, bytes. A flight of three hours has 25 MB.
MAX_EXPANDED_BYTES = 2**28

# Signature of a PNG file, and start of its first chunk.
_PNG_START = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"

_Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=100)]
_Count = Annotated[int, Field(ge=0)]
_Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
_Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class _StrictRecord(BaseModel):
    """Base class of JSON records: no conversion of types; further keys are allowed."""

    model_config = ConfigDict(strict=True, extra="allow")


# Touchdown in ``flight.json``: the fields of `vehicle.touchdown.Touchdown`.
_TOUCHDOWN_FIELDS: dict[str, Any] = dict.fromkeys(("heading", *VALUES), (float, ...))
_Touchdown = create_model(
    "_Touchdown",
    __config__=ConfigDict(strict=True, extra="forbid"),
    position=(_Vector, ...),
    **_TOUCHDOWN_FIELDS,
)


class _OutcomeRecord(_StrictRecord):
    """Landing outcome in ``flight.json``."""

    safe: bool
    failure_causes: list[str]
    touchdown: _Touchdown | None


class _Seed(_StrictRecord):
    """Entropy and spawn key of the flight's seed sequence in ``flight.json``."""

    entropy: _Count | list[_Count]
    spawn_key: list[Annotated[int, Field(ge=0, lt=2**32)]]


class _Event(_StrictRecord):
    """Event of the flight in ``flight.json``: time, s, and name."""

    time: float
    name: str


class _Decision(_StrictRecord):
    """Divert in ``flight.json``: time, s, reason, and sites before and after it, m."""

    time: float
    reason: str
    come_from: Annotated[_Vector, Field(alias="from")]
    to: _Vector


class _Estimate(_StrictRecord):
    """Navigation estimate in ``flight.json``, without covariance."""

    time: float
    position: _Vector
    velocity: _Vector
    attitude: _Quaternion
    rate: _Vector
    mass: float
    lost: bool = False


class FlightRecord(_StrictRecord):
    """Required content of ``flight.json``, the main file of a recorded flight."""

    schema_version: Annotated[int, Field(ge=1)] = 1
    tables: list[_Name] = []
    scenario: str
    seed: _Seed
    policy: str
    target: _Vector
    outcome: _OutcomeRecord
    decisions: list[_Decision]
    events: list[_Event]
    decision_mapper: str
    maps: list[_Name]
    readings: list[_Name] = []
    images: list[_Name] = []
    first_map: _Estimate | None
    digests: dict[str, str] = {}


class _DefectError(ValueError):
    """Error with a text for users: a file of a flight record has a defect."""


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise any error within a `with` statement as an `InputError` that names a file."""
    try:
        yield
    except Exception as error:  # the libraries raise many types on damaged files
        if isinstance(error, InputError) and error.field == "flight":
            raise
        raise _damaged(path, _reason(error, path.suffix)) from None


def _reason(error: Exception, suffix: str) -> str:
    """Return the first line of an error's message, with the invalid field if known.

    `suffix` is the suffix of the file. Messages of libraries about its format are omitted.
    """
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        problem = plain_problem(first)
        if first["type"] == "string_pattern_mismatch":
            problem = "must be a name of letters, digits, _ and -"
        return f"{'.'.join(map(str, first['loc']))} {problem}"
    if isinstance(error, InputError):
        return f"{error.field} {error.problem}"
    reason = error_reason(error)
    if isinstance(error, _DefectError) or getattr(error, "strerror", None):
        return reason
    formats = {".parquet": "Parquet", ".nc": "NetCDF"}
    return f"it is not a valid {formats[suffix]} file" if suffix in formats else reason


def _damaged(path: Path, reason: str) -> InputError:
    """Return the error for a damaged file; its text has 100 characters of `reason`."""
    return InputError(
        "flight", str(path), f"must be an intact file of a flight record ({reason[:100]})",
        "Restore the file from a copy, or repeat the flight.",
    )  # fmt: skip


def read_record(folder: Path) -> dict[str, Any]:
    """Read ``flight.json`` in a flight's folder, and check the digests of all files.

    Return its content as nested dictionaries.

    Raises
    ------
    InputError
        If the folder holds no flight, or a file is damaged.
    """
    file = folder / "flight.json"
    if not file.is_file():
        raise InputError("flight", str(folder), "must be a folder that contains flight.json")
    with reading(file):
        check_no_links(folder)
        tables: dict[str, Any] = read_json(file)
        if "verdict" in tables:
            raise InputError(
                "flight", str(folder), "must not be a record of an earlier version",
                "Convert the record by `python scripts/migrate_stored.py FOLDER`.",
            )  # fmt: skip
        version = tables.get("schema_version", 1)
        if isinstance(version, int) and version > SCHEMA_VERSION:
            raise InputError(
                "flight", str(folder),
                f"must have schema version {SCHEMA_VERSION} or lower, not {version}",
                "Read it with the version of lunarsim that wrote it, or a later one.", False,
            )  # fmt: skip
        checked = FlightRecord.model_validate(tables)
        missing = {NAVIGATION.name, COMMANDS.name} - set(checked.tables)
        if checked.schema_version > 1 and missing:
            raise _DefectError(f"tables lacks {', '.join(sorted(missing))}")
        parsed_toml(checked.scenario)
    for name, digest in checked.digests.items():
        with reading(folder / name):
            if digest_of(_inside(folder, folder / name)) != digest:
                raise _DefectError(
                    "the file was changed: its digest differs from the one in flight.json"
                )
    return tables


def digest_of(path: Path) -> str:
    """Return the SHA-256 digest of a file as hexadecimal text."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _inside(folder: Path, path: Path) -> Path:
    """Return a path if it is inside a folder; otherwise raise an error."""
    if not path.resolve().is_relative_to(folder.resolve()):
        raise _DefectError("the file is outside the folder of the record")
    return path


def read_columns(
    folder: Path, path: Path, required: Sequence[str] | None = None, min_rows: int = 0,
    max_bytes: int = MAX_EXPANDED_BYTES,
) -> dict[str, Array]:  # fmt: skip
    """Read numeric columns (n,) of a Parquet file of a recorded flight, by name.

    Parameters
    ----------
    folder
        Folder of the flight, which must contain the file.
    path
        Path of the file.
    required
        Names of the columns to read; None: all columns.
    min_rows
        Minimum number of rows.
    max_bytes
        Maximum decompressed size, bytes.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    with reading(path), pq.ParquetFile(_inside(folder, path), page_checksum_verification=True) as f:
        names = list(f.schema_arrow.names) if required is None else list(required)
        for name in names:
            if name not in f.schema_arrow.names:
                raise InputError(
                    "flight", str(path), f"has no column {name}: another version wrote it",
                    "Fly its scenario again, or read it with the version that wrote it.",
                )  # fmt: skip
            kind = f.schema_arrow.field(name).type
            if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or kind == pa.bool_()):
                raise _DefectError(f"column {name} is of type {kind}")
        if 8 * f.metadata.num_rows * max(len(names), 1) > max_bytes:
            raise _DefectError(f"larger than {max_bytes // 2**20} MiB when decompressed")
        table = f.read(names)
        if len(table) < min_rows:
            raise _DefectError(f"the table has {len(table)} rows, but needs {min_rows}")
        if any(column.null_count for column in table.columns):
            raise _DefectError("values are missing")
        return {name: np.array(table[name].to_numpy()) for name in names}


def read_trajectory(folder: Path, names: Sequence[str]) -> dict[str, Array]:
    """Read named columns (n,) of the trajectory in the folder of a recorded flight.

    The trajectory must have at least one row and finite times.
    """
    path = folder / "trajectory.parquet"
    found = read_columns(folder, path, names, min_rows=1)
    with reading(path):
        if not np.isfinite(found["time"]).all():
            raise _DefectError("times are not finite")
    return {name: column.astype(np.float64, copy=False) for name, column in found.items()}


def read_table(folder: Path, table: Table, rows: int | None = None) -> dict[str, Array]:
    """Read the columns (n,) of a declared table of a recorded flight, by name.

    `rows` is the number of rows that the table must have; None: any. Times must be finite.
    """
    path = folder / f"{table.name}.parquet"
    width = len(read_columns(folder, path))
    found = read_columns(folder, path, list(table.columns(width)))
    with reading(path):
        if rows is not None and len(found["time"]) != rows:
            raise _DefectError(f"the table has {len(found['time'])} rows, but needs {rows}")
        if not np.isfinite(found["time"]).all():
            raise _DefectError("times are not finite")
    return {name: column.astype(table.dtype, copy=False) for name, column in found.items()}


def read_rows(folder: Path, name: str, columns: Sequence[str]) -> NDArray[np.float32]:
    """Read columns of the file ``NAME.parquet`` of a flight as an array (n, columns)."""
    found = read_columns(folder, folder / f"{name}.parquet", columns)
    return np.column_stack([found[c] for c in columns]).astype(np.float32)


def read_layers(
    folder: Path, path: Path, names: Sequence[str], flags: Sequence[str]
) -> tuple[Grid, dict[str, NDArray[Any]], Array, float | None]:
    """Read grid, layers (rows, cols), navigation error and time of a hazard map.

    The error (3,) is in m, and the time in s. The time is None in records of earlier versions.

    Parameters
    ----------
    folder, path
        Folder of the flight; NetCDF file in it.
    names, flags
        Names of possible layers; names of the boolean ones among them.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    import h5py  # noqa: PLC0415  (loads slowly)

    with reading(path), h5py.File(_inside(folder, path)) as file:
        found = {name: _local_dataset(file, name) for name in names if name in file}
        shape = found["p_safe"].shape
        for name, layer in found.items():
            if layer.shape != shape or layer.dtype.kind not in "fi":
                raise _DefectError(f"layer {name} has type {layer.dtype} and shape {layer.shape}")
        if shape != tuple(_local_dataset(file, name).size for name in "yx"):
            raise _DefectError(f"layers of shape {shape} do not fit the axes y and x")
        if 8 * math.prod(shape) > MAX_EXPANDED_BYTES:
            raise _DefectError(f"larger than {MAX_EXPANDED_BYTES // 2**20} MiB when decompressed")
        layers = {
            name: layer[()].astype(np.bool_ if name in flags else np.float32)
            for name, layer in found.items()
        }
        a = file.attrs
        x0, y0, posting = (np.asarray(a[key]).item() for key in ("x0_m", "y0_m", "posting_m"))
        grid = Grid(float(x0), float(y0), float(posting), *shape)
        error = np.array(a["navigation_error_m"], dtype=np.float64)
        if error.shape != (3,) or not np.isfinite(error).all():
            raise _DefectError("navigation_error_m must be three finite numbers")
        time = float(np.asarray(a["time_s"]).item()) if "time_s" in a else None
        if time is not None and not math.isfinite(time):
            raise _DefectError("time_s must be finite")
        return grid, layers, error, time


def read_image(folder: Path, path: Path, size: tuple[float, float], max_bytes: int) -> bytes:
    """Read a grey PNG file in the folder of a flight, without decoding it.

    Parameters
    ----------
    folder, path
        Folder of the flight; file in it.
    size
        Width and height that the image must have, pixels.
    max_bytes
        Maximum size of the file, bytes.

    Raises
    ------
    InputError
        If the file is missing, too large, or not a grey PNG image of this size.
    """
    with reading(path):
        if _inside(folder, path).stat().st_size > max_bytes:
            raise _DefectError("the images of the camera are larger than a record can have")
        data = path.read_bytes()
        if len(data) < 33 or data[:16] != _PNG_START:
            raise _DefectError("it is not a valid PNG file")
        width, height, bits, channels = struct.unpack(">IIBB", data[16:26])
        if (width, height) != size or bits not in (8, 16) or channels != 0:
            raise _DefectError("the image has another size or type than its table states")
        if width * height * bits // 8 > MAX_EXPANDED_BYTES:
            raise _DefectError(f"larger than {MAX_EXPANDED_BYTES // 2**20} MiB when decompressed")
        return data


def _local_dataset(file: Any, name: str) -> Any:
    """Return a dataset of an open HDF5 file.

    Raise an error if the dataset links to another place or file.
    """
    import h5py  # noqa: PLC0415  (loads slowly)

    link, dataset = file.get(name, getlink=True), file[name]
    if not isinstance(link, h5py.HardLink) or dataset.external or dataset.is_virtual:
        raise _DefectError(f"its variable {name} is a link to other data, which is not read")
    return dataset


def save_columns(table: Table, columns: Mapping[str, Array], folder: Path) -> None:
    """Write columns (n,) of a declared table, with units and frames as metadata."""
    save_table(arrow_table(table, columns), folder / f"{table.name}.parquet")


def arrow_table(table: Table, columns: Mapping[str, Array]) -> pa.Table:
    """Return columns (n,) of a table in Arrow, with units and frames as metadata."""
    found = table.columns(len(columns))
    data = pa.table({name: np.asarray(columns[name], dtype=table.dtype) for name in found})
    return data.replace_schema_metadata(table.metadata(len(columns)))


def save_table(table: pa.Table, path: Path) -> None:
    """Write a table to a Parquet file; a failure leaves no partial file."""
    atomic_write(path, lambda part: pq.write_table(table, part))
