"""Settings of landing-site decisions: when a policy is asked, and its candidates."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity


@dataclass(frozen=True)
class DecisionSettings:
    """Settings of landing-site decisions: schedule, hazard map and candidate sites.

    Attributes
    ----------
    map
        Name of the mapper whose map is used for decisions. Empty: the first mapper that combines
        other maps, else the first mapper.
    first_altitude, last_altitude
        Altitudes of the first and last decision above the site, m.
    interval
        Time between two decisions, s.
    candidates
        Number of candidate sites selected by safety.
    separation
        Minimum distance between candidate sites, m.
    touchdown_sigma
        Expected landing error of a lander that does not drift relative to its map, 1 sigma per
        axis, m.
    """

    map: str = quantity(
        "",
        help="Name of the mapper whose map is used for decisions; empty: the first mapper that "
        "combines other maps, or else the first mapper",
    )
    first_altitude: float = quantity(
        400.0,
        "m",
        gt=0,
        help="Height above the site at which the first landing-site decision is made",
    )
    last_altitude: float = quantity(
        50.0,
        "m",
        gt=0,
        help="Height above the site at which the last landing-site decision is made",
    )
    interval: float = quantity(1.0, "s", gt=0, help="Time between two landing-site decisions")
    candidates: int = quantity(
        16,
        ge=1,
        le=256,
        help="Maximum number of candidate sites selected for the highest p_safe (probability of "
        "safe terrain); the nearest site with p_safe of 0.99, 0.95, 0.8 and 0.5 each, and the "
        "sites that the mapper ranks, are added",
    )
    separation: float = quantity(
        3.0,
        "m",
        gt=0,
        help="Minimum distance between the candidate sites selected for the highest p_safe",
    )
    touchdown_sigma: float = quantity(
        0.3,
        "m",
        ge=0,
        help="Expected landing error of guidance and map, 1 sigma per axis; drift of the position "
        "estimate relative to the map is added to it",
    )

    def __post_init__(self) -> None:
        if self.last_altitude >= self.first_altitude:
            raise InputError(
                "last_altitude_m",
                self.last_altitude,
                f"must be less than first_altitude_m, which is {self.first_altitude:g} m",
            )
