"""Interface of guidance settings, and base class of laws with paths of one shape."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd
from lunarsim.onboard.guidance.divert_cost import DivertCost, PathLimits, divert_cost
from lunarsim.onboard.guidance.path_guidance import FeedbackLaw, PathGuidance
from lunarsim.onboard.guidance.paths import PathShape
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


class GuidancePart(Protocol):
    """Settings of a guidance law, a scenario component selected by `kind`.

    Implementations are frozen dataclasses.
    """

    def build(self, briefing: Briefing, lag: float) -> GuidanceLaw:
        """Build the guidance law of one flight.

        `briefing` is the data known before the flight; `lag` is the total response lag of attitude
        control and engine, s.
        """
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
        """Return the propellant cost of reaching each of n ends of an approach.

        `gravity` is in m/s^2; `limits` are those of thrust, tilt, glideslope and propellant.
        `times` (n,), s, are fixed times-to-go, given only if a decision changes the time-to-go.
        """
        ...


@dataclass(frozen=True)
class PathLaw(ABC):
    """Base class for settings of guidance laws whose paths have one shape.

    Attributes
    ----------
    min_time_to_go
        Time-to-go below which the last path is flown open loop, s.
    """

    min_time_to_go: float = quantity(
        1.5,
        "s",
        gt=0,
        help="time-to-go below which the lander follows its last path without feedback",
    )

    @property
    @abstractmethod
    def shape(self) -> PathShape:
        """Shape of the paths if the vehicle follows commands perfectly."""

    def feedback(self, gravity: float) -> FeedbackLaw | None:
        """Return the feedback formula for a gravity (m/s^2); None: follow the path.

        The formula is a function of position, velocity, phase end and time-to-go.
        """
        return None

    def build(self, briefing: Briefing, lag: float) -> PathGuidance:
        """Build the guidance law of one flight.

        `briefing` is the data known before the flight; `lag` is the total response lag of attitude
        control and engine, s.
        """
        gravity = briefing.surface_gravity
        return PathGuidance(
            self.shape, gravity, lag=lag, min_time_to_go=self.min_time_to_go,
            feedback=self.feedback(gravity), gravity_model=briefing.nonuniform_gravity,
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
        """Return the propellant cost of reaching each of n ends of an approach.

        `gravity` is in m/s^2; `limits` are those of thrust, tilt, glideslope and propellant.
        `times` (n,), s, are fixed times-to-go; None: the optimal ones.
        """
        return divert_cost(
            estimate, end, lander, gravity, limits=limits, shape=self.shape, times=times
        )
