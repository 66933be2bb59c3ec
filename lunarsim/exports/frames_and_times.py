"""Frames and times of exported files."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.exports.formats import DEFAULT_EPOCH, ExportOptions
from lunarsim.frames import enu_axes, matrix_to_quat, quat_multiply
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


@dataclass(frozen=True)
class Epoch:
    """Epoch of the start of a flight.

    Attributes
    ----------
    text
        Date and time (UTC), ISO 8601.
    comment
        Sentences that state where the epoch comes from.
    """

    text: str
    comment: str

    @classmethod
    def of(cls, flight: Flight, options: ExportOptions) -> Epoch:
        """Return the given epoch, the time of the scenario's site, or a default.

        Raises
        ------
        InputError
            If the time of the site is outside the years of the exports.
        """
        place = _place(flight)
        site = None if place is None or place.site is None else place.site.make()
        dated = None if site is None or site.time is None else site
        if options.epoch is not None or dated is None:
            text = options.epoch or DEFAULT_EPOCH
            source = "given to the export" if options.epoch else "the default of the export"
            start = "" if dated else "The scenario has no date. "
            return cls(text, f"{start}The epoch of the start ({text}) is {source}.")
        text = str(np.datetime_as_string(dated.date))
        try:
            ExportOptions(text)
        except InputError as error:
            remedy = "Give another date with --epoch."
            raise InputError("site.time", dated.time, error.problem, remedy) from None
        return cls(text, f"The epoch of the start ({text}) is site.time of the scenario.")

    @property
    def date(self) -> np.datetime64:
        """Epoch as a date with nanoseconds."""
        return np.datetime64(self.text.removesuffix("Z"), "ns")


def _place(flight: Flight) -> Scenario | None:
    """Return a scenario with only [site] and [moon] of a flight; None without [site].

    Other tables are not read, because they may name modules that this process does not allow.
    """
    try:
        tables = tomllib.loads(flight.scenario)
    except tomllib.TOMLDecodeError:  # a record from others
        return None
    if "site" not in tables:
        return None
    given: dict[str, Any] = {name: tables[name] for name in ("site", "moon") if name in tables}
    return Scenario.world_from_toml(tomli_w.dumps(given))


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
        """Return the frame for a longitude, deg.

        None: the longitude of the scenario's site if it also has a table [moon], otherwise the site
        frame.

        Raises
        ------
        InputError
            If a longitude is given but the scenario has no table [moon].
        """
        if longitude_deg is None:
            place = _place(flight)
            if place is None or place.site is None or place.moon is None:
                return cls()
            return cls(place.moon.make(), place.site.make().longitude)
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
        return enu_axes(self.moon.latitude, self.longitude)

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
