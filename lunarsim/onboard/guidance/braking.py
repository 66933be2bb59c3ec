"""Braking: the phase before the approach, with a law and an end of its own (as P63)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.onboard.guidance.apollo import jerk_time_to_go
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts import resolve, settings_of
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Braking:
    """Braking to a point before the site, from which the approach begins.

    Attributes
    ----------
    law
        Kind of guidance law, with its own defaults.
    end_position, end_velocity, end_acceleration
        Where it aims (3,), ENU, m from the site, m/s, m/s^2; the approach begins sooner.
    time_to_go
        At the start, s.
    jerk
        Downrange at the end, m/s^3: the time-to-go follows from it every cycle by Klumpp's cubic.
        None: the time-to-go of the start runs down.
    ends_at
        Time-to-go at which the approach begins, s.
    max_tilt
        Of the thrust, rad.
    """

    law: str = quantity("apollo", help="kind of guidance")
    end_position: tuple[float, float, float] = quantity(
        (-600.0, 0.0, 500.0), "m", help="aimed at, from the site"
    )
    end_velocity: tuple[float, float, float] = quantity((28.0, 0.0, -18.0), "m/s", help="there")
    end_acceleration: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m/s^2", help="there; gravity included"
    )
    time_to_go: float = quantity(60.0, "s", gt=0, le=10_000, help="at the start")
    jerk: float | None = quantity(
        None, "m/s^3", help="downrange at the end, sets the time-to-go; left out: it runs down"
    )
    ends_at: float = quantity(2.0, "s", ge=0, help="time-to-go at which the approach begins")
    max_tilt: float = quantity(80.0, "deg", gt=0, lt=90, help="of the thrust")

    def __post_init__(self) -> None:
        check_bounds(self, "braking")
        if self.ends_at >= self.time_to_go:
            raise InputError("braking.ends_at", self.ends_at, f"less than {self.time_to_go} s")
        self.part()

    def part(self) -> Any:
        """Return the law's part, with its defaults."""
        return settings_of(resolve("guidance", self.law, "braking.law"))().make()

    def end(self, site: ArrayLike) -> PhaseEnd:
        """Return where it aims for a site (3,), local frame."""
        return PhaseEnd(
            np.asarray(site, dtype=np.float64) + np.asarray(self.end_position),
            np.asarray(self.end_velocity, dtype=np.float64),
            np.asarray(self.end_acceleration, dtype=np.float64),
        )

    def time_left(self, estimate: Estimate, end: PhaseEnd, guess: float) -> float:
        """Return the time-to-go (s) by the jerk wanted at the end, or the guess itself.

        Downrange is along the end's velocity over ground. Where the cubic has no root within a
        third of the guess the guess stays.
        """
        along = end.velocity[:2]
        speed = float(np.hypot(*along))
        if self.jerk is None or speed == 0.0 or guess <= self.ends_at:
            return guess
        unit = along / speed
        goal = float(unit @ end.position[:2]), speed, float(unit @ end.acceleration[:2])
        found = jerk_time_to_go(
            float(unit @ estimate.position[:2]), float(unit @ estimate.velocity[:2]), goal,
            self.jerk, guess=guess,
        )  # fmt: skip
        return found if abs(found - guess) < guess / 3.0 else guess
