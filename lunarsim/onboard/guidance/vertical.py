"""The last metres: straight down at a constant speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.guidance.contract import PhaseEnd, refuse_unknown
from lunarsim.onboard.navigation.estimate import Estimate

# Greatest product of the position loop's frequency and the vehicle's lag.
_FREQUENCY_LAG = 0.33


class DescentLaw(Protocol):
    """The last phase of flight, to the ground."""

    @property
    def lean(self) -> float:
        """Greatest lean of the thrust from the vertical now, rad."""
        ...

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> NDArray[np.float64]:
        """Return the thrust acceleration (3,), ENU, m/s^2; see `VerticalDescent.command`."""
        ...


@dataclass(frozen=True)
class VerticalDescent:
    """Hold the descent speed and stay above the target (section IV.B of the shadow EKF paper).

    A lander that drifts sideways faster than it can stop before the ground comes down more slowly
    until it can.

    Attributes
    ----------
    gravity
        Downward acceleration, m/s^2.
    frequency, damping
        Of the horizontal position loop, rad/s.
    speed_gain
        Of the vertical speed loop, 1/s.
    lean, lean_low
        Greatest lean of the thrust from the vertical at `lean_height` above the ground and
        more, and at the ground, rad: the lander must arrive upright.
    lean_height, low_height
        Below these the lean shrinks, on the way down and while it slips, m.
    slip
        Sideways speed that need not be taken out, m/s.
    slowest
        Least descent speed over that of the whole descent.
    """

    gravity: float
    frequency: float = 0.6
    damping: float = 1.1
    speed_gain: float = 1.5
    lean: float = np.deg2rad(12.0)
    lean_low: float = np.deg2rad(2.0)
    lean_height: float = 8.0
    low_height: float = 3.0
    slip: float = 0.3
    slowest: float = 0.25

    @classmethod
    def behind(cls, lag: float, gravity: float) -> VerticalDescent:
        """Return the law for a vehicle that answers with a lag (s): slower behind a longer one.

        Frequency times lag is kept at 0.33 or less, where the loop with the lag in it still damps
        as the one without.
        """
        return cls(gravity, frequency=min(cls.frequency, _FREQUENCY_LAG / max(lag, 1e-6)))

    def command(self, estimate: Estimate, end: PhaseEnd, time: float) -> NDArray[np.float64]:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        The end's position is that of the centre of mass on the ground, its velocity that of the
        whole descent.
        """
        refuse_unknown(estimate, end)
        offset = estimate.position[:2] - end.position[:2]
        sideways = (
            -(self.frequency**2) * offset
            - 2.0 * self.damping * self.frequency * estimate.velocity[:2]
        )
        height = float(estimate.position[2] - end.position[2])
        planned = float(end.velocity[2])
        wanted = self._slowed(estimate.velocity, height, planned)
        leaning = self._leaning(height, self.lean_height if wanted == planned else self.low_height)
        up = self.gravity + self.speed_gain * (wanted - float(estimate.velocity[2]))
        up = max(up, 0.3 * self.gravity)
        limit = up * leaning
        size = float(np.hypot(*sideways))
        if size > limit:
            sideways *= limit / size
        return np.array([sideways[0], sideways[1], up])

    def _leaning(self, height: float, full: float) -> float:
        """Return the tangent of the greatest lean at a height, all of it from `full` on."""
        share = min(max(height / full, 0.0), 1.0)
        return float(np.tan(self.lean_low + share * (self.lean - self.lean_low)))

    def _slowed(self, velocity: NDArray[np.float64], height: float, planned: float) -> float:
        """Return the vertical speed, m/s: slower than planned while it slips too fast to stop."""
        excess = max(float(np.hypot(velocity[0], velocity[1])) - self.slip, 0.0)
        # The lean allowed shrinks on the way down: half of what it can do here is to be had.
        stopping = excess / (0.5 * self.gravity * self._leaning(height, self.lean_height))
        if excess == 0.0 or -planned * stopping <= height:
            return planned
        return min(-height / stopping, self.slowest * planned)


@runtime_checkable
class Turning(Protocol):
    """A control whose turns have a greatest rate that a position loop must wait for."""

    def turning_time(self, angle: float) -> float:
        """Return how long a turn by an angle (rad) takes, s."""
        ...


def descent_law(part: Any, briefing: Any, lag: float) -> DescentLaw:
    """Return the law of the last phase: a scenario's own, or straight down at a constant speed.

    Parameters
    ----------
    part
        Of `[descent]`; None where a scenario has none.
    briefing
        Of the flight, for the part; the weight of a kilogram at the target, N.
    lag
        Of attitude and engine, s.
    """
    if part is None:
        control = briefing.software.control
        if isinstance(control, Turning):
            lag += control.turning_time(VerticalDescent.lean)
        return VerticalDescent.behind(lag, briefing.weight)
    law: DescentLaw = part.build(briefing, lag)
    return law
