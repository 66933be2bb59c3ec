"""The contract of mappers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.navigation.estimate import Estimate


class HazardMapper(ABC):
    """Anything that draws a `HazardMap` from measurements."""

    @abstractmethod
    def update(self, measurement: Any, estimate: Estimate) -> None:
        """Take in one measurement made at the estimated pose."""

    @abstractmethod
    def hazard_map(self) -> HazardMap:
        """Return the map as it stands."""

    @property
    @abstractmethod
    def blank(self) -> bool:
        """Whether nothing has been mapped yet."""

    def correct(self, before: Estimate, after: Estimate) -> None:  # noqa: B027
        """Move what depends on the pose by what navigation has just learnt of it."""

    def refresh(self, time: float) -> None:  # noqa: B027
        """Do what is due at `time` (s); called once a cycle, after measurements."""
