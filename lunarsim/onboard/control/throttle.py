"""Throttle regions: what the engine may be asked for where part of its range is forbidden."""

from __future__ import annotations

from lunarsim.models.jet_lander import Engine

# Share of the gap's lower end by which a command must pass it to switch. Luminary of Apollo 11
# switches to full above 63 % and back below 57 %, about an end of 60 %.
_HYSTERESIS = 0.05


class ThrottleRegions:
    """Fixed point above the gap, or the range below it; no chatter between the two.

    Parameters
    ----------
    engine
        Whose gap.

    Attributes
    ----------
    full
        Whether the engine runs at its fixed point.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.full = False

    def allowed(self, wanted: float) -> float:
        """Return the thrust to command for a wanted one, N."""
        e = self.engine
        if not e.has_gap:
            return wanted
        if wanted > e.gap_from * (1.0 + _HYSTERESIS):
            self.full = True
        elif wanted < e.gap_from * (1.0 - _HYSTERESIS):
            self.full = False
        return e.gap_to if self.full else min(wanted, e.gap_from)
