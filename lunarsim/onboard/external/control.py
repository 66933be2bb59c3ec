"""Attitude control by external software."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.interface.structs import Struct
from lunarsim.messages.briefing import Briefing
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.onboard.external.settings import Connection, LibrarySoftware, ProcessSoftware
from lunarsim.parts.quantity import quantity
from lunarsim.typing import Array


class ExternalControl:
    """Attitude control of one flight in external software.

    Parameters
    ----------
    connection
        Connection to the software.
    response_time
        Lag of the attitude behind a slowly changing command, s.
    """

    torques: ClassVar[bool] = True

    def __init__(self, connection: Connection, response_time: float) -> None:
        self._connection, self.response_time = connection, response_time
        self._given, self._answer = Struct("ControlInput"), Struct("ControlOutput")

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Return the torque (3,), body axes, N m, as `AttitudeControl.torque` does.

        Raises
        ------
        SoftwareFailure
            If the software fails.
        """
        self._given.set(error=error, rate=rate, inertia=inertia)
        self._answer.clear()
        self._connection.step(self._given, self._answer)
        torque = np.array(self._answer.get("torque"))
        if not np.isfinite(torque).all():
            raise SoftwareFailure("control", "invalid-output", f"torque is {torque.tolist()}")
        return torque

    def close(self) -> None:
        """End the software."""
        self._connection.close()


@dataclass(frozen=True)
class _Control:
    """Settings of attitude control by external software."""

    response_time: float = quantity(
        0.9, "s", gt=0, le=10, help="lag of the attitude behind a slowly changing command"
    )

    torques: ClassVar[bool] = True

    def build(self, briefing: Briefing) -> ExternalControl:
        """Build the attitude control of one flight."""
        connection = self.connect("control", briefing)  # type: ignore[attr-defined]
        return ExternalControl(connection, self.response_time)

    def torque(self, error: Array, rate: Array, inertia: Array) -> Array:
        """Raise an error: only the control that `build` returns has torques."""
        raise TypeError("build the attitude control of a flight first")


@dataclass(frozen=True)
class LibraryControl(_Control, LibrarySoftware):
    """Attitude control by a shared library."""


@dataclass(frozen=True)
class ProcessControl(_Control, ProcessSoftware):
    """Attitude control by a program."""
