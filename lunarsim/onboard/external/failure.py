"""Failure of external flight software during a flight."""

from __future__ import annotations

from typing import Literal

Reason = Literal["died", "timeout", "error", "invalid-output", "protocol"]


class SoftwareFailure(Exception):  # noqa: N818  (the failure of a simulated component)
    """Failure of external flight software, which ends the flight.

    Parameters
    ----------
    role
        Role of the software, for instance "guidance".
    reason
        Kind of the failure: "died" (the program ended), "timeout" (no answer within the deadline),
        "error" (the software reported an error), "invalid-output" (for instance NaN), "protocol"
        (a message that does not follow the interface).
    detail
        Description for the record; characters that cannot be printed become spaces.
    """

    def __init__(self, role: str, reason: Reason, detail: str) -> None:
        detail = "".join(one if one.isprintable() else " " for one in detail)
        super().__init__(f"external {role}: {reason}: {detail}")
        self.role, self.reason, self.detail = role, reason, detail
