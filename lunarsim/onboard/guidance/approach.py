"""The approach to a site and the vertical descent after it: where each ends, and its limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert import PathLimits
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Approach:
    """An approach that ends above the site at the speed of the vertical descent.

    Attributes
    ----------
    vertical_altitude, vertical_speed
        Where the vertical descent begins, m above the site, and the speed there, m/s.
    descent_speed
        Of the vertical descent, m/s; None: the same.
    arrival_acceleration
        At the end of the approach (3,), ENU, m/s^2; it shapes the path before it.
    arrival_offset, arrival_velocity
        Where the approach ends, from above the site, and its speed there (2,), east and north, m
        and m/s.
    time_to_go
        Fixed, s; None: the cheapest admissible.
    jerk
        Downrange at the end, m/s^3: the time-to-go follows from it every cycle by Klumpp's cubic,
        as in P64; it takes an `arrival_velocity` to say where downrange is.
    ends_at
        Time-to-go at which the vertical descent begins, s.
    takeover_altitude
        Of the pads at which it begins whatever is left to go, as when a pilot takes over, m.
    max_tilt, glideslope, reserve, throttle_margin
        See `PathLimits`.
    """

    vertical_altitude: float = quantity(10.0, "m", gt=0, help="of the pads, where it ends")
    vertical_speed: float = quantity(2.0, "m/s", gt=0, help="downward, where it ends and after")
    descent_speed: float | None = quantity(
        None, "m/s", gt=0, help="downward after it; left out: as where it ends"
    )
    arrival_acceleration: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m/s^2", help="where it ends; shapes the path before it"
    )
    arrival_offset: tuple[float, float] = quantity(
        (0.0, 0.0), "m", help="where it ends, from above the site, east and north"
    )
    arrival_velocity: tuple[float, float] = quantity(
        (0.0, 0.0), "m/s", help="over ground where it ends, east and north"
    )
    time_to_go: float | None = quantity(
        None, "s", ge=1, le=10_000, help="at the start; left out: the cheapest admissible"
    )
    jerk: float | None = quantity(
        None, "m/s^3", help="downrange at the end, sets the time-to-go; left out: it runs down"
    )
    ends_at: float = quantity(0.0, "s", ge=0, help="time-to-go at which it ends")
    takeover_altitude: float = quantity(
        0.0, "m", ge=0, help="of the pads, where it ends whatever is left to go"
    )
    max_tilt: float = quantity(40.0, "deg", gt=0, lt=85, help="of the thrust")
    glideslope: float = quantity(8.0, "deg", ge=0, lt=80, help="least elevation of the path")
    reserve: float = quantity(15.0, "kg", ge=0, help="propellant left at the end")
    throttle_margin: float = quantity(
        0.08, ge=0, lt=0.5, help="share of the thrust range kept back for feedback"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "approach")
        if self.jerk is not None and not any(self.arrival_velocity):
            raise InputError(
                "approach.arrival_velocity", self.arrival_velocity,
                "a speed over ground with jerk: it tells where downrange is",
            )  # fmt: skip

    @property
    def rate(self) -> float:
        """Speed of the vertical descent, m/s, downward."""
        return self.descent_speed or self.vertical_speed

    @property
    def free(self) -> bool:
        """Whether its time-to-go is chosen by what it costs."""
        return self.time_to_go is None and self.jerk is None

    def over(self, altitude: float, time_to_go: float) -> bool:
        """Tell whether it is over at an altitude of the pads (m) and a time-to-go (s)."""
        end = max(self.vertical_altitude, self.takeover_altitude)
        return altitude <= end or time_to_go <= self.ends_at

    @property
    def limits(self) -> PathLimits:
        """What its path must respect."""
        return PathLimits(self.max_tilt, self.glideslope, self.reserve, self.throttle_margin)

    def end(self, sites: ArrayLike, lander: Lander) -> PhaseEnd:
        """Return where the approach to sites (3,) or (n, 3) ends, local frame."""
        above = np.array([*self.arrival_offset, self.vertical_altitude + lander.com_height])
        return PhaseEnd(
            np.asarray(sites, dtype=np.float64) + above,
            np.array([*self.arrival_velocity, -self.vertical_speed]),
            np.asarray(self.arrival_acceleration, dtype=np.float64),
        )

    def ground(self, site: ArrayLike, lander: Lander) -> PhaseEnd:
        """Return where the vertical descent to a site (3,) ends, local frame."""
        stand = np.array([0.0, 0.0, lander.com_height])
        return PhaseEnd(
            np.asarray(site, dtype=np.float64) + stand, np.array([0.0, 0.0, -self.rate])
        )
