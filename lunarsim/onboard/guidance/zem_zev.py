"""Zero-effort-miss/zero-effort-velocity (ZEM/ZEV) feedback guidance.

Ebrahimi, Bahrami and Roshanian, "Optimal sliding-mode guidance with terminal velocity constraint
for fixed-interval propulsive maneuvers", Acta Astronautica 62, 2008; Guo, Hawkins and Wie,
"Applications of generalized zero-effort-miss/zero-effort-velocity feedback guidance algorithm",
Journal of Guidance, Control, and Dynamics 36(3), 2013.

The predicted miss and velocity error without thrust are fed back with the gains of minimum control
effort. Under uniform gravity this is E-guidance in feedback form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.onboard.guidance.contract import PhaseEnd
from lunarsim.onboard.guidance.path_guidance import FeedbackLaw
from lunarsim.onboard.guidance.path_law import PathLaw
from lunarsim.onboard.guidance.paths import E_GUIDANCE, PathShape
from lunarsim.typing import Array


def zem_zev(
    position: Array, velocity: Array, end: PhaseEnd, time_to_go: float, gravity: float
) -> Array:
    """Return the ZEM/ZEV thrust acceleration ``6 ZEM / T^2 - 2 ZEV / T`` (3,), m/s^2.

    ZEM and ZEV are the errors of position and velocity at the end if no thrust is applied.

    Parameters
    ----------
    position, velocity
        Current state (3,), m and m/s.
    end
        Required position and velocity; its acceleration is not used.
    time_to_go
        Time-to-go T, s.
    gravity
        Downward acceleration, m/s^2.
    """
    g = np.array([0.0, 0.0, -gravity])
    miss = end.position - (position + time_to_go * velocity + 0.5 * time_to_go**2 * g)
    velocity_error = end.velocity - (velocity + time_to_go * g)
    return np.asarray(6.0 * miss / time_to_go**2 - 2.0 * velocity_error / time_to_go)


@dataclass(frozen=True)
class ZemZevLaw(PathLaw):
    """Settings of zero-effort-miss/zero-effort-velocity feedback (Guo 2013).

    The law is also in Ebrahimi 2008.
    """

    @property
    def shape(self) -> PathShape:
        """Shape of E-guidance, whose paths are the same for a vehicle without lag."""
        return E_GUIDANCE

    def feedback(self, gravity: float) -> FeedbackLaw:
        """Return the ZEM/ZEV law as a function of state, phase end and time-to-go.

        The function returns the acceleration including gravity; `gravity` is in m/s^2.
        """
        down = np.array([0.0, 0.0, -gravity])

        def acceleration(
            position: Array, velocity: Array, end: PhaseEnd, time_to_go: float
        ) -> Array:
            """Return the acceleration towards `end` (3,), m/s^2, gravity included."""
            return np.asarray(zem_zev(position, velocity, end, time_to_go, gravity) + down)

        return acceleration
