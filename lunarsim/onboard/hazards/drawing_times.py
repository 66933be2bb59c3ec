"""When a map is to be drawn anew: no oftener than its mapper is told to."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError


class DrawingTimes:
    """Lets a map be drawn once an interval; where nobody tells the time, always.

    Parameters
    ----------
    interval
        Least time between two drawings, s.

    Raises
    ------
    InputError
        If it is negative or not finite.
    """

    def __init__(self, interval: float) -> None:
        if not 0.0 <= interval < np.inf:
            raise InputError("interval", interval, "0 or a positive number of seconds")
        self._interval = interval
        self._time: float | None = None
        self._next = -np.inf

    def tell(self, time: float) -> None:
        """Note the time (s)."""
        self._time = time

    @property
    def due(self) -> bool:
        """Whether the map may be drawn now."""
        return self._time is None or self._time >= self._next - 1e-9

    def drawn(self) -> None:
        """Note that it has been drawn."""
        self._next = (self._time or 0.0) + self._interval

    def at_once(self) -> None:
        """Let it be drawn again whatever the time."""
        self._next = -np.inf
