"""P66: rate of descent held by the computer, set by a pilot's clicks.

The pilot also controls attitude. The vertical channel is first order, ``a = g + (v_wanted - v) /
tau``. A click of the switch changes the commanded rate by 1 ft/s. The pilot model wants a rate
proportional to height between two limits and clicks at most once a second. It tilts the lander to
correct the horizontal velocity, at sampled times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array


@dataclass(frozen=True)
class RateOfDescent:
    """Settings of a descent with a pilot's rate-of-descent clicks (Apollo P66).

    The pilot model also controls attitude.

    Attributes
    ----------
    time_constant
        Time constant with which the vertical velocity approaches the commanded rate, s.
    click
        Change of the commanded rate per click, m/s.
    click_interval
        Minimum time between clicks, s.
    descent_time
        The desired rate of descent is height over this time, s.
    max_rate
        Maximum desired rate of descent, m/s; the minimum is the final speed of the phase.
    check_interval
        Time between the pilot's checks of horizontal velocity, s.
    velocity_time
        The desired horizontal velocity is the distance to the aim point over this time, s.
    zero_speed_height
        Height below which the desired horizontal velocity is zero, m.
    correction_time
        Time in which a tilt must remove the velocity error, s.
    max_tilt
        Maximum tilt, rad.
    hold_height_speed
        Horizontal speed above which the pilot holds height, m/s; None: never.
    overshoot
        Distance of the pilot's aim point beyond the site, along the initial horizontal velocity, m.
    """

    time_constant: float = quantity(
        1.5,
        "s",
        gt=0,
        help="time constant with which the vertical speed approaches the commanded rate of descent",
    )
    click: float = quantity(
        0.3048,
        "m/s",
        gt=0,
        help="change of the commanded rate of descent by one click of the pilot's switch",
    )
    click_interval: float = quantity(
        1.0, "s", gt=0, help="minimum time between two clicks of the pilot's rate-of-descent switch"
    )
    descent_time: float = quantity(
        10.0,
        "s",
        gt=0,
        help="time constant of the descent: the pilot's desired rate of descent is the height "
        "above the site divided by this time",
    )
    max_rate: float = quantity(
        4.5, "m/s", gt=0, help="maximum of the pilot's desired rate of descent"
    )
    check_interval: float = quantity(
        0.5, "s", gt=0, help="time between two checks of the horizontal velocity by the pilot"
    )
    velocity_time: float = quantity(
        8.0,
        "s",
        gt=0,
        help="time constant of the horizontal approach: the pilot's desired horizontal speed is "
        "the horizontal distance to the aim point divided by this time",
    )
    zero_speed_height: float = quantity(
        10.0,
        "m",
        ge=0,
        help="height above the site below which the pilot's desired horizontal speed is zero",
    )
    correction_time: float = quantity(
        3.0,
        "s",
        gt=0,
        help="time constant with which the pilot corrects the horizontal velocity",
    )
    max_tilt: float = quantity(
        15.0, "deg", gt=0, lt=60, help="maximum angle of the thrust from the vertical"
    )
    hold_height_speed: float | None = quantity(
        None,
        "m/s",
        gt=0,
        help="horizontal speed above which the pilot stops the descent and holds the height; "
        "omitted: never",
    )

    overshoot: float = quantity(
        0.0,
        "m",
        ge=0,
        help="distance of the pilot's aim point beyond the site, along the initial horizontal "
        "velocity",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "terminal_descent")

    def build(self, briefing: Briefing, lag: float) -> RateOfDescentLaw:
        """Build the descent law of one flight; `lag` is not used."""
        return RateOfDescentLaw(self, briefing.surface_gravity)


class RateOfDescentLaw:
    """Descent law of Apollo P66 with its pilot model, for one flight.

    Attributes
    ----------
    commanded_rate
        Commanded rate of descent, m/s, downward; None before the first command.
    clicks
        Number of clicks so far.
    """

    def __init__(self, settings: RateOfDescent, gravity: float) -> None:
        self.settings = settings
        self.gravity = gravity
        self.commanded_rate: float | None = None
        self.clicks = 0
        self._next_click = self._next_check = -np.inf
        self._horizontal = np.zeros(2)
        self._beyond = np.zeros(2)

    @property
    def max_tilt(self) -> float:
        """Maximum tilt of the thrust, rad."""
        return self.settings.max_tilt

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        `end` is the touchdown state, whose velocity gives the final rate of descent; `time` is in
        s.
        """
        require_finite_state(estimate, end)
        s = self.settings
        height = float(estimate.position[2] - end.position[2])
        if self.commanded_rate is None:
            self.commanded_rate = -float(estimate.velocity[2])  # P66 starts with the current rate
            velocity = estimate.velocity[:2]
            self._beyond = s.overshoot * velocity / max(float(np.hypot(*velocity)), 1e-6)
        slowest = abs(float(end.velocity[2]))
        desired_rate = min(max(height / s.descent_time, slowest), max(s.max_rate, slowest))
        if (
            s.hold_height_speed is not None
            and np.hypot(*estimate.velocity[:2]) > s.hold_height_speed
        ):
            desired_rate = 0.0
        if (
            time >= self._next_click - 1e-9
            and abs(desired_rate - self.commanded_rate) > 0.5 * s.click
        ):
            self.commanded_rate += float(np.copysign(s.click, desired_rate - self.commanded_rate))
            self.clicks += 1
            self._next_click = time + s.click_interval
        if time >= self._next_check - 1e-9:
            self._update_tilt(estimate, end)
            self._next_check = time + s.check_interval
        up = self.gravity + (-self.commanded_rate - float(estimate.velocity[2])) / s.time_constant
        return np.array([*self._horizontal, max(up, 0.3 * self.gravity)])

    def _update_tilt(self, estimate: Estimate, end: PhaseEnd) -> None:
        """Store the horizontal acceleration that corrects the horizontal velocity.

        The desired velocity points to the pilot's aim point, and is zero at low height. The maximum
        tilt limits the acceleration. `end` is the touchdown state.
        """
        s = self.settings
        low = estimate.position[2] - end.position[2] < s.zero_speed_height
        share = 0.0 if low else 1.0 / s.velocity_time
        wanted = share * (end.position[:2] + self._beyond - estimate.position[:2])
        push = (wanted - estimate.velocity[:2]) / s.correction_time
        size, most = float(np.hypot(*push)), self.gravity * np.tan(s.max_tilt)
        self._horizontal = np.asarray(push * (most / size) if size > most else push)
