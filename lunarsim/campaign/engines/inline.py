"""Execute flights in this process, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from lunarsim.campaign.outcomes import Finished, attempt, import_function
from lunarsim.campaign.plan import Group, Work


class InlineEngine:
    """Executes flights in this process, without pickling, time limit or isolation.

    Attributes
    ----------
    name, polls_halt
        Attributes of the `Engine` interface.
    """

    name = "inline"
    polls_halt = False

    def fly(
        self, work: Work, groups: Iterable[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        """Fly groups of flights in this process; yield the results in order.

        The parameters are those of `Engine.fly`.
        """
        function = import_function(work)
        for group in groups:
            if group is None:  # no flight is running that could be waited for
                return
            memory: dict[Any, Any] = {}
            for arm in group.arms:
                if halt():
                    return
                yield attempt(function, work, group, arm, memory)
