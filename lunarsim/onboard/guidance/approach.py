"""Ends and constraints of the approach and of the vertical descent after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.divert_cost import PathLimits
from lunarsim.parts.quantity import check_bounds, quantity

# The lander is near the terrain below this multiple of the altitude at which the approach ends.
_NEAR_TERRAIN_RATIO = 2.0
# Height above the end of the approach from which it can begin again: this multiple of the height
# of the glideslope, plus this height, m.
_GLIDESLOPE_CLEARANCE, _MIN_APPROACH_HEIGHT_M = 1.2, 3.0


@dataclass(frozen=True)
class Approach:
    """Settings of the approach phase, which ends above the site.

    Its end has the speed of the vertical descent that follows.

    Attributes
    ----------
    vertical_altitude, vertical_speed
        Altitude of the footpads (m) and downward speed (m/s) at the end of the approach.
    descent_speed
        Speed of the vertical descent, m/s; None: `vertical_speed`.
    arrival_acceleration
        Acceleration at the end of the approach (3,), ENU, m/s^2; it shapes the path.
    arrival_offset, arrival_velocity
        Horizontal offset from the site, m, and horizontal velocity, m/s, at the end of the
        approach (2,), east and north.
    time_to_go
        Fixed initial time-to-go, s; None: the admissible time with minimum propellant.
    jerk
        Downrange jerk at the end, m/s^3. The time-to-go follows from it in every cycle by Klumpp's
        cubic, as in Apollo's program P64. It needs an `arrival_velocity` to define downrange. None:
        the time-to-go counts down.
    end_time_to_go
        Time-to-go at which the approach ends and the vertical descent begins, s.
    takeover_altitude
        Altitude of the footpads at which the approach ends regardless of time-to-go, as in a pilot
        takeover, m.
    max_late_postponement
        Maximum postponement of the landing by a new time-to-go to the same site, below twice
        `vertical_altitude`, s.
    max_tilt, glideslope, reserve, throttle_margin, lower_throttle_margin
        Path constraints: maximum tilt of the thrust and minimum elevation of the path seen from its
        end, rad, propellant reserve, kg, and fractions of the thrust range reserved for feedback at
        its upper and its lower end (None: as at the upper end).
    """

    vertical_altitude: float = quantity(
        10.0, "m", gt=0, help="height of the footpads above the site at the end of the approach"
    )
    vertical_speed: float = quantity(
        2.0, "m/s", gt=0, help="downward speed at the end of the approach"
    )
    descent_speed: float | None = quantity(
        None,
        "m/s",
        gt=0,
        help="speed of the vertical descent that follows the approach; omitted: vertical_speed_m_s",
    )
    arrival_acceleration: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0),
        "m/s^2",
        help="total acceleration (thrust and gravity) at the end of the approach (ENU)",
    )
    arrival_offset: tuple[float, float] = quantity(
        (0.0, 0.0),
        "m",
        help="horizontal position of the end of the approach relative to the site (east, north)",
    )
    arrival_velocity: tuple[float, float] = quantity(
        (0.0, 0.0), "m/s", help="horizontal velocity at the end of the approach (east, north)"
    )
    time_to_go: float | None = quantity(
        None,
        "s",
        ge=1,
        le=10_000,
        help="time-to-go at the start of the approach; omitted: the time with minimum propellant",
    )
    jerk: float | None = quantity(
        None,
        "m/s^3",
        help="downrange jerk at the end of the approach, which determines the time-to-go in every "
        "control cycle; omitted: the time-to-go counts down from its initial value",
    )
    end_time_to_go: float = quantity(
        0.0, "s", ge=0, help="time-to-go at which the approach ends and the vertical descent begins"
    )
    takeover_altitude: float = quantity(
        0.0,
        "m",
        ge=0,
        help="height of the footpads above the site at which the approach ends before it reaches "
        "vertical_altitude_m, as in a takeover by a pilot; 0: no such end",
    )
    max_late_postponement: float = quantity(
        5.0,
        "s",
        ge=0,
        help="maximum postponement of the landing by a new time-to-go to the same site, if the "
        "height of the footpads is below twice vertical_altitude_m",
    )
    max_tilt: float = quantity(
        40.0, "deg", gt=0, lt=85, help="maximum angle of the thrust from the vertical"
    )
    glideslope: float = quantity(
        8.0,
        "deg",
        ge=0,
        lt=80,
        help="minimum angle between the horizontal and the line from the end of the approach to "
        "the lander",
    )
    reserve: float = quantity(
        15.0, "kg", ge=0, help="propellant that must remain at the end of the approach"
    )
    throttle_margin: float = quantity(
        0.08,
        ge=0,
        lt=0.5,
        help="fraction of the thrust range, at its upper end, that planned paths reserve for "
        "feedback",
    )
    lower_throttle_margin: float | None = quantity(
        None,
        ge=0,
        lt=0.5,
        help="fraction of the thrust range, at its lower end, that planned paths reserve for "
        "feedback; omitted: throttle_margin",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "approach")
        if self.jerk is not None and not any(self.arrival_velocity):
            raise InputError(
                "approach.arrival_velocity", self.arrival_velocity,
                "must not be zero if jerk_m_s3 is set",
                "The direction of this velocity defines downrange.",
            )  # fmt: skip

    @property
    def vertical_descent_speed(self) -> float:
        """Downward speed of the vertical descent, m/s."""
        return self.descent_speed or self.vertical_speed

    @property
    def has_free_time_to_go(self) -> bool:
        """Whether the onboard computer chooses the time-to-go by propellant cost.

        It is False if the settings fix the time-to-go or the jerk.
        """
        return self.time_to_go is None and self.jerk is None

    def is_finished(self, altitude: float, time_to_go: float) -> bool:
        """Return whether the approach is over at an altitude (m) and a time-to-go (s).

        `altitude` is that of the footpads above the site. The approach is over at or below
        `vertical_altitude` or `takeover_altitude`, or if the time-to-go is at most
        `end_time_to_go`.
        """
        end = max(self.vertical_altitude, self.takeover_altitude)
        return altitude <= end or time_to_go <= self.end_time_to_go

    def is_cut_short(self, altitude: float, time_to_go: float) -> bool:
        """Return whether the settings end an approach before it reaches its end.

        `takeover_altitude` or `end_time_to_go` does so at an altitude (m) and a time-to-go (s).
        """
        return altitude > self.vertical_altitude and time_to_go > 0.0

    def allows_postponement(self, seconds: float, altitude: float) -> bool:
        """Return whether the landing may be postponed by `seconds` at an altitude (m)."""
        near = altitude < _NEAR_TERRAIN_RATIO * self.vertical_altitude
        return not near or seconds <= self.max_late_postponement

    def hover_height(self, distance: float) -> float:
        """Return the height (m) from which an approach can begin again.

        It is above the site, for the footpads. `distance` is the horizontal distance from the site,
        m; the lander must be above the glideslope of the next approach.
        """
        rise = _GLIDESLOPE_CLEARANCE * distance * float(np.tan(self.glideslope))
        return self.vertical_altitude + rise + _MIN_APPROACH_HEIGHT_M

    @property
    def limits(self) -> PathLimits:
        """Constraints on thrust, tilt, glideslope and propellant of the path."""
        return PathLimits(
            self.max_tilt, self.glideslope, self.reserve, self.throttle_margin,
            self.lower_throttle_margin,
        )  # fmt: skip

    def end(self, sites: ArrayLike, lander: Lander) -> PhaseEnd:
        """Return the end state of the approach to one site (3,) or to sites (n, 3).

        Sites are in the local frame, m; `lander` gives the height of the centre of mass.
        """
        above = np.array([*self.arrival_offset, self.vertical_altitude + lander.com_height])
        return PhaseEnd(
            np.asarray(sites, dtype=np.float64) + above,
            np.array([*self.arrival_velocity, -self.vertical_speed]),
            np.asarray(self.arrival_acceleration, dtype=np.float64),
        )

    def touchdown_end(self, site: ArrayLike, lander: Lander) -> PhaseEnd:
        """Return the end state of the vertical descent to a site (3,), local frame, m.

        `lander` gives the height of the centre of mass.
        """
        stand = np.array([0.0, 0.0, lander.com_height])
        return PhaseEnd(
            np.asarray(site, dtype=np.float64) + stand,
            np.array([0.0, 0.0, -self.vertical_descent_speed]),
        )
