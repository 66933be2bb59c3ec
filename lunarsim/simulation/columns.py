"""Declare the schema of a recorded flight: its tables and their columns.

The files, their metadata and the reference page are all derived from the declarations here.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.frames import matrix_to_quat
from lunarsim.messages.commands import Command
from lunarsim.messages.measurements import CameraImage, InertialSamples, LidarScan
from lunarsim.models.pinhole import View
from lunarsim.onboard.computer import OnboardComputer
from lunarsim.typing import Array
from lunarsim.vehicle.state import State

# Version of the files of a flight record. It increases if a reader of the earlier version would
# misread a new record, or does not find what it reads. Version 1 has no `schema_version` and only
# the tables trajectory, scans, candidates and readings.
SCHEMA_VERSION = 2
# Maximum size of the readings of a sensor, bytes: 200 scans of 256 x 256 pixels have 1.9 GB.
# Images count with the size of their pixels: 2048 images of 1024 x 1024 pixels with 8 bits.
MAX_READINGS_BYTES = 2**31
# Maximum number of recorded images of a camera: `flight.json` has the digest of each file, 100
# bytes, and is not read above 8 MiB.
MAX_IMAGES = 10_000
# Frames of the columns, as in `lunarsim.frames`.
TRUE_FRAME, LOCAL_FRAME, SITE_FRAME, BODY_FRAME = (
    "true ENU: origin at the centre of the terrain, at its mean elevation",
    "local ENU, the frame of the onboard maps; subtract a map's navigation_error_m for true ENU",
    "site ENU, the frame of the prior map: estimated values of the quantities in true ENU",
    "body axes of the lander",
)


def vector_columns(table: dict[str, Array], name: str, axes: str = "xyz") -> Array:
    """Return a vector or quaternion (n, axes) from the columns of a table."""
    return np.column_stack([table[f"{name}_{axis}"] for axis in axes])


class Cycle(NamedTuple):
    """What one control cycle provides for a row of the trajectory.

    `time` is that since the start of the flight, s; `state` the true state; `time_to_go` the time
    until the end of the guidance phase, s, 0 after the flight.
    """

    time: float
    state: State
    computer: OnboardComputer
    time_to_go: float


class CommandCycle(NamedTuple):
    """What one control cycle provides for a row of the commands.

    `time` is the start of the cycle, s; `torque` (3,) the mean torque that the attitude loop
    commands during the cycle, body axes, N m.
    """

    time: float
    command: Command
    computer: OnboardComputer
    torque: Array


class ImageSource(NamedTuple):
    """What one image provides for a row of the table of images.

    `view` is the view of the camera at the true pose of the lander.
    """

    image: CameraImage
    view: View


class ColumnGroup(NamedTuple):
    """Columns whose values come from one expression.

    `names`, `unit`, `meaning` and `frame` describe the columns; `value` returns their values, one
    per name, from the data of a row. A name that ends in "*" stands for any number of columns,
    whose names have an index in its place. Groups without `value` belong to tables that are not
    recorded row by row.
    """

    names: tuple[str, ...]
    unit: str
    meaning: str
    frame: str = ""
    value: Callable[[Any], ArrayLike] | None = None


class Table(NamedTuple):
    """Declaration of one table of the flight record, saved as ``NAME.parquet``.

    `rows` states what a row is, that is the rate of the table; `dtype` is the type of all columns.
    """

    name: str
    rows: str
    groups: tuple[ColumnGroup, ...]
    dtype: type = np.float64

    def columns(self, width: int = 0) -> dict[str, ColumnGroup]:
        """Return the group of each column by name, in the order of the file.

        `width` is the number of columns of a table with a name that ends in "*".
        """
        names = [(name, group) for group in self.groups for name in group.names]
        more = width - len(names) + 1
        return {
            name.replace("*", str(k)): group
            for name, group in names
            for k in range(more if name.endswith("*") else 1)
        }

    def row(self, source: Any) -> Array:
        """Return the values (columns,) of one row from the data `source`."""
        values = [np.atleast_1d(g.value(source)) for g in self.groups if g.value is not None]
        return np.concatenate(values).astype(float)

    def as_columns(self, rows: ArrayLike) -> dict[str, Array]:
        """Return rows (n, columns) as columns (n,) by name."""
        table: Array = np.asarray(rows, dtype=self.dtype)
        names = self.columns(table.shape[1] if table.ndim == 2 else 0)
        table = table.reshape(-1, len(names))
        return {name: table[:, i].copy() for i, name in enumerate(names)}

    def metadata(self, width: int) -> dict[str, str]:
        """Return unit and frame of each of `width` columns, as metadata of the file."""
        found = self.columns(width)
        units = {f"unit:{name}": group.unit for name, group in found.items()}
        return units | {f"frame:{name}": g.frame for name, g in found.items() if g.frame}


def _axes(name: str, axes: str = "xyz") -> tuple[str, ...]:
    """Return the names of the components of a vector or quaternion."""
    return tuple(f"{name}_{axis}" for axis in axes)


def _target(part: str) -> Callable[[CommandCycle], ArrayLike]:
    """Return a function that reads an attribute (3,) of the guidance target, or NaN."""
    return lambda c: getattr(c.computer.guidance_target, part, np.full(3, np.nan))


_TIME = "time since the start of the flight"
_QUATERNION = "quaternion, body to ENU, scalar last"
_UPPER = tuple(combinations_with_replacement(range(9), 2))

TRAJECTORY = Table(
    "trajectory",
    "one row per control cycle, at its end, and one at the start of the flight",
    (
        ColumnGroup(("time",), "s", _TIME, "", lambda c: c.time),
        ColumnGroup(
            _axes("position"), "m", "true centre of mass", TRUE_FRAME, lambda c: c.state.position
        ),
        ColumnGroup(
            _axes("velocity"), "m/s", "true velocity", TRUE_FRAME, lambda c: c.state.velocity
        ),
        ColumnGroup(
            _axes("attitude", "xyzw"), "1", f"true attitude: {_QUATERNION}", TRUE_FRAME,
            lambda c: c.state.attitude,
        ),
        ColumnGroup(
            _axes("rate"), "rad/s", "true angular rate", BODY_FRAME, lambda c: c.state.rate
        ),
        ColumnGroup(("mass",), "kg", "true mass", "", lambda c: c.state.mass),
        ColumnGroup(
            ("thrust",), "N", "true thrust of the main engine", "", lambda c: c.state.thrust
        ),
        ColumnGroup(
            _axes("estimated"), "m", "estimated position", LOCAL_FRAME,
            lambda c: c.computer.estimate.position,
        ),
        ColumnGroup(
            _axes("estimated_velocity"), "m/s", "estimated velocity", LOCAL_FRAME,
            lambda c: c.computer.estimate.velocity,
        ),
        ColumnGroup(
            ("estimated_mass",), "kg", "estimated mass", "", lambda c: c.computer.estimate.mass
        ),
        ColumnGroup(
            _axes("site"), "m", "site that the lander flies to, before the decision of the cycle",
            LOCAL_FRAME, lambda c: c.computer.site,
        ),
        ColumnGroup(
            ("time_to_go",), "s", "time until the end of the guidance phase", "",
            lambda c: c.time_to_go,
        ),
        ColumnGroup(
            ("phase",), "1", "0 approach, 1 vertical descent, 2 abort, 3 braking, 4 hover", "",
            lambda c: c.computer.phase,
        ),
        ColumnGroup(
            ("lost",), "1",
            "1 while navigation is contradicted by measurements, or too inaccurate to land", "",
            lambda c: c.computer.navigation_lost,
        ),
    ),
)  # fmt: skip
NAVIGATION = Table(
    "navigation",
    "one row per control cycle, at the times of the trajectory",
    (
        ColumnGroup(("time",), "s", _TIME, "", lambda e: e.time),
        ColumnGroup(
            _axes("position"), "m", "estimated centre of mass", SITE_FRAME, lambda e: e.position
        ),
        ColumnGroup(
            _axes("velocity"), "m/s", "estimated velocity", SITE_FRAME, lambda e: e.velocity
        ),
        ColumnGroup(
            _axes("attitude", "xyzw"), "1", f"estimated attitude: {_QUATERNION}", SITE_FRAME,
            lambda e: e.attitude,
        ),
        ColumnGroup(
            _axes("rate"), "rad/s", "estimated angular rate", BODY_FRAME, lambda e: e.rate
        ),
        ColumnGroup(
            tuple(f"covariance_{i}{j}" for i, j in _UPPER), "products of m, m/s, rad",
            "upper triangle of the covariance of the errors, row and column 0 to 8: position, "
            "velocity, small rotation (truth = rotation times estimate)",
            SITE_FRAME, lambda e: e.covariance[np.triu_indices(9)],
        ),
    ),
)  # fmt: skip
COMMANDS = Table(
    "commands",
    "one row per control cycle, at its start",
    (
        ColumnGroup(("time",), "s", f"{_TIME}, when the command begins", "", lambda c: c.time),
        ColumnGroup(
            ("thrust",), "N", "commanded thrust of the main engine; 0 shuts it down", "",
            lambda c: c.command.thrust,
        ),
        ColumnGroup(
            _axes("attitude", "xyzw"), "1", f"commanded attitude: {_QUATERNION}", LOCAL_FRAME,
            lambda c: c.command.attitude,
        ),
        ColumnGroup(
            _axes("torque"), "N m", "torque that the attitude loop commands, mean of the cycle; "
            "NaN if attitude control is ideal", BODY_FRAME, lambda c: c.torque,
        ),
        ColumnGroup(
            _axes("acceleration"), "m/s^2",
            "thrust acceleration that guidance commands, before limits of tilt and thrust",
            LOCAL_FRAME, lambda c: c.computer.guidance_acceleration,
        ),
        ColumnGroup(
            _axes("target_position"), "m", "guidance target: centre of mass at the end of the "
            "phase; NaN during hover and abort", LOCAL_FRAME, _target("position"),
        ),
        ColumnGroup(
            _axes("target_velocity"), "m/s", "guidance target: velocity at the end of the phase; "
            "NaN during hover and abort", LOCAL_FRAME, _target("velocity"),
        ),
        ColumnGroup(
            ("time_to_go",), "s", "time until the end of the guidance phase", "",
            lambda c: c.computer.time_to_go,
        ),
        ColumnGroup(
            ("abort",), "1", "1 while the lander aborts the landing", "",
            lambda c: c.command.abort,
        ),
    ),
)  # fmt: skip
ACTUATORS = Table(
    "actuators",
    "one row per period of the thrusters, at its start; only landers with simulated thrusters",
    (
        ColumnGroup(("time",), "s", _TIME),
        ColumnGroup(
            _axes("gimbal_command", "xy"), "rad", "commanded gimbal angle about the axis",
            BODY_FRAME,
        ),
        ColumnGroup(
            _axes("gimbal", "xy"), "rad", "true gimbal angle about the axis", BODY_FRAME
        ),
        ColumnGroup(
            ("on_time_*",), "s", "commanded on-time of each thruster from this time on; divided by "
            "the period it is the duty",
        ),
    ),
)  # fmt: skip
SCANS = Table(
    "scans",
    "one row per LiDAR return, thinned to 4096 of a scan and two scans per second",
    (
        ColumnGroup(tuple("xyz"), "m", "measured point", LOCAL_FRAME),
        ColumnGroup(("time",), "s", "time of the scan"),
    ),
    np.float32,
)
CANDIDATES = Table(
    "candidates",
    "one row per candidate site of the last decision",
    (
        ColumnGroup(tuple("xyz"), "m", "candidate site", LOCAL_FRAME),
        ColumnGroup(("p_safe",), "1", "probability of safe terrain"),
        ColumnGroup(("propellant",), "kg", "propellant needed to land there"),
    ),
    np.float32,
)
IMAGES = Table(
    "images.NAME",
    "one row per image of the camera `NAME`",
    (
        ColumnGroup(("time",), "s", "middle of the exposure", "", lambda s: s.image.time),
        ColumnGroup(
            _axes("position"), "m", "true position of the camera", TRUE_FRAME,
            lambda s: s.view.position,
        ),
        ColumnGroup(
            _axes("attitude", "xyzw"), "1", "true attitude of the camera: quaternion, camera to "
            "ENU, scalar last; camera x is right in the image, y down, z along the boresight",
            TRUE_FRAME, lambda s: matrix_to_quat(s.view.axes),
        ),
        ColumnGroup(
            ("exposure",), "s", "exposure time; NaN if the camera does not report it", "",
            lambda s: s.image.exposure,
        ),
        ColumnGroup(
            ("width", "height"), "px", "size of the image", "",
            lambda s: (s.image.camera.width, s.image.camera.height),
        ),
        ColumnGroup(
            ("fx", "fy", "cx", "cy"), "px", "focal lengths, and principal point from the centre "
            "of the first pixel", "", lambda s: s.image.camera.pinhole,
        ),
        ColumnGroup(
            ("k1", "k2", "p1", "p2", "k3"), "1", "Brown-Conrady coefficients of the lens "
            "distortion, as in OpenCV", "", lambda s: s.image.camera.distortion,
        ),
    ),
)  # fmt: skip
# Tables of a flight as columns by name. A record of version 1 has only the trajectory.
COLUMN_TABLES = (TRAJECTORY, NAVIGATION, COMMANDS, ACTUATORS)
TABLES = (*COLUMN_TABLES, SCANS, CANDIDATES)
# Fields of a measurement that have one value or vector per sample. A recorded reading of such a
# type has one row per sample, and its other fields are repeated.
SAMPLE_FIELDS: dict[type, tuple[str, ...]] = {
    InertialSamples: ("angle", "velocity"),
    LidarScan: ("range", "direction", "sigma"),
}
