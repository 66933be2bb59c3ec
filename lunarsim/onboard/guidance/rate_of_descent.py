"""P66: the computer holds a rate of descent that the pilot sets in clicks, and he flies the rest.

The vertical channel is first order, ``a = g + (v_wanted - v) / tau``; a click of the switch changes
what is wanted by 1 ft/s. The pilot is a simple model: he wants a rate in proportion to height
between two limits, clicks once a second at most, and leans the lander to take out what speed over
ground he does not want, in steps and after a delay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.contract import PhaseEnd, refuse_unknown
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import check_bounds, quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RateOfDescent:
    """Rate of descent by a pilot's clicks (P66), attitude by the pilot's hand.

    Attributes
    ----------
    time_constant
        Of the vertical channel, s.
    click
        Change of the wanted rate by one click, m/s.
    click_interval
        Between two clicks at least, s.
    descent_time
        The pilot wants height over this as rate of descent, s.
    fastest
        Rate of descent that he does not exceed, m/s; the slowest is the phase's own.
    look_interval
        Between two looks at the speed over ground, s.
    speed_time
        Speed over ground that he wants is the distance to the site over this, s.
    still_height
        Below it he wants no speed over ground, wherever the site is, m.
    lean_time
        He leans so as to take a wrong speed out in this time, s.
    max_lean
        Greatest lean, rad.
    hold_speed
        While the speed over ground is above it he wants to keep his height, m/s; None: he comes
        down whatever it is.
    beyond
        He wants to come down so far beyond the site, along the way flown when he takes over, m.
    """

    time_constant: float = quantity(1.5, "s", gt=0, help="of the vertical channel")
    click: float = quantity(0.3048, "m/s", gt=0, help="change of the rate by one click")
    click_interval: float = quantity(1.0, "s", gt=0, help="between two clicks at least")
    descent_time: float = quantity(10.0, "s", gt=0, help="rate wanted is height over this")
    fastest: float = quantity(4.5, "m/s", gt=0, help="rate of descent not exceeded")
    look_interval: float = quantity(0.5, "s", gt=0, help="between looks at speed over ground")
    speed_time: float = quantity(8.0, "s", gt=0, help="speed wanted is distance over this")
    still_height: float = quantity(10.0, "m", ge=0, help="below it he wants no speed over ground")
    lean_time: float = quantity(3.0, "s", gt=0, help="in which a wrong speed is taken out")
    max_lean: float = quantity(15.0, "deg", gt=0, lt=60, help="of the thrust")
    hold_speed: float | None = quantity(
        None, "m/s", gt=0, help="over ground, above it he keeps his height; left out: never"
    )

    beyond: float = quantity(
        0.0, "m", ge=0, help="he comes down so far beyond the site, along the way flown at first"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "descent")

    def build(self, briefing: Briefing, lag: float) -> RateOfDescentLaw:
        """Return the law of one flight."""
        return RateOfDescentLaw(self, briefing.weight)


class RateOfDescentLaw:
    """P66 and its pilot in flight; see `RateOfDescent`.

    Attributes
    ----------
    wanted
        Rate of descent that is held, m/s, down; None before the first command.
    clicks
        How often the switch was clicked.
    """

    def __init__(self, settings: RateOfDescent, gravity: float) -> None:
        self.settings = settings
        self.gravity = gravity
        self.wanted: float | None = None
        self.clicks = 0
        self._next_click = self._next_look = -np.inf
        self._sideways = np.zeros(2)
        self._beyond = np.zeros(2)

    @property
    def lean(self) -> float:
        """Greatest lean of the thrust, rad."""
        return self.settings.max_lean

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2."""
        refuse_unknown(estimate, end)
        s = self.settings
        height = float(estimate.position[2] - end.position[2])
        if self.wanted is None:
            self.wanted = -float(estimate.velocity[2])  # P66 takes over the rate that it finds
            way = estimate.velocity[:2]
            self._beyond = s.beyond * way / max(float(np.hypot(*way)), 1e-6)
        slowest = abs(float(end.velocity[2]))
        aim = min(max(height / s.descent_time, slowest), max(s.fastest, slowest))
        if s.hold_speed is not None and np.hypot(*estimate.velocity[:2]) > s.hold_speed:
            aim = 0.0
        if time >= self._next_click - 1e-9 and abs(aim - self.wanted) > 0.5 * s.click:
            self.wanted += float(np.copysign(s.click, aim - self.wanted))
            self.clicks += 1
            self._next_click = time + s.click_interval
        if time >= self._next_look - 1e-9:
            self._look(estimate, end)
            self._next_look = time + s.look_interval
        up = self.gravity + (-self.wanted - float(estimate.velocity[2])) / s.time_constant
        return np.array([*self._sideways, max(up, 0.3 * self.gravity)])

    def _look(self, estimate: Estimate, end: PhaseEnd) -> None:
        """Choose a lean by how the lander drifts now."""
        s = self.settings
        low = estimate.position[2] - end.position[2] < s.still_height
        share = 0.0 if low else 1.0 / s.speed_time
        wanted = share * (end.position[:2] + self._beyond - estimate.position[:2])
        push = (wanted - estimate.velocity[:2]) / s.lean_time
        size, most = float(np.hypot(*push)), self.gravity * np.tan(s.max_lean)
        self._sideways = np.asarray(push * (most / size) if size > most else push)
