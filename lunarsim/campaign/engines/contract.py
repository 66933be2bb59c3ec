"""Interface of the engines that run the flights of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from lunarsim.campaign.outcomes import Finished
from lunarsim.campaign.plan import Group, Work


class Engine(Protocol):
    """Interface of an engine that runs groups of flights, for instance in processes.

    Attributes
    ----------
    name
        Name in the manifest.
    polls_halt
        Whether the engine polls `halt` while flights are running. Otherwise an interrupt must be
        raised as an exception.
    """

    name: str
    polls_halt: bool

    def fly(
        self, work: Work, groups: Iterable[Group | None], halt: Callable[[], bool]
    ) -> Iterator[Finished]:
        """Fly groups of flights; yield the result of each flight as it finishes.

        Parameters
        ----------
        work
            Function and settings that all flights share.
        groups
            Groups of flights, taken in order whenever a worker is free. None means that no group
            can start until a running flight has ended.
        halt
            Once it returns True, finished flights are yielded and running flights are abandoned.
        """
        ...
