"""Braking: the phase before the approach, with its own law and end (as P63)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.messages.commands import Command
from lunarsim.models.lander import Lander
from lunarsim.onboard.component_errors import checked_command
from lunarsim.onboard.control.thrust import (
    thrust_along,
    thrust_lift_first,
    thrust_to_command,
)
from lunarsim.onboard.guidance.apollo import time_to_go_for_jerk
from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts import resolve, settings_of
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class Braking:
    """Settings of the braking phase, at whose end the approach begins.

    Attributes
    ----------
    law
        Kind of the guidance law, which uses its default settings.
    end_position, end_velocity, end_acceleration
        Aim point of braking (3,), ENU: position relative to the site, m, velocity, m/s, and
        acceleration, m/s^2. The approach begins `end_time_to_go` before it.
    time_to_go
        Initial time-to-go, s.
    jerk
        Downrange jerk at the end, m/s^3; the time-to-go follows from it in every cycle by Klumpp's
        cubic. None: the initial time-to-go counts down.
    end_time_to_go
        Time-to-go to the aim point of braking at which the approach begins, s.
    max_tilt
        Maximum tilt of the thrust from the site's vertical, rad.
    keeps_thrust_direction
        Whether saturated thrust keeps its direction. If not, its vertical component is kept.
    min_thrust_time
        Time at minimum thrust after the start, s.
    """

    law: str = quantity(
        "apollo",
        help="guidance law for braking, with its default settings: a name from `lunarsim parts "
        "guidance`",
    )
    end_position: tuple[float, float, float] = quantity(
        (-600.0, 0.0, 500.0), "m", help="aim point of braking, relative to the landing site (ENU)"
    )
    end_velocity: tuple[float, float, float] = quantity(
        (28.0, 0.0, -18.0), "m/s", help="velocity at the aim point of braking (ENU)"
    )
    end_acceleration: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0),
        "m/s^2",
        help="total acceleration (thrust and gravity) at the aim point of braking (ENU)",
    )
    time_to_go: float = quantity(
        60.0, "s", gt=0, le=10_000, help="time-to-go to the aim point at the start of braking"
    )
    jerk: float | None = quantity(
        None,
        "m/s^3",
        help="downrange jerk at the aim point of braking, which determines the time-to-go in every "
        "control cycle; omitted: the time-to-go counts down from its initial value",
    )
    end_time_to_go: float = quantity(
        2.0,
        "s",
        ge=0,
        help="time-to-go to the aim point at which braking ends and the approach begins",
    )
    max_tilt: float = quantity(
        80.0,
        "deg",
        gt=0,
        lt=180,
        help="maximum angle between the thrust and the vertical of the landing site, during all of "
        "the braking",
    )
    keeps_thrust_direction: bool = quantity(
        False,
        help="whether a thrust command above the maximum thrust keeps its direction; false: it "
        "keeps its vertical component, and the horizontal component gets the remaining thrust",
    )
    min_thrust_time: float = quantity(
        0.0, "s", ge=0, help="duration of minimum thrust at the start of braking; 0: none"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "braking")
        if self.end_time_to_go >= self.time_to_go:
            raise InputError(
                "braking.end_time_to_go_s", self.end_time_to_go,
                f"must be less than time_to_go_s, which is {self.time_to_go:g} s",
            )  # fmt: skip
        self.law_settings()

    def law_settings(self) -> Any:
        """Return the settings of the guidance law, with default values."""
        return settings_of(resolve("guidance", self.law, "braking.law"))().make()

    def end(self, site: ArrayLike) -> PhaseEnd:
        """Return the aim point of braking for a site (3,), local frame, m."""
        return PhaseEnd(
            np.asarray(site, dtype=np.float64) + np.asarray(self.end_position),
            np.asarray(self.end_velocity, dtype=np.float64),
            np.asarray(self.end_acceleration, dtype=np.float64),
        )

    def time_left(self, estimate: Estimate, end: PhaseEnd, guess: float) -> float:
        """Return the time-to-go (s) that gives the jerk at the end, or the guess.

        The guess, s, is returned if no jerk is set, if the guess is at most `end_time_to_go`, or if
        Klumpp's cubic has no root within a third of the guess.
        """
        if self.jerk is None or guess <= self.end_time_to_go:
            return guess
        return time_to_go_for_jerk(estimate, end, self.jerk, guess)

    def build_command(
        self, acceleration: Array, mass: float, lander: Lander, heading: float, time: float
    ) -> Command:
        """Return the command for a thrust acceleration, within limits of thrust and tilt.

        `acceleration` (3,) is in m/s^2, `heading` is that of the lander, rad, and `time` the time
        since the start of the flight, s. Before `min_thrust_time` the thrust is the minimum. If
        `max_tilt` is 90 deg or more, the thrust may point downward (`thrust_lift_first`).

        Raises
        ------
        InputError
            If the law's command is not three finite numbers.
        """
        acceleration = checked_command("braking.law", self.law_settings(), acceleration, time)
        give = thrust_to_command if self.max_tilt < 0.5 * np.pi else thrust_lift_first
        give = thrust_along if self.keeps_thrust_direction else give
        command = give(acceleration, mass, lander, heading, self.max_tilt)
        trims = time < self.min_thrust_time - 1e-9
        return replace(command, thrust=lander.thrust_min) if trims else command
