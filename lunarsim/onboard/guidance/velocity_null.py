"""P65: automatic terminal descent that nulls velocity and does not aim at a site.

Each channel is first order, ``a = (v_wanted - v) / tau``, with zero horizontal velocity and the
rate of descent of the phase (Klumpp 1974, the velocity-nulling guidance of P65).
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
class VelocityNull:
    """Settings of a descent with zero horizontal velocity (Apollo P65).

    The rate of descent is that of the phase end.

    Attributes
    ----------
    time_constant
        Time constant with which each velocity component approaches its desired value, s.
    max_tilt
        Maximum tilt of the thrust, rad.
    """

    time_constant: float = quantity(
        5.0, "s", gt=0, help="time constant with which an error of the velocity decreases"
    )
    max_tilt: float = quantity(
        20.0, "deg", gt=0, lt=60, help="maximum angle of the thrust from the vertical"
    )

    def __post_init__(self) -> None:
        check_bounds(self, "terminal_descent")

    def build(self, briefing: Briefing, lag: float) -> VelocityNullLaw:
        """Build the descent law of one flight; `lag` is not used."""
        return VelocityNullLaw(self, briefing.surface_gravity)


@dataclass(frozen=True)
class VelocityNullLaw:
    """Descent law of Apollo P65 for one flight: nulls the horizontal velocity.

    Attributes
    ----------
    settings
        Time constant and maximum tilt.
    gravity
        Downward acceleration, m/s^2.
    """

    settings: VelocityNull
    gravity: float

    @property
    def max_tilt(self) -> float:
        """Maximum tilt of the thrust, rad."""
        return self.settings.max_tilt

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        `end` is the touchdown state, of which only the vertical velocity is used; `time` is in s.
        """
        require_finite_state(estimate, end)
        wanted = np.array([0.0, 0.0, float(end.velocity[2])])
        pull = (wanted - estimate.velocity) / self.settings.time_constant
        pull[2] = max(pull[2] + self.gravity, 0.3 * self.gravity)
        most, size = self.gravity * np.tan(self.settings.max_tilt), float(np.hypot(*pull[:2]))
        if size > most:
            pull[:2] *= most / size
        return pull
