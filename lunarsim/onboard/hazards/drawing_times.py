"""Limit on how often a map is recomputed."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError


class DrawingTimes:
    """Limit the recomputation of a map to once per interval.

    Without a known time, recomputation is always allowed.

    Parameters
    ----------
    interval
        Minimum time between two recomputations, s.

    Raises
    ------
    InputError
        If `interval` is negative or not finite.
    """

    def __init__(self, interval: float) -> None:
        if not 0.0 <= interval < np.inf:
            raise InputError("interval", interval, "must be 0 or more, in seconds")
        self._interval = interval
        self._time: float | None = None
        self._next = -np.inf

    def tell(self, time: float) -> None:
        """Set the current time (s)."""
        self._time = time

    @property
    def due(self) -> bool:
        """Whether the map may be recomputed now."""
        return self._time is None or self._time >= self._next - 1e-9

    def drawn(self) -> None:
        """Record that the map has been recomputed."""
        self._next = (self._time or 0.0) + self._interval

    def at_once(self) -> None:
        """Allow the next recomputation at any time."""
        self._next = -np.inf
