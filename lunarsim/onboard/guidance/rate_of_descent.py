"""P66: rate of descent held by the computer, set by a pilot's clicks.

The pilot also controls attitude. The vertical channel is first order, ``a = g + (v_wanted - v) /
tau``. A click of the switch changes the commanded rate by 1 ft/s. The pilot model wants a rate
proportional to height between two limits and clicks at most once a second. It tilts the lander to
correct the horizontal velocity, at sampled times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RateOfDescent:
    """Rate of descent by a pilot's clicks (P66), with the pilot's attitude control.

    Attributes
    ----------
    time_constant
        Time constant of the vertical channel, s.
    click
        Change of the commanded rate per click, m/s.
    click_interval
        Minimum time between clicks, s.
    descent_time
        The desired rate of descent is height over this time, s.
    fastest
        Maximum desired rate of descent, m/s; the minimum is the final speed of the phase.
    look_interval
        Time between the pilot's checks of horizontal velocity, s.
    speed_time
        The desired horizontal velocity is the distance to the aim point over this time, s.
    still_height
        Height below which the desired horizontal velocity is zero, m.
    lean_time
        Time in which a tilt must remove the velocity error, s.
    max_lean
        Maximum tilt, rad.
    hold_speed
        Horizontal speed above which the pilot holds height, m/s; None: never.
    beyond
        Distance of the aim point beyond the site, along the initial horizontal velocity, m.
    """

    time_constant: float = quantity(1.5, "s", gt=0, help="time constant of the vertical channel")
    click: float = quantity(0.3048, "m/s", gt=0, help="change of the rate by one click")
    click_interval: float = quantity(1.0, "s", gt=0, help="minimum time between two clicks")
    descent_time: float = quantity(
        10.0, "s", gt=0, help="desired rate of descent is height over this time"
    )
    fastest: float = quantity(4.5, "m/s", gt=0, help="maximum desired rate of descent")
    look_interval: float = quantity(
        0.5, "s", gt=0, help="time between the pilot's checks of horizontal velocity"
    )
    speed_time: float = quantity(
        8.0, "s", gt=0, help="desired horizontal speed is distance over this time"
    )
    still_height: float = quantity(
        10.0, "m", ge=0, help="height below which no horizontal speed is desired"
    )
    lean_time: float = quantity(3.0, "s", gt=0, help="time to remove a horizontal velocity error")
    max_lean: float = quantity(15.0, "deg", gt=0, lt=60, help="maximum tilt of the thrust")
    hold_speed: float | None = quantity(
        None, "m/s", gt=0, help="horizontal speed above which he holds height; omitted: never"
    )

    beyond: float = quantity(
        0.0, "m", ge=0, help="distance of the aim point beyond the site, along initial velocity"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "descent")

    def build(self, briefing: Briefing, lag: float) -> RateOfDescentLaw:
        """Return the law for one flight; `lag` is that of attitude and engine, s."""
        return RateOfDescentLaw(self, briefing.weight)


class RateOfDescentLaw:
    """P66 and its pilot model for one flight, with the settings of `RateOfDescent`.

    Attributes
    ----------
    wanted
        Commanded rate of descent, m/s, downward; None before the first command.
    clicks
        Number of clicks so far.
    """

    def __init__(self, settings: RateOfDescent, gravity: float) -> None:
        self.settings = settings
        self.gravity = gravity
        self.wanted: float | None = None
        self.clicks = 0
        self._next_click = self._next_check = -np.inf
        self._horizontal = np.zeros(2)
        self._beyond = np.zeros(2)

    @property
    def lean(self) -> float:
        """Maximum tilt of the thrust, rad."""
        return self.settings.max_lean

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2."""
        require_finite_state(estimate, end)
        s = self.settings
        height = float(estimate.position[2] - end.position[2])
        if self.wanted is None:
            self.wanted = -float(estimate.velocity[2])  # P66 starts with the current rate
            velocity = estimate.velocity[:2]
            self._beyond = s.beyond * velocity / max(float(np.hypot(*velocity)), 1e-6)
        slowest = abs(float(end.velocity[2]))
        desired_rate = min(max(height / s.descent_time, slowest), max(s.fastest, slowest))
        if s.hold_speed is not None and np.hypot(*estimate.velocity[:2]) > s.hold_speed:
            desired_rate = 0.0
        if time >= self._next_click - 1e-9 and abs(desired_rate - self.wanted) > 0.5 * s.click:
            self.wanted += float(np.copysign(s.click, desired_rate - self.wanted))
            self.clicks += 1
            self._next_click = time + s.click_interval
        if time >= self._next_check - 1e-9:
            self._update_tilt(estimate, end)
            self._next_check = time + s.look_interval
        up = self.gravity + (-self.wanted - float(estimate.velocity[2])) / s.time_constant
        return np.array([*self._horizontal, max(up, 0.3 * self.gravity)])

    def _update_tilt(self, estimate: Estimate, end: PhaseEnd) -> None:
        """Choose a tilt from the current horizontal velocity."""
        s = self.settings
        low = estimate.position[2] - end.position[2] < s.still_height
        share = 0.0 if low else 1.0 / s.speed_time
        wanted = share * (end.position[:2] + self._beyond - estimate.position[:2])
        push = (wanted - estimate.velocity[:2]) / s.lean_time
        size, most = float(np.hypot(*push)), self.gravity * np.tan(s.max_lean)
        self._horizontal = np.asarray(push * (most / size) if size > most else push)
