"""Early stopping of a campaign by a rule that evaluates flights in order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lunarsim.evaluation.sequences import share_confidence_sequence


class IntervalWidthRule:
    """Rule that stops a campaign when the confidence sequences of all arms are narrow.

    The rule evaluates consecutive flights from 0, so the stopping index does not depend on the
    order in which flights finish. A flight without an outcome counts as a failure.

    Parameters
    ----------
    metric
        Boolean column of the results.
    width
        Required width of the 95 % confidence sequence of the fraction of flights for which the
        metric is true.
    arms
        Number of arms (variants of the scenario).

    Attributes
    ----------
    stop
        Number of flights to keep; None until the rule is satisfied.
    """

    def __init__(self, metric: str, width: float, arms: int) -> None:
        self.metric, self.width = metric, width
        self.stop: int | None = None
        self._counts = [0] * arms
        self._waiting: dict[int, dict[int, bool]] = {}
        self._next = 0

    def add(self, flight: int, arm: int, row: Mapping[str, Any]) -> None:
        """Add the result row of a flight, given by the indices of flight and arm.

        An arm is a variant of the scenario. Flights may be added in any order. `stop` is set once
        the rule is satisfied.
        """
        if self.stop is not None:
            return
        self._waiting.setdefault(flight, {})[arm] = bool(row[self.metric])
        while self.stop is None and len(self._waiting.get(self._next, {})) == len(self._counts):
            for i, hit in self._waiting.pop(self._next).items():
                self._counts[i] += hit
            self._next += 1
            intervals = (share_confidence_sequence(count, self._next) for count in self._counts)
            if all(high - low <= self.width for low, high in intervals):
                self.stop = self._next
