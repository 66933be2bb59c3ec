"""When a policy is asked, and what it chooses from."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity


@dataclass(frozen=True)
class Decisions:
    """When a policy is asked, on which map, and what it chooses from.

    Attributes
    ----------
    map
        Name of the mapper; empty: the first.
    first_altitude, last_altitude
        Between which decisions are due, m above the site.
    interval
        s.
    candidates, separation
        Number of sites and least distance between them, m.
    touchdown_sigma
        Expected miss on the map, an axis, m, of a lander that does not drift over it; see
        `expected_miss`.
    """

    map: str = quantity("", help="name of the mapper that decides; left out: the first")
    first_altitude: float = quantity(400.0, "m", gt=0, help="above the site")
    last_altitude: float = quantity(50.0, "m", gt=0, help="above the site")
    interval: float = quantity(1.0, "s", gt=0, help="between two decisions")
    candidates: int = quantity(16, ge=1, le=256, help="sites to choose from")
    separation: float = quantity(3.0, "m", gt=0, help="least distance between them")
    touchdown_sigma: float = quantity(
        0.3, "m", ge=0, help="expected miss on the map, an axis, without drift"
    )

    def __post_init__(self) -> None:
        if self.last_altitude >= self.first_altitude:
            raise InputError(
                "last_altitude", self.last_altitude, f"less than {self.first_altitude}"
            )
