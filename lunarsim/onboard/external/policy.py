"""Selection of the landing site by external software."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.errors import InputError
from lunarsim.interface.definitions import PolicyAction
from lunarsim.interface.structs import Struct
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.external.encode import write_observation
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.onboard.external.settings import Connection, LibrarySoftware, ProcessSoftware
from lunarsim.onboard.policies.contract import Decision, Observation


class ExternalPolicy:
    """Policy of one flight in external software.

    Parameters
    ----------
    name
        Name of the policy in tables and records.
    connection
        Connection to the software.
    """

    def __init__(self, name: str, connection: Connection) -> None:
        self.name, self._connection = name, connection
        self._given, self._answer = Struct("PolicyInput"), Struct("PolicyOutput")

    def decide(self, observation: Observation) -> Decision:
        """Return the decision of the software.

        Raises
        ------
        SoftwareFailure
            If the software fails.
        """
        write_observation(self._given, observation)
        self._answer.clear()
        self._connection.step(self._given, self._answer)
        action, site = int(self._answer.get("action")), np.array(self._answer.get("site"))
        reason = self._answer.text("reason") or "external"
        if action == PolicyAction.KEEP:
            return Decision.keep(reason)
        if action == PolicyAction.ABORT:
            return Decision.climb_away(reason)
        if action != PolicyAction.DIVERT:
            raise SoftwareFailure("policy", "invalid-output", f"action is {action}")
        if not np.isfinite(site).all():
            raise SoftwareFailure("policy", "invalid-output", f"site is {site.tolist()}")
        return Decision(site, reason)

    def close(self) -> None:
        """End the software."""
        self._connection.close()


class _Policy:
    """Settings of a policy in external software."""

    name: ClassVar[str]

    def build(self, briefing: Briefing) -> ExternalPolicy:
        """Build the policy of one flight."""
        return ExternalPolicy(self.name, self.connect("policy", briefing))  # type: ignore[attr-defined]

    def decide(self, observation: Observation) -> Decision:
        """Raise an error: only the policy that `build` returns can decide."""
        raise InputError(
            "policy", self.name, "must fly on the onboard computer",
            "External policies do not fly as agents of an environment.",
        )  # fmt: skip


@dataclass(frozen=True)
class LibraryPolicy(_Policy, LibrarySoftware):
    """Selection of the landing site by a shared library."""

    name: ClassVar[str] = "library"


@dataclass(frozen=True)
class ProcessPolicy(_Policy, ProcessSoftware):
    """Selection of the landing site by a program."""

    name: ClassVar[str] = "process"
