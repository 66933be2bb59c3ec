"""Tables of the mission: where flights start and land, and the clock."""

from __future__ import annotations

from dataclasses import dataclass

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity

_MOST_CYCLES = 1_000_000
# No approach starts farther away, m, or faster, m/s: it could not be flown over level ground.
_FARTHEST, _FASTEST = 1e6, 1e4


@dataclass(frozen=True)
class Start:
    """Where a flight begins, relative to the ground at its target.

    Attributes
    ----------
    position, velocity
        Planned (3,), ENU, m and m/s.
    heading
        Azimuth of body x, held through the flight, rad.
    position_sigma, velocity_sigma
        By which the true start differs from the plan, an axis, m and m/s.
    """

    position: tuple[float, float, float] = quantity(
        (-600.0, 0.0, 500.0), "m", ge=-_FARTHEST, le=_FARTHEST, help="planned"
    )
    velocity: tuple[float, float, float] = quantity(
        (28.0, 0.0, -18.0), "m/s", ge=-_FASTEST, le=_FASTEST, help="planned"
    )
    heading: float = quantity(90.0, "deg", help="azimuth of body x, held through the flight")
    position_sigma: float = quantity(10.0, "m", ge=0, help="of the true start, an axis")
    velocity_sigma: float = quantity(0.5, "m/s", ge=0, help="of the true start, an axis")


@dataclass(frozen=True)
class StartKnowledge:
    """By how much the start that the computer is told differs from the true one, an axis.

    Attributes
    ----------
    position, velocity, attitude
        Standard deviations, m, m/s, rad.
    ground
        Of the target's elevation as the mission knows it, m.
    """

    position: float = quantity(5.0, "m", ge=0, le=1e5, help="1 sigma an axis")
    velocity: float = quantity(0.02, "m/s", ge=0, le=1e3, help="1 sigma an axis")
    attitude: float = quantity(0.03, "deg", ge=0, le=30, help="1 sigma an axis")
    ground: float = quantity(
        0.0, "m", ge=0, le=1e4, help="of the target's elevation as told, 1 sigma"
    )


@dataclass(frozen=True)
class MissionTarget:
    """The landing site before any divert.

    Attributes
    ----------
    position
        East and north (2,), m.
    scatter
        Half sides of a uniform scatter (2,), m.
    """

    position: tuple[float, float] = quantity((0.0, 0.0), "m", help="east and north")
    scatter: tuple[float, float] = quantity(
        (0.0, 0.0), "m", ge=0, help="half sides of a uniform scatter, east and north"
    )


@dataclass(frozen=True)
class Clock:
    """Steps, cycles and the end of a flight.

    Attributes
    ----------
    step
        Of the integration, of inertial units and of the attitude loop, s.
    cycle
        Of the onboard computer, s.
    max_time
        A flight that is not over by then is, s.
    """

    step: float = quantity(
        0.01, "s", ge=1e-4, le=1, help="of integration, inertial unit, attitude loop"
    )
    cycle: float = quantity(0.1, "s", gt=0, le=1, help="of the onboard computer")
    max_time: float = quantity(
        300.0, "s", gt=0, le=1e5, help="a flight that is not over by then is"
    )

    def __post_init__(self) -> None:
        steps = self.cycle / self.step
        if steps < 1.0 or abs(steps - round(steps)) > 1e-6:
            raise InputError("cycle", self.cycle, f"a whole number of steps of {self.step} s")
        if self.max_time / self.cycle > _MOST_CYCLES:
            raise InputError(
                "max_time", self.max_time,
                f"at most {_MOST_CYCLES} cycles of {self.cycle} s: each is a row of the record",
            )  # fmt: skip

    @property
    def steps(self) -> int:
        """Steps in a cycle."""
        return round(self.cycle / self.step)
