"""Settings of the decisions: when a policy is asked, and its candidates."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity


@dataclass(frozen=True)
class DecisionSettings:
    """Settings of the decisions: schedule, decision map and candidate sites.

    Attributes
    ----------
    map
        Name of the mapper whose map is used; empty: see `Outlook.decisions_map`.
    first_altitude, last_altitude
        Altitudes of the first and last decision above the site, m.
    interval
        Time between two decisions, s.
    candidates
        Number of candidate sites.
    separation
        Minimum distance between candidate sites, m.
    touchdown_sigma
        Expected miss of a lander that does not drift relative to its map, 1 sigma per axis, m; see
        `expected_miss`.
    """

    map: str = quantity("", help="Mapper whose map is used for decisions")
    first_altitude: float = quantity(
        400.0, "m", gt=0, help="Altitude of the first decision above the site"
    )
    last_altitude: float = quantity(
        50.0, "m", gt=0, help="Altitude of the last decision above the site"
    )
    interval: float = quantity(1.0, "s", gt=0, help="Time between two decisions")
    candidates: int = quantity(16, ge=1, le=256, help="Number of candidate sites")
    separation: float = quantity(3.0, "m", gt=0, help="Minimum distance between candidate sites")
    touchdown_sigma: float = quantity(
        0.3, "m", ge=0, help="Expected miss on the map without drift, 1 sigma per axis"
    )

    def __post_init__(self) -> None:
        if self.last_altitude >= self.first_altitude:
            raise InputError(
                "last_altitude",
                self.last_altitude,
                f"must be less than first_altitude, {self.first_altitude:g} m",
            )
