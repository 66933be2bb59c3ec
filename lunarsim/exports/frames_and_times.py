"""Frames and times of exported files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.exports.formats import ExportOptions
from lunarsim.frames import matrix_to_quat, quat_multiply
from lunarsim.models.gravity import RoundMoon
from lunarsim.onboard.guidance.trajectory_files import SITE_FRAME_NAME
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight
from lunarsim.typing import Array

# Frame of CCSDS files that is fixed to the Moon: mean Earth and polar axis, in which lunar
# latitudes and longitudes are counted.
MOON_FRAME_NAME = "MOON_ME"
SITE_FRAME_COMMENTS = (
    f"{SITE_FRAME_NAME} is a Cartesian frame fixed to the terrain: x east, y north, z up.",
    "Its origin is the centre of the terrain at its mean elevation, on the surface of the Moon.",
)
# Maximum time of a record, s (116 days), so that dates keep their nanoseconds.
_MAX_TIME_S = 1e7


def epoch_date(options: ExportOptions) -> np.datetime64:
    """Return the epoch of the start of the flight as a date with nanoseconds."""
    return np.datetime64(options.epoch.removesuffix("Z"), "ns")


def dates(epoch: np.datetime64, time: Array) -> NDArray[np.datetime64]:
    """Return the dates (n,) of times (n,), s, since the epoch, in nanoseconds.

    Raises
    ------
    InputError
        If a time is not finite, or impossible for a flight.
    """
    wrong = ~(np.abs(time) <= _MAX_TIME_S)
    if wrong.any():
        raise InputError(
            "flight", time[wrong][0], f"must contain only times of at most {_MAX_TIME_S:g} s"
        )
    return np.asarray(epoch + np.round(1e9 * time).astype("timedelta64[ns]"))


@dataclass(frozen=True)
class ExportFrame:
    """Frame of exported states: the site frame, or the frame fixed to the Moon.

    Attributes
    ----------
    moon
        Sphere of the scenario; None: the frame is the site frame.
    longitude
        Longitude of the origin of the site frame, rad.
    """

    moon: RoundMoon | None = None
    longitude: float = 0.0

    @classmethod
    def of(cls, flight: Flight, longitude_deg: float | None) -> ExportFrame:
        """Return the frame for a longitude, deg; None: the site frame.

        Raises
        ------
        InputError
            If a longitude is given but the scenario has no table [moon].
        """
        if longitude_deg is None:
            return cls()
        table = Scenario.world_from_toml(flight.scenario).moon
        if table is None:
            raise InputError(
                "--longitude", longitude_deg,
                "must be omitted, because the scenario has no table [moon] with a latitude",
                "Omit it to export the site frame.",
            )  # fmt: skip
        return cls(table.make(), float(np.deg2rad(longitude_deg)))

    @property
    def name(self) -> str:
        """Name of the frame in CCSDS files."""
        return SITE_FRAME_NAME if self.moon is None else MOON_FRAME_NAME

    @property
    def comments(self) -> tuple[str, ...]:
        """Sentences that define the frame."""
        if self.moon is None:
            return SITE_FRAME_COMMENTS
        latitude, longitude = np.rad2deg([self.moon.latitude, self.longitude])
        return (
            f"{MOON_FRAME_NAME}: origin at the centre of a spherical Moon, fixed to the Moon.",
            f"Origin of the site frame: latitude {latitude:.9g} deg, longitude {longitude:.9g} deg "
            f"east, radius {self.moon.radius:.9g} m.",
        )

    @cached_property
    def rotation(self) -> Array:
        """Matrix (3, 3) from the site frame to this frame."""
        if self.moon is None:
            return np.eye(3)
        (c, s), (cl, sl) = (
            (np.cos(angle), np.sin(angle)) for angle in (self.moon.latitude, self.longitude)
        )
        east, north, up = (-sl, cl, 0.0), (-s * cl, -s * sl, c), (c * cl, c * sl, s)
        return np.column_stack((east, north, up))

    def positions(self, positions: Array) -> Array:
        """Convert positions (n, 3), m, from the site frame to this frame."""
        if self.moon is None:
            return positions
        return np.asarray((positions + np.array([0.0, 0.0, self.moon.radius])) @ self.rotation.T)

    def vectors(self, vectors: Array) -> Array:
        """Rotate vectors (n, 3) from the site frame to this frame."""
        return vectors if self.moon is None else np.asarray(vectors @ self.rotation.T)

    def attitudes(self, attitudes: Array) -> Array:
        """Convert quaternions (n, 4), body to site frame, to body to this frame."""
        if self.moon is None:
            return attitudes
        turn = np.broadcast_to(matrix_to_quat(self.rotation), attitudes.shape)
        return quat_multiply(turn, attitudes)

    def covariances(self, covariances: Array) -> Array:
        """Rotate covariances (n, 6, 6) of position and velocity to this frame."""
        turn = np.kron(np.eye(2), self.rotation)
        return np.asarray(turn @ covariances @ turn.T)
