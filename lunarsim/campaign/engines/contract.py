"""The contract of engines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from lunarsim.campaign.outcomes import Finished
from lunarsim.campaign.plan import Group, Work


class Engine(Protocol):
    """Anything that flies groups of flights.

    Attributes
    ----------
    name
        In the manifest.
    asks_to_halt
        Whether `halt` is looked at while flights are in the air; else an interrupt must be raised.
    """

    name: str
    asks_to_halt: bool

    def fly(
        self, work: Work, groups: Iterable[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        """Yield finished flights as they come.

        Parameters
        ----------
        work
            What flies.
        groups
            Taken one by one as somebody is free, in order; None: none can begin until a flight
            that is in the air has ended.
        halt
            When it turns true, what is finished is yielded and what is in the air given up.
        """
        ...
