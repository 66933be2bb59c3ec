"""What the registry knows of a guidance law, and what laws share whose paths are of one shape."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd
from lunarsim.onboard.guidance.divert import DivertCost, PathLimits, divert_cost
from lunarsim.onboard.guidance.following import Feedback, PathGuidance
from lunarsim.onboard.guidance.paths import PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity

Array = NDArray[np.float64]


class GuidancePart(Protocol):
    """What the registry knows of a law: a frozen dataclass of its settings."""

    def build(self, briefing: Briefing, lag: float) -> GuidanceLaw:
        """Return the law of one flight; `lag` is that of attitude and engine, s."""
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
        """Return what it takes under this law to reach each of n ends; see `divert_cost`.

        `times` (n,), s, are asked for where a decision stretches them, and only then.
        """
        ...


@dataclass(frozen=True)
class PathLaw(ABC):
    """A law whose paths are of one shape: what it costs to reach a site is that of such a path.

    Attributes
    ----------
    least_time_to_go
        Below this time-to-go the loop is open, s.
    """

    least_time_to_go: float = quantity(
        1.5, "s", gt=0, help="below it the last path is flown out open loop"
    )

    @property
    @abstractmethod
    def shape(self) -> PathShape:
        """Of its paths under perfect actuation."""

    def feedback(self, gravity: float) -> Feedback | None:
        """Return the law's own formula under a downward acceleration, m/s^2; None: its path's."""
        return None

    def build(self, briefing: Briefing, lag: float) -> PathGuidance:
        """Return the law of one flight."""
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
        """Return what it takes to reach each end of an approach; see `divert_cost`."""
        return divert_cost(
            estimate, end, lander, gravity, limits=limits, shape=self.shape, times=times
        )
