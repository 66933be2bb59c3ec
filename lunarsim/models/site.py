"""Place and date of a landing: latitude, longitude and time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.parts.quantity import check_bounds, quantity

# Years in which the ephemeris (`lunarsim.world.ephemeris`) is accurate.
FIRST_YEAR, LAST_YEAR = 1900, 2100
_TIME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d(?::\d\d(?:\.\d{1,6})?)?)(Z|\+00:00|)")
_EXAMPLE = '"2027-03-01T12:00Z"'


@dataclass(frozen=True)
class LandingSite:
    """Place on the Moon, and date of the flight.

    Attributes
    ----------
    latitude, longitude
        Planetocentric latitude and longitude of the origin of the site frame in the frame MOON_ME,
        rad; positive north and east.
    time
        Date and time (UTC) of the start of the flight, ISO 8601 with Z; None: no date.
    """

    # Both are required; without a default, a dataclass field could not have a bound.
    latitude: float = quantity(
        None, "deg", ge=-90, le=90,
        help="planetocentric latitude of the site frame's origin (MOON_ME); positive: north",
    )  # fmt: skip
    longitude: float = quantity(
        None, "deg", ge=-180, le=360,
        help="longitude of the site frame's origin (MOON_ME); positive: east",
    )  # fmt: skip
    time: str | None = quantity(
        None,
        help="date and time (UTC) of the start of the flight, such as 2027-03-01T12:00Z; it gives "
        "the directions of Sun and Earth; omitted: no date",
    )

    def __post_init__(self) -> None:
        for name in ("latitude", "longitude"):
            if getattr(self, name) is None:
                raise InputError(f"site.{name}", None, "is required", show_value=False)
        check_bounds(self, "site")
        if self.time is not None:
            parse_time("site.time", self.time)

    @staticmethod
    def convert_table(table: Any) -> Any:
        """Return a table of a scenario file with a date of TOML as a text."""
        if isinstance(table, Mapping) and isinstance(table.get("time"), date):
            return {**table, "time": table["time"].isoformat().replace("+00:00", "Z")}
        return table

    @property
    def date(self) -> np.datetime64 | None:
        """Date and time (UTC) in microseconds; None without a date."""
        return None if self.time is None else parse_time("site.time", self.time)


def parse_time(field: str, text: str) -> np.datetime64:
    """Return the date (UTC, microseconds) of an ISO 8601 text.

    Raises
    ------
    InputError
        If the text is no date and time with Z, or its year is not from 1900 to 2100. The error
        names `field`.
    """
    found = _TIME.fullmatch(text)
    try:
        parsed = None if found is None else datetime.fromisoformat(found[1])
    except ValueError:
        parsed = None
    if found is None or parsed is None:
        raise InputError(
            field, text, "must be a date and time (UTC) in ISO 8601", f"Example: {_EXAMPLE}."
        )
    if not found[2]:
        raise InputError(
            field,
            text,
            "must state its time zone",
            f"Add Z to a time in UTC, as in {_EXAMPLE}.",
        )
    if not FIRST_YEAR <= parsed.year <= LAST_YEAR:
        raise InputError(
            field, text,
            f"must be from {FIRST_YEAR} to {LAST_YEAR}, the years of the ephemeris",
        )  # fmt: skip
    return np.datetime64(parsed, "us")


def time_text(time: np.datetime64) -> str:
    """Return a date as ISO 8601 text (UTC) to the second."""
    return f"{np.datetime_as_string(time.astype('datetime64[s]'))}Z"
