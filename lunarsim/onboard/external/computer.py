"""Complete onboard computer in external software."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim.frames import SiteToLocal
from lunarsim.interface.structs import Struct
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import Command, SensorTask
from lunarsim.messages.measurements import Measurements
from lunarsim.onboard.control.jets import attitude_loop
from lunarsim.onboard.external.encode import MeasurementWriter, read_estimate
from lunarsim.onboard.external.failure import SoftwareFailure
from lunarsim.onboard.external.settings import Connection, LibrarySoftware, ProcessSoftware
from lunarsim.onboard.hazards.mapper import HazardMapper
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.phases import Phase
from lunarsim.onboard.policies.contract import Candidates, Decision, Observation
from lunarsim.typing import Array

_FINITE = ("thrust", "attitude")
_FINITE_ESTIMATE = ("position", "velocity", "attitude", "rate", "mass")


class _SiteFrame:
    """Frames of external software: it works in the site frame."""

    site_to_local = SiteToLocal()
    has_local_azimuth = False


class ExternalComputer:
    """Onboard computer of one flight in external software.

    Attitude control is that of the scenario. Attributes are those of
    `lunarsim.onboard.computer.OnboardComputer`. There are no maps and candidate sites, and no
    policy of lunarsim is asked.

    Parameters
    ----------
    briefing
        Data known before the flight.
    connection
        Connection to the software.
    """

    def __init__(self, briefing: Briefing, connection: Connection) -> None:
        self.briefing, self._connection = briefing, connection
        self.attitude_loop = attitude_loop(briefing)
        self._writer = MeasurementWriter(tuple(briefing.instruments))
        self._names = tuple(briefing.instruments)
        self._given, self._answer = Struct("Measurements"), Struct("Command")
        # Numbers of the command that must be finite.
        self._required = [
            (name, part.views[name].reshape(-1))
            for part, names in (
                (self._answer, _FINITE), (self._answer.parts["estimate"], _FINITE_ESTIMATE)
            )
            for name in names
        ]  # fmt: skip
        self._command = Command(0.0, briefing.start.attitude)
        start = briefing.start
        self.estimate = Estimate(
            0.0, start.position, start.velocity, start.attitude, np.zeros(3),
            briefing.lander.wet_mass, np.zeros((9, 9)),
        )  # fmt: skip
        self.time, self.time_to_go = 0.0, briefing.time_to_go
        self.site: Array = briefing.target.copy()
        self.navigation = _SiteFrame()
        self.telemetry: list[tuple[float, str, dict[str, Any]]] = []
        self.diverts: list[tuple[float, Array, Decision]] = []
        self.candidates: Candidates | None = None
        self.mappers: dict[str, HazardMapper] = {}
        self.updated_mappers: set[str] = set()
        self.guidance_target = None
        self.guidance_acceleration: Array = np.full(3, np.nan)
        self.decision_map_name = ""
        self.decision_due = False

    @property
    def phase(self) -> Phase:
        """Phase of the descent: approach, or abort."""
        return Phase.ABORT if self._command.abort else Phase.APPROACH

    @property
    def navigation_lost(self) -> bool:
        """Whether the software states that its estimate is lost."""
        return self.estimate.lost

    @property
    def altitude(self) -> float:
        """Estimated height of the pads above the site, m."""
        level = float(self.briefing.gravity.height(self.estimate.position))
        return level - float(self.site[2]) - self.briefing.lander.com_height

    def update(self, measurements: Measurements) -> None:
        """Send the measurements of a cycle to the software and take its command.

        Raises
        ------
        SoftwareFailure
            If the software fails.
        """
        self.time = measurements.time
        self._writer.write(self._given, measurements)
        self._answer.clear()
        self._connection.step(self._given, self._answer)
        self._check()
        answer, was_aborting = self._answer, self._command.abort
        self.estimate = read_estimate(answer.parts["estimate"])
        is_given = all(map(math.isfinite, answer.flat["site"].tolist()))
        self.site = answer.get("site").copy() if is_given else self.briefing.target
        left = answer.views["time_to_go"].item()
        self.time_to_go = left if math.isfinite(left) else 0.0
        self._command = Command(
            answer.views["thrust"].item(), answer.get("attitude").copy(), self._tasks(),
            bool(answer.get("abort")),
        )  # fmt: skip
        if self._command.abort and not was_aborting:
            self.telemetry.append((self.time, "abort", {"altitude": self.altitude}))

    def _check(self) -> None:
        """Raise SoftwareFailure unless the command is valid."""
        wrong = [n for n, values in self._required if not all(map(math.isfinite, values.tolist()))]
        if wrong:
            raise self._failure(f"{' and '.join(wrong)}: not finite")
        answer, estimate = self._answer, self._answer.parts["estimate"]
        for part in (answer, estimate):
            norm = math.hypot(*part.flat["attitude"].tolist())
            if not abs(norm - 1.0) < 1e-3:
                raise self._failure(f"attitude has the norm {norm:g} instead of 1")
        if answer.get("thrust") < 0.0 or estimate.get("mass") <= 0.0:
            raise self._failure("thrust is negative, or mass is not positive")

    def _failure(self, detail: str) -> SoftwareFailure:
        return SoftwareFailure("computer", "invalid-output", detail)

    def _tasks(self) -> tuple[SensorTask, ...]:
        """Return the measurement tasks of the command."""
        count, limit = int(self._answer.get("task_count")), len(self._answer.parts["task"])
        if count > limit:
            raise self._failure(f"task_count is {count}, more than {limit}")
        tasks = []
        for part in self._answer.parts["task"][:count]:
            sensor, mount = int(part.get("sensor")), np.array(part.get("mount"))
            if sensor >= len(self._names) or (
                self._names[sensor] not in self.briefing.software.tasking
            ):
                raise self._failure(f"a task names sensor {sensor}, which has no [tasking] table")
            is_rotation = np.allclose(mount @ mount.T, np.eye(3), atol=1e-6)
            if not is_rotation or np.linalg.det(mount) < 0.0:
                raise self._failure("the mount of a task is not a rotation")
            tasks.append(SensorTask(self._names[sensor], mount))
        if len({task.sensor for task in tasks}) < count:
            raise self._failure("two tasks name the same sensor")
        return tuple(tasks)

    def command(self) -> Command:
        """Return the command to vehicle and sensors for the next control cycle."""
        self.attitude_loop.start_cycle(self._command, self.estimate.attitude, self.estimate.mass)
        return self._command

    def decide(self) -> None:
        """Do nothing: the software decides by itself."""

    def observe(self) -> Observation:
        """Raise an error: external software has no observation for a policy."""
        raise RuntimeError("an external computer has no observation")

    def close(self) -> None:
        """End the software."""
        self._connection.close()


class _Computer:
    """Settings of an external onboard computer."""

    def build(self, briefing: Briefing) -> ExternalComputer:
        """Start the onboard computer of one flight."""
        return ExternalComputer(briefing, self.connect("computer", briefing))  # type: ignore[attr-defined]


@dataclass(frozen=True)
class LibraryComputer(_Computer, LibrarySoftware):
    """Onboard computer in a shared library."""


@dataclass(frozen=True)
class ProcessComputer(_Computer, ProcessSoftware):
    """Onboard computer in a program."""
