"""Vertical descent, the last phase before touchdown, and climb after an abort."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from lunarsim.core.guidance import VerticalDescentParams, vertical_descent_command
from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.onboard.guidance.contract import PhaseEnd, require_finite_state
from lunarsim.onboard.guidance.rotation import RotationLimits
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import check_bounds, hidden, quantity
from lunarsim.typing import Array

if TYPE_CHECKING:
    from lunarsim.messages.briefing import Briefing

# Maximum product of the position loop's frequency and the vehicle's lag.
_MAX_FREQUENCY_LAG = 0.33
# Fraction of the horizontal velocity that a climb removes per second.
_CLIMB_DAMPING_PER_S = 0.2
# Minimum and maximum vertical speed of a hover that changes its height, m/s.
_HOVER_SPEEDS_M_S = (-2.0, 4.0)


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


@runtime_checkable
class Hovers(Protocol):
    """Terminal descent law that can refuse to begin far from its site, and can hover."""

    def can_reach(self, estimate: Estimate, end: PhaseEnd) -> bool:
        """Return whether the terminal descent leads to the site of `end` from a state."""
        ...

    def hover(self, estimate: Estimate, height: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, of a hover at a height.

        `height` is that of the centre of mass, local frame, m.
        """
        ...


@runtime_checkable
class SlewLimitedControl(Protocol):
    """Attitude control with a maximum slew rate, which limits a position loop."""

    def turning_time(self, angle: float) -> float:
        """Return the duration (s) of a slew by an angle (rad)."""
        ...


@dataclass(frozen=True)
class VerticalDescent:
    """Vertical descent that holds speed and horizontal position.

    It is the law of the shadow EKF paper, section IV.B. If the lander drifts faster than it can
    stop before touchdown, it descends more slowly, and holds its height until it can; likewise if
    it is too far from its site to return to it before touchdown.

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
    upright_time
        Time before touchdown in which the horizontal command decreases to zero, s.
    tolerated_speed
        Tolerated horizontal speed, m/s.
    tolerated_offset
        Tolerated horizontal distance from the site, m.
    min_speed_fraction
        Minimum descent speed as a fraction of the nominal one, while the lander does not approach
        its site, and once little propellant is left.
    hold_propellant
        Propellant below which the lander no longer holds its height, kg. A return to the site ends
        earlier, by the propellant of the descent from its height.
    max_offset
        Horizontal distance from the site at which the lander may stop, m. If it would stop farther
        away, the vertical descent does not begin: the lander hovers and approaches again. A
        vertical descent farther than twice this distance from the site does not return to it.
    lag
        Total response lag of attitude control and engine, s.
    rotation
        Limits of rotation of the lander; None: only the lag delays a rotation.
    dry_mass
        Mass of the lander without propellant, kg.
    exhaust_velocity
        Exhaust velocity of the engine, m/s.
    """

    gravity: float = hidden(1.622)
    frequency: float = quantity(
        0.6,
        "rad/s",
        gt=0,
        help="natural frequency of the horizontal position loop; it is decreased for a vehicle "
        "that responds slowly",
    )
    damping: float = quantity(1.1, gt=0, help="damping ratio of the horizontal position loop")
    speed_gain: float = quantity(
        1.5, "1/s", gt=0, help="vertical acceleration divided by the error of the vertical speed"
    )
    max_tilt: float = quantity(
        12.0, "deg", gt=0, lt=60, help="maximum angle of the thrust from the vertical"
    )
    max_tilt_at_touchdown: float = quantity(
        2.0,
        "deg",
        gt=0,
        lt=60,
        help="maximum angle of the thrust from the vertical at touchdown, because the lander must "
        "touch down upright",
    )
    full_tilt_height: float = quantity(
        8.0,
        "m",
        gt=0,
        help="height above touchdown below which the maximum tilt decreases linearly to that at "
        "touchdown",
    )
    low_height: float = quantity(
        3.0,
        "m",
        gt=0,
        help="height above touchdown below which the maximum tilt decreases while the descent is "
        "slowed by horizontal motion",
    )
    upright_time: float = quantity(
        2.0,
        "s",
        gt=0,
        le=10,
        help="time before touchdown in which the horizontal acceleration that the vertical descent "
        "commands decreases to zero, so that the lander touches down upright without rotation",
    )
    tolerated_speed: float = quantity(
        0.3,
        "m/s",
        gt=0,
        help="horizontal speed at which the lander may touch down; above it, the lander descends "
        "more slowly and holds its height near the terrain",
    )
    tolerated_offset: float = quantity(
        1.0,
        "m",
        gt=0,
        help="horizontal distance from the site at which the lander may touch down; farther away, "
        "the lander descends more slowly, or holds its height, while it returns",
    )
    min_speed_fraction: float = quantity(
        0.25,
        gt=0,
        le=1,
        help="minimum descent speed divided by the nominal one, while the lander does not approach "
        "its site, or if the propellant is below hold_propellant_kg",
    )
    hold_propellant: float = quantity(
        10.0,
        "kg",
        ge=0,
        help="estimated remaining propellant below which the lander no longer holds its height; it "
        "must exceed the error of the estimate",
    )
    dry_mass: float = hidden(0.0)
    exhaust_velocity: float = hidden(np.inf)
    max_offset: float = quantity(
        10.0,
        "m",
        gt=0,
        help="horizontal distance from the site at which the lander can stop when the vertical "
        "descent is due; if it is larger, the lander hovers and approaches the site again. A "
        "vertical descent farther than twice this distance from the site does not return to it",
    )
    lag: float = hidden(0.0)
    rotation: RotationLimits | None = hidden(None)

    def __post_init__(self) -> None:
        check_bounds(self, "terminal_descent")
        for name, most in (
            ("max_tilt_at_touchdown", "max_tilt"), ("low_height", "full_tilt_height"),
            ("tolerated_offset", "max_offset"),
        ):  # fmt: skip
            if getattr(self, name) > getattr(self, most):
                raise InputError(
                    f"terminal_descent.{name}",
                    getattr(self, name),
                    f"must be at most that of {most}",
                )

    def build(self, briefing: Briefing, lag: float) -> VerticalDescent:
        """Return the law for the lander, gravity and total response lag (s) of a flight.

        A control with a limited slew rate adds the time of a slew by the maximum tilt to the lag,
        or half of the time of this rotation at the lander's torque if that is longer.
        The product of frequency and lag is at most 0.33, where the loop with lag is still as damped
        as the loop without.
        """
        control, lander = briefing.software.control, briefing.lander
        rotation = RotationLimits.of(lander, control)
        if isinstance(control, SlewLimitedControl):
            turn = float(rotation.time(self.max_tilt, lander.dry_mass))
            lag += max(control.turning_time(self.max_tilt), 0.5 * turn)
        law = self.for_lag(lag, briefing.surface_gravity, lander.dry_mass, lander.exhaust_velocity)
        return replace(law, rotation=rotation)

    def for_lag(
        self, lag: float, gravity: float, dry_mass: float, exhaust_velocity: float = np.inf
    ) -> VerticalDescent:
        """Return the law for a total lag (s), gravity (m/s^2) and a lander.

        The lander has a dry mass (kg) and an exhaust velocity (m/s).
        """
        frequency = min(self.frequency, _MAX_FREQUENCY_LAG / max(lag, 1e-6))
        return replace(
            self, frequency=frequency, gravity=gravity, dry_mass=dry_mass, lag=lag,
            exhaust_velocity=exhaust_velocity,
        )  # fmt: skip

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        `end` has the position of the centre of mass at touchdown and the nominal velocity; `time`
        is in s.
        """
        require_finite_state(estimate, end)
        command = np.empty(3)
        vertical_descent_command(
            np.array([estimate.position, estimate.velocity]), np.array(end.position),
            float(end.velocity[2]), float(estimate.mass), self.params, command,
        )  # fmt: skip
        return command

    def can_reach(self, estimate: Estimate, end: PhaseEnd) -> bool:
        """Return whether the lander can stop within `max_offset` of the site of `end`."""
        axis = quat_to_matrix(estimate.attitude)[:, 2]
        acceleration = self.gravity * axis[:2] / max(axis[2], 0.1)
        tilt = float(np.arccos(np.clip(axis[2], -1.0, 1.0)))
        shift = self._stopping_shift(estimate.velocity[:2], acceleration, tilt, estimate.mass)
        offset = estimate.position[:2] + shift - end.position[:2]
        return float(np.hypot(*offset)) <= self.max_offset

    def max_final_tilt(self, mass: float, max_tilt: float, shift: float) -> float:
        """Return the maximum tilt at the end of the approach, at most `max_tilt`.

        From this tilt, a lander of a mass (kg) without horizontal velocity stops within a distance
        `shift`, m. The result is not below the maximum tilt at touchdown, as long as this is below
        `max_tilt`. Angles are in rad.
        """
        smallest = min(self.max_tilt_at_touchdown, max_tilt)
        for tilt in np.linspace(max_tilt, smallest, 1 + round(np.rad2deg(max_tilt - smallest))):
            pull = np.array([self.gravity * np.tan(tilt), 0.0])
            if self._stopping_shift(np.zeros(2), pull, float(tilt), mass)[0] <= shift:
                return float(tilt)
        return smallest

    def _stopping_shift(
        self, velocity: Array, acceleration: Array, tilt: float, mass: float
    ) -> Array:
        """Return the horizontal displacement (2,), m, until the lander stops.

        It first rotates upright from a `tilt`, rad, for a time t: the response lag or the time of
        this rotation. Meanwhile its horizontal `acceleration` a (2,), m/s^2, decreases to zero,
        which changes its `velocity` v (2,), m/s, by a t / 2 and its position by v t + a t^2 / 3.
        Then it decelerates at the maximum tilt. `mass` is in kg.
        """
        time = self.lag
        if self.rotation is not None:
            time = max(time, float(self.rotation.time(tilt, mass)))
        shift = time * velocity + time**2 / 3.0 * acceleration
        velocity = velocity + 0.5 * time * acceleration
        stopping_time = float(np.hypot(*velocity)) / (self.gravity * np.tan(self.max_tilt))
        return np.asarray(shift + 0.5 * stopping_time * velocity)

    def hover(self, estimate: Estimate, height: float) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2, of a hover at a height.

        The lander stops horizontally and moves to the `height` of the centre of mass, local frame,
        m, with the gains of the vertical descent. The tangent of the tilt is at most twice that of
        the maximum tilt of the vertical descent.
        """
        require_finite_state(estimate)
        speed = float(np.clip(self.frequency * (height - estimate.position[2]), *_HOVER_SPEEDS_M_S))
        wanted = self.gravity + self.speed_gain * (speed - float(estimate.velocity[2]))
        up = max(wanted, 0.3 * self.gravity)
        sideways = -2.0 * self.damping * self.frequency * estimate.velocity[:2]
        size, most = float(np.hypot(*sideways)), 2.0 * up * float(np.tan(self.max_tilt))
        return np.array([*(sideways * min(most / max(size, 1e-12), 1.0)), up])

    @property
    def params(self) -> VerticalDescentParams:
        """Parameters for compiled functions."""
        return VerticalDescentParams(
            *(float(getattr(self, name)) for name in VerticalDescentParams._fields)
        )


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
    law: TerminalDescentLaw = (VerticalDescent() if settings is None else settings).build(
        briefing, lag
    )
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
