"""Flights in this process, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from lunarsim.campaign.outcomes import Finished, attempt, function_of
from lunarsim.campaign.plan import Group, Work


class InlineEngine:
    """Flies here; policies need not travel. There is no time limit, and a crash is this process's.

    Attributes
    ----------
    name, asks_to_halt
        See `Engine`.
    """

    name = "inline"
    asks_to_halt = False

    def fly(
        self, work: Work, groups: Iterable[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        """Yield flights in order."""
        function = function_of(work)
        for group in groups:
            if group is None:  # nothing is in the air here that it could wait for
                return
            memory: dict[Any, Any] = {}
            for arm in group.arms:
                if halt():
                    return
                yield attempt(function, work, group, arm, memory)
