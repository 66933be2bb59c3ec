"""Table of the export formats, and the function that writes any of them."""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from lunarsim.atomic_files import remove_contents_on_error
from lunarsim.errors import InputError, check_folder, check_output, suggestion

if TYPE_CHECKING:
    from lunarsim.simulation import Flight

# Epoch of the start of a flight if neither the user nor the scenario gives one (J2000.0).
DEFAULT_EPOCH = "2000-01-01T12:00:00"
_EPOCH = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(\.\d{1,9})?Z?")
# Other years do not fit in the time stamps of MCAP.
_FIRST_YEAR, _LAST_YEAR = 1971, 2250


@dataclass(frozen=True)
class ExportFormat:
    """Format of exported files.

    Attributes
    ----------
    summary
        Content and format in a few words.
    writer
        Function that writes the format, as "module:function". Its arguments are flight, output path
        and `ExportOptions`.
    suffixes
        Allowed suffixes of the file, the default first; empty: the output is a folder.
    options
        Names of the options that the format uses.
    """

    summary: str
    writer: str
    suffixes: tuple[str, ...]
    options: tuple[str, ...] = ()

    def default_output(self, name: str) -> Path:
        """Return the default file or folder for the flight `name`."""
        return Path(name + self.suffixes[0] if self.suffixes else f"{name}_csv")


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export.

    Attributes
    ----------
    epoch
        Date and time (UTC) of the start of the flight, ISO 8601; None: the time of the scenario's
        site, or `DEFAULT_EPOCH` without one.
    state
        Which state OEM and AEM contain: the true one, or the estimate of navigation.
    longitude
        Longitude of the origin of the site frame, deg, positive east. It is used in scenarios with
        a table [moon], which gives the latitude: OEM and AEM then use the frame that is fixed to
        the Moon. None: the longitude of the scenario's site, or the site frame without one.

    Raises
    ------
    InputError
        If the epoch is no date and time from 1971 to 2250, the state is unknown, or the longitude
        is not between -180 and 360 deg.
    """

    epoch: str | None = None
    state: Literal["true", "estimate"] = "true"
    longitude: float | None = None

    def __post_init__(self) -> None:
        if self.epoch is not None and not _is_epoch(self.epoch):
            raise InputError(
                "--epoch", self.epoch,
                f"must be a date and time from {_FIRST_YEAR} to {_LAST_YEAR} such as "
                "2027-03-01T12:00:00",
            )  # fmt: skip
        if self.state not in ("true", "estimate"):
            raise InputError("--state", self.state, "must be true or estimate")
        if self.longitude is not None and not -180.0 <= self.longitude <= 360.0:
            raise InputError("--longitude", self.longitude, "must be between -180 and 360 deg")


def _is_epoch(text: str) -> bool:
    """Return whether a text is a date and time in UTC within the allowed years."""
    found = _EPOCH.fullmatch(text)
    try:
        return found is not None and (
            _FIRST_YEAR <= datetime.fromisoformat(found[1]).year <= _LAST_YEAR
        )
    except ValueError:
        return False


_CCSDS_OPTIONS = ("epoch", "state", "longitude")
FORMATS: dict[str, ExportFormat] = {
    "oem": ExportFormat(
        "positions and velocities, CCSDS OEM 2.0", "lunarsim.exports.oem:write_oem",
        (".oem",), _CCSDS_OPTIONS,
    ),
    "aem": ExportFormat(
        "attitudes, CCSDS AEM 1.0", "lunarsim.exports.aem:write_aem", (".aem",), _CCSDS_OPTIONS,
    ),
    "csv": ExportFormat(
        "folder with one CSV file per table", "lunarsim.exports.csv_tables:write_csv", (),
    ),
    "matlab": ExportFormat(
        "all tables as structs, MAT file", "lunarsim.exports.matlab:write_matlab", (".mat",),
    ),
    "mcap": ExportFormat(
        "recording with Foxglove schemas, MCAP", "lunarsim.exports.mcap_recording:write_mcap",
        (".mcap",), ("epoch",),
    ),
    "pointcloud": ExportFormat(
        "LiDAR returns in the site frame, PLY", "lunarsim.exports.point_cloud:write_point_cloud",
        (".ply",),
    ),
    "world": ExportFormat(
        "terrain with rocks: GeoTIFF, or mesh as PLY or GLB",
        "lunarsim.exports.world:write_flight_world", (".tif", ".ply", ".glb"),
    ),
}  # fmt: skip


def export_flight(
    flight: Flight, name: str, out: str | Path, options: ExportOptions | None = None
) -> Path:
    """Write a flight in another format; return the file or folder.

    An existing file is replaced. If the export fails, nothing is left of it.

    Parameters
    ----------
    flight
        Record of a flight, for instance from `Flight.load`.
    name
        Name of the format, a key of `FORMATS`.
    out
        File to write, with a suffix of the format; for the format "csv" a new or empty folder.
    options
        Epoch, state and longitude; None: their defaults.

    Raises
    ------
    InputError
        If the format is unknown, the output unsuitable, an optional package is missing, or the
        flight does not contain what the format needs.
    """
    out = Path(out)
    found = find_format(name)
    check_export_output(found, out)
    module, function = found.writer.split(":")
    write = getattr(importlib.import_module(module), function)
    if found.suffixes:
        write(flight, out, options or ExportOptions())
        return out
    with remove_contents_on_error(out):
        write(flight, out, options or ExportOptions())
    return out


def find_format(name: str) -> ExportFormat:
    """Return the format with a name, or raise InputError."""
    if name not in FORMATS:
        raise InputError(
            "--format", name, "must be a known format", suggestion(name, FORMATS, "formats")
        )
    return FORMATS[name]


def check_export_output(found: ExportFormat, out: Path) -> None:
    """Raise InputError unless `out` is a suitable file or folder for a format."""
    if not found.suffixes:
        check_folder(out)
        return
    suffix = out.suffix.lower()
    if suffix not in found.suffixes:
        raise InputError(
            "--out", str(out), f"must be a file name that ends in {' or '.join(found.suffixes)}"
        )
    check_output("--out", out, suffix)
