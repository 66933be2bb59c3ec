"""Guidance of the approach or of the terminal descent by external software."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim.interface.definitions import GuidancePhase
from lunarsim.interface.structs import Struct
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.external.encode import write_end, write_estimate
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.onboard.external.settings import Connection, LibrarySoftware, ProcessSoftware
from lunarsim.onboard.guidance.apollo import ApolloLaw
from lunarsim.onboard.guidance.contract import GuidanceLaw, PhaseEnd
from lunarsim.onboard.guidance.divert_cost import DivertCost
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


class ExternalGuidance:
    """Guidance law of one flight in external software.

    Parameters
    ----------
    connection
        Connection to the software.
    phase
        Phase of the descent.
    max_tilt
        Maximum tilt of the thrust in the terminal descent, rad.
    """

    def __init__(
        self, connection: Connection, phase: GuidancePhase, max_tilt: float = np.inf
    ) -> None:
        self._connection, self.max_tilt = connection, max_tilt
        self._given, self._answer = Struct("GuidanceInput"), Struct("GuidanceOutput")
        self._given.set(phase=phase)

    def command(
        self, estimate: Estimate, end: PhaseEnd, time: float, time_to_go: float = 0.0
    ) -> Array:
        """Return the thrust acceleration (3,), ENU, m/s^2.

        The arguments are those of `GuidanceLaw.command`; the terminal descent has no time-to-go.

        Raises
        ------
        SoftwareFailure
            If the software fails.
        """
        self._given.set(time=time, time_to_go=time_to_go)
        write_estimate(self._given.parts["estimate"], estimate)
        write_end(self._given.parts["end"], end)
        self._answer.clear()
        self._connection.step(self._given, self._answer)
        acceleration = np.array(self._answer.get("acceleration"))
        if not np.isfinite(acceleration).all():
            raise SoftwareFailure(
                "guidance", "invalid-output", f"acceleration is {acceleration.tolist()}"
            )
        return acceleration

    def close(self) -> None:
        """End the software."""
        self._connection.close()


class _Approach:
    """Approach guidance; start and cost of a site are those of the Apollo law."""

    def start_law(self, briefing: Briefing, lag: float) -> GuidanceLaw:
        """Return the law that gives attitude and thrust at the start: the Apollo law."""
        return ApolloLaw().build(briefing, lag)

    def build(self, briefing: Briefing, lag: float) -> ExternalGuidance:
        """Build the guidance law of one flight; the software gets `lag` in its briefing."""
        connection = self.connect("guidance", briefing)  # type: ignore[attr-defined]
        return ExternalGuidance(connection, GuidancePhase.APPROACH)

    def cost(self, *given: Any, **options: Any) -> DivertCost:
        """Return the cost of the Apollo law's paths; arguments as in `GuidancePart.cost`."""
        return ApolloLaw().cost(*given, **options)


@dataclass(frozen=True)
class LibraryGuidance(_Approach, LibrarySoftware):
    """Approach guidance by a shared library."""


@dataclass(frozen=True)
class ProcessGuidance(_Approach, ProcessSoftware):
    """Approach guidance by a program."""


@dataclass(frozen=True)
class _TerminalDescent:
    """Terminal descent by external software."""

    max_tilt: float = quantity(
        12.0, "deg", gt=0, lt=60, help="maximum angle of the thrust from the vertical"
    )

    def build(self, briefing: Briefing, lag: float) -> ExternalGuidance:
        """Build the law of one flight; the software gets `lag` in its briefing."""
        connection = self.connect("guidance", briefing)  # type: ignore[attr-defined]
        return ExternalGuidance(connection, GuidancePhase.TERMINAL_DESCENT, self.max_tilt)


@dataclass(frozen=True)
class LibraryTerminalDescent(_TerminalDescent, LibrarySoftware):
    """Terminal descent by a shared library."""


@dataclass(frozen=True)
class ProcessTerminalDescent(_TerminalDescent, ProcessSoftware):
    """Terminal descent by a program."""
