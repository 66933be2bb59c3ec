"""Gravity turn: thrust opposes velocity; speed and height vanish together.

With thrust acceleration N g opposite to the velocity, c the cosine of the angle between velocity
and down, and uniform g, the height loss until the lander stops is

    h = v^2 (1 + 2 N c + c^2) / (4 g (N^2 - 1))

(Citron, Dunin and Meissinger, "A terminal guidance technique for lunar landing", AIAA Journal 2(3),
1964). It solves ``dh/dt = -v c`` along ``v' = g c - N g``, ``v psi' = -g sin psi``. N is computed
from it in every cycle. The horizontal position of the stop is not controlled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.guidance.vertical import VerticalDescent
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array
from lunarsim.value_checks import check_finite


def gravity_turn_thrust(height: float, velocity: Array, gravity: float) -> float:
    """Return the ratio N of thrust acceleration to gravity for a gravity turn.

    With this constant ratio the lander stops after losing the given height.

    Parameters
    ----------
    height
        Height to lose, m.
    velocity
        Velocity (3,), ENU, m/s.
    gravity
        Downward acceleration, m/s^2.

    Raises
    ------
    InputError
        If the height is not positive or an argument is not finite.
    """
    speed = float(np.linalg.norm(velocity))
    if not np.isfinite(speed):
        check_finite("guidance.velocity", velocity)
    if not 0.0 < height < np.inf:
        raise InputError("guidance.height", height, "must be positive and finite")
    if speed == 0.0:
        return 1.0
    c = -float(velocity[2]) / speed
    b, w = 4.0 * gravity * height, speed * speed
    return float((w * c + np.sqrt(w * w * c * c + b * (b + w * (1.0 + c * c)))) / b)


@dataclass(frozen=True)
class GravityTurn:
    """Settings of a gravity turn down to a low speed, then vertical descent.

    Attributes
    ----------
    final_speed
        Speed at which the turn ends and the vertical descent continues, m/s.
    stop_height
        Height above the terrain at which the turn aims for zero speed, m.
    max_tilt
        Maximum tilt of the thrust, rad.
    """

    final_speed: float = quantity(
        1.5,
        "m/s",
        gt=0,
        help="speed at which the gravity turn ends and the vertical descent continues",
    )
    stop_height: float = quantity(
        3.0,
        "m",
        ge=0,
        help="height above the terrain at which the gravity turn is planned to reach zero speed",
    )
    max_tilt: float = quantity(
        60.0, "deg", gt=0, lt=85, help="maximum angle of the thrust from the vertical"
    )

    def build(self, briefing: Briefing, lag: float) -> GravityTurnLaw:
        """Build the guidance law of one flight.

        `briefing` is the data known before the flight; `lag` is the total response lag of attitude
        control and engine, s.
        """
        lander = briefing.lander
        last = VerticalDescent().for_lag(
            lag, briefing.surface_gravity, lander.dry_mass, lander.exhaust_velocity
        )
        return GravityTurnLaw(self, briefing.surface_gravity, last)


class GravityTurnLaw:
    """Gravity turn guidance of one flight, followed by vertical descent.

    Parameters
    ----------
    settings
        Settings of the gravity turn.
    gravity
        Downward acceleration, m/s^2.
    last
        Law of the vertical descent after the turn.
    """

    def __init__(self, settings: GravityTurn, gravity: float, last: VerticalDescent) -> None:
        self.settings = settings
        self.gravity = gravity
        self.last = last
        self._turned = False

    @property
    def max_tilt(self) -> float:
        """Current maximum tilt of the thrust, rad."""
        return self.last.max_tilt if self._turned else self.settings.max_tilt

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, opposite to the velocity.

        After the turn, the law descends vertically at the current horizontal position. `end` is the
        touchdown state; `time` is in s.
        """
        require_finite_state(estimate, end)
        height = float(estimate.position[2] - end.position[2]) - self.settings.stop_height
        speed = float(np.linalg.norm(estimate.velocity))
        self._turned |= height <= 0.0 or speed <= self.settings.final_speed
        if self._turned:
            # The horizontal position is not controlled: descend at the current position.
            here = PhaseEnd(
                np.array([*estimate.position[:2], end.position[2]]),
                np.array([0.0, 0.0, -self.settings.final_speed]),
            )
            return self.last.command(estimate, here, time)
        pull = gravity_turn_thrust(height, estimate.velocity, self.gravity) * self.gravity
        return np.asarray(-pull / speed * estimate.velocity)
