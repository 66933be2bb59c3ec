"""Run a flight at wall-clock rate, and count late control cycles."""

from __future__ import annotations

import time
from dataclasses import dataclass

from lunarsim.errors import InputError


@dataclass
class Pacer:
    """Keeps simulated time behind wall-clock time, at a given ratio.

    Attributes
    ----------
    rate
        Simulated time divided by wall-clock time.
    cycle
        Period of the control cycle, s.
    cycles, overruns
        Number of control cycles, and of those whose computation took longer than their share of
        wall-clock time.
    longest, total
        Maximum and sum of the computing times of a cycle, s.

    Raises
    ------
    InputError
        If the rate is not positive and finite.
    """

    rate: float
    cycle: float
    cycles: int = 0
    overruns: int = 0
    longest: float = 0.0
    total: float = 0.0
    _last: float | None = None
    _due: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.rate < float("inf"):
            raise InputError("--pace", self.rate, "must be positive and finite")

    def wait(self) -> None:
        """Wait for the end of a control cycle that has been computed.

        A cycle that is late delays all later ones; it is not made up for.
        """
        now, share = time.perf_counter(), self.cycle / self.rate
        if self._last is None:
            self._last, self._due = now, now + share
            return
        spent = now - self._last
        self.cycles += 1
        self.total += spent
        self.longest = max(self.longest, spent)
        if now > self._due:
            self.overruns += 1
            self._due = now
        else:
            time.sleep(self._due - now)
        self._last = time.perf_counter()
        self._due += share

    def __str__(self) -> str:
        if self.cycles == 0:
            return "pace: no control cycle"
        return (
            f"pace {self.rate:g}: {self.cycles} control cycles of {1e3 * self.cycle:g} ms, "
            f"{self.overruns} overruns ({self.overruns / self.cycles:.1%}); computing time of a "
            f"cycle {1e3 * self.total / self.cycles:.1f} ms in the mean, "
            f"{1e3 * self.longest:.1f} ms at most"
        )
