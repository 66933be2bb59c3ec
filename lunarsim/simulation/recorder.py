"""Record a flight: states, commands, events, decisions, measurements and maps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.commands import Command
from lunarsim.messages.measurements import CameraImage, LidarScan, Measurements
from lunarsim.onboard.computer import OnboardComputer
from lunarsim.onboard.navigation.estimate import Estimate
from lunarsim.onboard.policies.contract import Candidates, Decision
from lunarsim.simulation.columns import (
    ACTUATORS,
    COMMANDS,
    MAX_READINGS_BYTES,
    NAVIGATION,
    SAMPLE_FIELDS,
    TRAJECTORY,
    CommandCycle,
    Cycle,
)
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.image_record import ImageRecorder
from lunarsim.simulation.map_record import MapRecord
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.vehicle.touchdown import LandingOutcome

# Maximum number of LiDAR returns kept per scan, enough for a figure.
_MAX_RETURNS = 4096
# Minimum time between two recorded scans, s.
_MIN_SCAN_INTERVAL_S = 0.5
# Measurements of a sensor closer in time than this form one sequence, s.
_SEQUENCE_GAP_S = 1.0


@dataclass
class MessageRecorder:
    """Recorder of all messages between plant and onboard computer in a flight.

    Attributes
    ----------
    briefing
        Data that the onboard computer knew before the flight.
    exchanges
        For each cycle: measurements, command, torques of the attitude loop (n, 3), N m.
    """

    briefing: Briefing | None = None
    exchanges: list[tuple[Measurements, Command, Array]] = field(default_factory=list)

    def exchange(self, measurements: Measurements, command: Command, torques: Array) -> None:
        """Record measurements, command and attitude torques of one control cycle."""
        self.exchanges.append((measurements, command, torques))


class RecordExtent(NamedTuple):
    """Numbers of entries of a record up to a moment of the flight.

    Attributes
    ----------
    time
        Time of the moment since the start of the flight, s.
    rows, commands, scans
        Numbers of control cycles, commands and LiDAR scans.
    events, telemetry, diverts
        Numbers of events of sensors, of events of the onboard computer, and of diverts.
    images
        Number of images of each camera.
    """

    time: float = -np.inf
    rows: int = 0
    commands: int = 0
    scans: int = 0
    events: int = 0
    telemetry: int = 0
    diverts: int = 0
    images: dict[str, int] = {}  # noqa: RUF012  (never changed)


class Recorder:
    """Recorder of states, commands, events, decisions, scans and maps of one flight.

    Parameters
    ----------
    target
        Target of the mission (3,), m.
    recorded
        Names of the sensors whose readings are recorded.
    cameras
        Names of the cameras whose images are recorded.
    """

    def __init__(
        self, target: Array, recorded: Sequence[str] = (), cameras: Sequence[str] = ()
    ) -> None:
        self._target = target
        self._images = {name: ImageRecorder(name) for name in cameras}
        self._readings: dict[str, _Readings] = {name: _Readings(name) for name in recorded}
        self._rows: list[Array] = []
        self._estimates: list[Array] = []
        self._commands: list[Array] = []
        self._scans: list[Array] = []
        self._sensor_events: list[dict[str, Any]] = []
        self._last: dict[str, float] = {}
        self._errors: dict[str, Array] = {}
        self._update_times: dict[str, float] = {}
        self._first_map: Estimate | None = None

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras whose images are recorded."""
        return list(self._images)

    def add_cycle(self, cycle: Cycle) -> None:
        """Add the state and the estimate at the end of one control cycle."""
        self._rows.append(TRAJECTORY.row(cycle))
        computer = cycle.computer
        estimate = computer.estimate.in_site(computer.navigation.site_to_local)
        self._estimates.append(NAVIGATION.row(estimate))

    def add_command(self, cycle: CommandCycle) -> None:
        """Add the commands of one control cycle."""
        self._commands.append(COMMANDS.row(cycle))

    def trajectory(self) -> dict[str, Array]:
        """Return the recorded trajectory as columns (n,) by name."""
        return TRAJECTORY.as_columns(self._rows)

    def record_measurements(
        self, measurements: Measurements, computer: OnboardComputer, error: Array, state: State
    ) -> None:
        """Record scans, images, readings and map updates of one control cycle.

        `error` (3,) is local minus true coordinates of updated maps, m; `state` is the true state.
        """
        for sensor, measurement in measurements.items:
            if isinstance(measurement, LidarScan | CameraImage):
                self._record_sensor(sensor, measurement, computer)
            fits = True
            if sensor in self._images:
                fits = self._images[sensor].add(measurement, state)
            elif sensor in self._readings:
                fits = self._readings[sensor].add(measurement)
            if not fits:
                self._sensor_events.append(
                    {"time": computer.time, "name": "recording-full", "sensor": sensor}
                )
        for name in computer.updated_mappers:
            self._errors[name] = error
            self._update_times[name] = computer.time
            if self._first_map is None:
                self._first_map = computer.estimate

    def add_events(self, events: Iterable[dict[str, Any]]) -> None:
        """Add events of sensors, with time and name."""
        self._sensor_events.extend(events)

    def _record_sensor(
        self, sensor: str, measurement: LidarScan | CameraImage, computer: OnboardComputer
    ) -> None:
        """Record an event for the first scan or image of a sequence, and LiDAR returns.

        `sensor` is the name of the sensor.
        """
        time = measurement.time
        seen = {"time": time, "name": "image", "sensor": sensor, "altitude": computer.altitude}
        if isinstance(measurement, LidarScan):
            self._keep_scan(measurement, computer.estimate)
            seen |= {"name": "scan", "returns": int(np.isfinite(measurement.range).sum())}
        if time > self._last.get(sensor, -np.inf) + _SEQUENCE_GAP_S:
            self._sensor_events.append(seen)
        self._last[sensor] = time

    def _keep_scan(self, scan: LidarScan, estimate: Estimate) -> None:
        """Record a thinned scan in the estimated local frame, at most two per second."""
        if self._scans and scan.time < self._scans[-1][0, 3] + _MIN_SCAN_INTERVAL_S - 1e-9:
            return
        points = scan.points(estimate.position, estimate.attitude)
        points = points[np.isfinite(points).all(axis=1)]
        # A regular subset in detector order would draw artificial lines.
        kept = np.random.default_rng(0).permutation(len(points))[:_MAX_RETURNS]
        points = points[np.sort(kept)]
        if len(points):
            self._scans.append(np.column_stack((points, np.full(len(points), scan.time))))

    def extent(self, computer: OnboardComputer) -> RecordExtent:
        """Return the numbers of entries that are recorded up to now."""
        return RecordExtent(
            computer.time, len(self._rows), len(self._commands), len(self._scans),
            len(self._sensor_events), len(computer.telemetry), len(computer.diverts),
            {name: len(images) for name, images in self._images.items()},
        )  # fmt: skip

    def flight(
        self,
        computer: OnboardComputer,
        *,
        scenario: str,
        seed: dict[str, Any],
        policy: str,
        outcome: LandingOutcome,
        ending: dict[str, Any] | None = None,
        actuators: Sequence[Array] = (),
        fault_events: Sequence[dict[str, Any]] = (),
        since: RecordExtent | None = None,
    ) -> Flight:
        """Build the record of the flight up to now.

        `scenario` is TOML text, `policy` a name, `ending` has values for the last event, and
        `actuators` are the commands of `vehicle.actuators.Actuators`, and `fault_events` the starts
        and ends of faults. With `since`, the record has only what was added since then.
        """
        first = RecordExtent() if since is None else since
        maps = {
            name: MapRecord(
                mapper.hazard_map(), self._errors[name], mapper.record_tables(),
                self._update_times[name],
            )
            for name, mapper in computer.mappers.items()
            if self._update_times.get(name, -np.inf) > first.time and not mapper.is_empty
        }  # fmt: skip
        decided = computer.decision_map_name
        return Flight(
            scenario=scenario,
            seed=seed,
            policy=policy,
            outcome=outcome,
            target=self._target,
            trajectory=TRAJECTORY.as_columns(self._rows[first.rows :]),
            navigation=NAVIGATION.as_columns(self._estimates[first.rows :]),
            commands=COMMANDS.as_columns(self._commands[first.commands :]),
            # The last cycle is simulated to its end, although the lander may land before.
            actuators=ACTUATORS.as_columns([row for row in actuators if row[0] <= computer.time])
            if len(actuators)
            else {},
            decisions=[_as_dict(*divert) for divert in computer.diverts[first.diverts :]],
            events=self._events(computer, outcome, ending or {}, fault_events, first),
            maps=maps,
            decision_mapper=decided,
            first_map=self._first_map,
            scans=np.vstack([np.zeros((0, 4)), *self._scans[first.scans :]]).astype(np.float32),
            candidates=_table(computer.candidates).astype(np.float32),
            readings={
                name: readings.as_columns()
                for name, readings in self._readings.items()
                if readings.blocks
            },
            images={
                name: images.record(first.images.get(name, 0))
                for name, images in self._images.items()
                if len(images) > first.images.get(name, 0)
            },
        )

    def _events(
        self,
        computer: OnboardComputer,
        outcome: LandingOutcome,
        ending: dict[str, Any],
        fault_events: Sequence[dict[str, Any]],
        first: RecordExtent,
    ) -> list[dict[str, Any]]:
        """Return the events after `first` in the order of time; arguments as in `flight`."""
        name = "touchdown" if outcome.touchdown else "end"
        last: list[dict[str, Any]] = [
            {"time": computer.time, "name": name, "failure_causes": list(outcome.failure_causes)}
            | ending
        ]
        if outcome.failure_causes == ("unfinished",):
            last = []
        telemetry = [
            {"time": time, "name": name, **more}
            for time, name, more in computer.telemetry[first.telemetry :]
        ]
        faults = [event for event in fault_events if event["time"] > first.time]
        found = [*faults, *self._sensor_events[first.events :], *telemetry, *last]
        return sorted(found, key=lambda event: float(event["time"]))


class _Readings:
    """Recorded readings of one sensor: names of columns, and blocks of rows.

    Each block has shape (n, columns). Columns have names such as "angles_0". Fields that are None
    are omitted.
    """

    def __init__(self, sensor: str) -> None:
        self.sensor = sensor
        self.names: list[str] = []
        self.blocks: list[Array] = []
        self._bytes = 0

    def add(self, measurement: Any) -> bool:
        """Record the numbers of a measurement; raise InputError for other contents.

        Return false for the first measurement that exceeds the maximum size of a record. This one
        and later ones are not recorded.
        """
        if self._bytes > MAX_READINGS_BYTES:
            return True
        names, block = self._block(measurement)
        if self.blocks and names != self.names:
            raise InputError(
                f"sensors.{self.sensor}", names,
                f"must give the same numbers in every reading, as in the first: {self.names}",
            )  # fmt: skip
        self.names = names
        self._bytes += block.nbytes
        if self._bytes > MAX_READINGS_BYTES:
            return False
        self.blocks.append(block)
        return True

    def as_columns(self) -> dict[str, Array]:
        """Return all recorded rows as columns (n,) by name."""
        table = np.vstack(self.blocks)
        return {name: table[:, i].copy() for i, name in enumerate(self.names)}

    def _block(self, measurement: Any) -> tuple[list[str], Array]:
        """Return names and rows (n, columns) of a measurement: a row, or a row per sample."""
        sampled = SAMPLE_FIELDS.get(type(measurement), ())
        count = len(getattr(measurement, sampled[0])) if sampled else 1
        names, parts = (["sample"], [np.arange(count)[:, None]]) if sampled else ([], [])
        try:
            for f in fields(measurement):
                value = getattr(measurement, f.name)
                if value is None:
                    continue
                rows = count if f.name in sampled else 1
                part = np.asarray(value, dtype=np.float64).reshape(rows, -1)
                width = part.shape[1]
                names += [f.name] if width == 1 else [f"{f.name}_{k}" for k in range(width)]
                parts.append(np.broadcast_to(part, (count, width)))
        except (TypeError, ValueError):
            raise InputError(
                f"sensors.{self.sensor}", type(measurement).__name__,
                "must give readings of dataclasses with numbers and vectors, because it is "
                "recorded",
            ) from None  # fmt: skip
        return names, np.hstack(parts).astype(np.float64)


def _as_dict(time: float, old: Array, new: Decision) -> dict[str, Any]:
    """Return a divert as a dictionary for the record.

    `time` is in s; `old` (3,) is the site before the divert, m.
    """
    return {"time": time, "from": old, "to": new.site, "reason": new.reason, **new.details}


def _table(candidates: Candidates | None) -> Array:
    """Return candidate sites as an array (n, 5): position, p_safe, propellant."""
    if candidates is None:
        return np.zeros((0, 5))
    return np.column_stack((candidates.position, candidates.p_safe, candidates.propellant))
