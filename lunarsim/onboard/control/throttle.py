"""Throttle limits of an engine with a forbidden gap in its throttle range."""

from __future__ import annotations

from lunarsim.models.jet_lander import DescentEngine

# Fraction of the gap's lower end by which a command must pass this end to switch. Luminary of
# Apollo 11 switches to full above 63 % and back below 57 %, around a gap end of 60 %.
_HYSTERESIS = 0.05


class ThrottleRegions:
    """Keeps thrust commands out of an engine's forbidden throttle gap.

    Above the gap, the engine runs at a fixed throttle point; below the gap, it is throttled.
    Hysteresis prevents frequent switching between the two.

    Parameters
    ----------
    engine
        Engine with the throttle gap.

    Attributes
    ----------
    is_full
        Whether the engine runs at its fixed throttle point.
    """

    def __init__(self, engine: DescentEngine) -> None:
        self.engine = engine
        self.is_full = False

    def select_thrust(self, desired_thrust: float) -> float:
        """Return the allowed thrust command for a desired thrust, both in N."""
        e = self.engine
        if not e.has_gap:
            return desired_thrust
        if desired_thrust > e.gap_lower * (1.0 + _HYSTERESIS):
            self.is_full = True
        elif desired_thrust < e.gap_lower * (1.0 - _HYSTERESIS):
            self.is_full = False
        return e.gap_upper if self.is_full else min(desired_thrust, e.gap_lower)
