"""Interface of guidance settings, and base class of laws with paths of one shape."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

from lunarsim.messages.briefing import Briefing
from lunarsim.models.lander import Lander
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd
from lunarsim.onboard.guidance.divert_cost import DivertCost, PathLimits, divert_cost
from lunarsim.onboard.guidance.path_guidance import CompiledFeedback, FeedbackLaw, PathGuidance
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

    A law may have a feedback formula instead of the initial acceleration of its path. It is a plain
    function that is compiled, so that the law also flies in batches of landers::

        def formula(state, target, final, time_to_go, gravity, gains, out):

    `state` (2, 3) is the position and velocity of the lander one response lag ahead, `target` (3,)
    the position of the end, and `final` (2, 3) its velocity and acceleration. `gravity` is the
    downward acceleration, and `gains` are those of the law; all are in SI units. The function
    writes the acceleration, gravity included, to `out` (3,).

    Attributes
    ----------
    min_time_to_go
        Time-to-go below which the last path is flown open loop, s.
    formula
        Feedback formula of the law; None: follow the path.
    """

    formula: ClassVar[Callable[..., None] | None] = None

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

    @property
    def gains(self) -> tuple[float, ...]:
        """Parameters of the feedback formula."""
        return ()

    def feedback(self, gravity: float) -> FeedbackLaw | None:
        """Return the feedback law for a gravity (m/s^2); None: follow the path.

        It is a function of position, velocity, phase end and time-to-go.
        """
        if self.formula is None:
            return None
        return CompiledFeedback(type(self).formula, gravity, self.gains)

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
