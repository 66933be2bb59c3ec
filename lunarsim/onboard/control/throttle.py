"""Throttle limits of an engine with a forbidden gap in its throttle range."""

from __future__ import annotations

from lunarsim.models.jet_lander import DescentEngine

# Fraction of the gap's lower end by which a command must pass it to switch. Luminary of Apollo 11
# switches to full above 63 % and back below 57 %, around a gap end of 60 %.
_HYSTERESIS = 0.05


class ThrottleRegions:
    """Choose the fixed point above the gap or the range below it, with hysteresis.

    Parameters
    ----------
    engine
        Engine with the throttle gap.

    Attributes
    ----------
    full
        Whether the engine runs at its fixed throttle point.
    """

    def __init__(self, engine: DescentEngine) -> None:
        self.engine = engine
        self.full = False

    def allowed(self, wanted: float) -> float:
        """Return the thrust command for a desired thrust, N."""
        e = self.engine
        if not e.has_gap:
            return wanted
        if wanted > e.gap_from * (1.0 + _HYSTERESIS):
            self.full = True
        elif wanted < e.gap_from * (1.0 - _HYSTERESIS):
            self.full = False
        return e.gap_to if self.full else min(wanted, e.gap_from)
