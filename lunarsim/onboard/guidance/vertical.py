"""Vertical descent, the last phase before touchdown, and climb after an abort."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol, runtime_checkable

import numpy as np

from lunarsim.core.guidance import VerticalDescentParams, vertical_descent_command
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.typing import Array

# Maximum product of the position loop's frequency and the vehicle's lag.
_MAX_FREQUENCY_LAG = 0.33
# Fraction of the horizontal velocity that a climb removes per second.
_CLIMB_DAMPING_PER_S = 0.2


class TerminalDescentLaw(Protocol):
    """Guidance law of the terminal descent, the last phase before touchdown."""

    @property
    def max_tilt(self) -> float:
        """Current maximum tilt of the thrust from the vertical, rad."""
        ...

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        `end` has the position of the centre of mass at touchdown and the nominal velocity; `time`
        is in s.
        """
        ...


@dataclass(frozen=True)
class VerticalDescent:
    """Vertical descent that holds speed and horizontal position.

    It is the law of the shadow EKF paper, section IV.B. If the lander drifts faster than it can
    stop before touchdown, it descends more slowly until it can.

    Attributes
    ----------
    gravity
        Downward acceleration, m/s^2.
    frequency, damping
        Natural frequency (rad/s) and damping ratio of the horizontal position loop.
    speed_gain
        Gain of the vertical speed loop, 1/s.
    max_tilt, max_tilt_at_touchdown
        Maximum tilt of the thrust high above the site, and at touchdown, rad; the lander must touch
        down upright.
    full_tilt_height
        Height below which the maximum tilt decreases linearly towards touchdown, m.
    low_height
        The same height during a slowed descent, m.
    tolerated_speed
        Tolerated horizontal speed, m/s.
    min_speed_fraction
        Minimum descent speed as a fraction of the nominal one.
    """

    gravity: float
    frequency: float = 0.6
    damping: float = 1.1
    speed_gain: float = 1.5
    max_tilt: float = np.deg2rad(12.0)
    max_tilt_at_touchdown: float = np.deg2rad(2.0)
    full_tilt_height: float = 8.0
    low_height: float = 3.0
    tolerated_speed: float = 0.3
    min_speed_fraction: float = 0.25

    @classmethod
    def for_lag(cls, lag: float, gravity: float) -> VerticalDescent:
        """Return the law for a vehicle with a response lag (s) and gravity (m/s^2).

        The product of frequency and lag is at most 0.33, where the loop with lag is still as damped
        as the loop without.
        """
        return cls(gravity, frequency=min(cls.frequency, _MAX_FREQUENCY_LAG / max(lag, 1e-6)))

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        `end` has the position of the centre of mass at touchdown and the nominal velocity; `time`
        is in s.
        """
        require_finite_state(estimate, end)
        command = np.empty(3)
        vertical_descent_command(
            np.array([estimate.position, estimate.velocity]), np.array(end.position),
            float(end.velocity[2]), self.params, command,
        )  # fmt: skip
        return command

    @property
    def params(self) -> VerticalDescentParams:
        """Parameters for compiled functions."""
        return VerticalDescentParams(*(float(getattr(self, f.name)) for f in fields(self)))


@runtime_checkable
class SlewLimitedControl(Protocol):
    """Attitude control with a maximum slew rate, which limits a position loop."""

    def turning_time(self, angle: float) -> float:
        """Return the duration (s) of a slew by an angle (rad)."""
        ...


def descent_law(settings: Any, briefing: Any, lag: float) -> TerminalDescentLaw:
    """Return the law of the terminal descent: that of the scenario or the default.

    The default is `VerticalDescent`.

    Parameters
    ----------
    settings
        Settings of the terminal descent in the scenario; None if there are none.
    briefing
        Data known before the flight.
    lag
        Total response lag of attitude control and engine, s.
    """
    if settings is None:
        control = briefing.software.control
        if isinstance(control, SlewLimitedControl):
            lag += control.turning_time(VerticalDescent.max_tilt)
        return VerticalDescent.for_lag(lag, briefing.surface_gravity)
    law: TerminalDescentLaw = settings.build(briefing, lag)
    return law


def climb(estimate: Estimate, max_acceleration: float) -> Array:
    """Return the thrust acceleration (3,), ENU, m/s^2, of a full-thrust climb.

    A part of the thrust removes the horizontal velocity.

    Parameters
    ----------
    estimate
        Estimated state.
    max_acceleration
        Maximum thrust divided by mass, m/s^2.
    """
    require_finite_state(estimate)
    horizontal = -_CLIMB_DAMPING_PER_S * estimate.velocity[:2]
    size = float(np.hypot(*horizontal))
    if size > 0.5 * max_acceleration:
        horizontal = horizontal * (0.5 * max_acceleration / size)
    up = np.sqrt(max_acceleration**2 - float(horizontal @ horizontal))
    return np.array([horizontal[0], horizontal[1], up])
