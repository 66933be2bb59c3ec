"""Limit on how often a map is recomputed."""

from __future__ import annotations

import numpy as np

from lunarsim.errors import InputError


class MapUpdateTimer:
    """Limit the recomputation of a map to once per interval.

    Recomputation is always allowed until `set_time` has been called.

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
            raise InputError("interval", interval, "must be 0 or more, and finite")
        self._interval_s = interval
        self._time_s: float | None = None
        self._next_update_s = -np.inf

    def set_time(self, time: float) -> None:
        """Set the current time (s)."""
        self._time_s = time

    @property
    def is_due(self) -> bool:
        """Whether the map may be recomputed now."""
        return self._time_s is None or self._time_s >= self._next_update_s - 1e-9

    def mark_updated(self) -> None:
        """Record that the map has been recomputed at the current time."""
        self._next_update_s = (self._time_s or 0.0) + self._interval_s

    def force_update(self) -> None:
        """Allow the next recomputation without waiting for the end of the interval."""
        self._next_update_s = -np.inf
