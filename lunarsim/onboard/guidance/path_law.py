"""Interface of guidance parts, and the base class of laws with paths of one shape."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd
from lunarsim.onboard.guidance.divert_cost import DivertCost, PathLimits, divert_cost
from lunarsim.onboard.guidance.path_guidance import FeedbackLaw, PathGuidance
from lunarsim.onboard.guidance.paths import PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


class GuidancePart(Protocol):
    """Interface of a guidance part: a frozen dataclass with the settings of a law."""

    def build(self, briefing: Briefing, lag: float) -> GuidanceLaw:
        """Return the law for one flight; `lag` is that of attitude and engine, s."""
        ...

    def cost(
        self,
        estimate: Estimate,
        end: PhaseEnd,
        lander: Lander,
        gravity: float,
        limits: PathLimits | None = None,
        times: Array | None = None,
    ) -> DivertCost:
        """Return the cost of reaching each of n ends, as `divert_cost` does.

        `times` (n,), s, are given only if a decision changes the time-to-go.
        """
        ...


@dataclass(frozen=True)
class PathLaw(ABC):
    """Base class of laws whose paths have one shape; it gives the cost of a site.

    Attributes
    ----------
    least_time_to_go
        Time-to-go below which the loop is open, s.
    """

    least_time_to_go: float = quantity(
        1.5, "s", gt=0, help="time-to-go below which the last path is flown open loop"
    )

    @property
    @abstractmethod
    def shape(self) -> PathShape:
        """Shape of the paths under perfect actuation."""

    def feedback(self, gravity: float) -> FeedbackLaw | None:
        """Return the feedback formula for a gravity (m/s^2); None: follow the path."""
        return None

    def build(self, briefing: Briefing, lag: float) -> PathGuidance:
        """Return the law for one flight; `lag` is that of attitude and engine, s."""
        gravity = briefing.weight
        return PathGuidance(
            self.shape, gravity, lead=lag, least_time_to_go=self.least_time_to_go,
            feedback=self.feedback(gravity), field=briefing.field,
        )  # fmt: skip

    def cost(
        self,
        estimate: Estimate,
        end: PhaseEnd,
        lander: Lander,
        gravity: float,
        limits: PathLimits | None = None,
        times: Array | None = None,
    ) -> DivertCost:
        """Return the cost of reaching each end of an approach, as `divert_cost` does."""
        return divert_cost(
            estimate, end, lander, gravity, limits=limits, shape=self.shape, times=times
        )
