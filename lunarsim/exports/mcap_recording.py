"""Recording of a flight in MCAP, with the schemas of Foxglove."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import missing_package
from lunarsim.exports.ccsds import object_name
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.frames_and_times import Epoch, dates
from lunarsim.exports.local_frame import scans_in_site_frame
from lunarsim.exports.states import states_of
from lunarsim.scenario import Scenario
from lunarsim.simulation import Flight
from lunarsim.simulation.columns import COLUMN_TABLES, Table
from lunarsim.simulation.image_record import ImageRecord
from lunarsim.typing import Array


def write_mcap(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write a flight as an MCAP recording.

    The topics are ``/tf``, ``/path``, ``/scene``, ``/scans``, ``/map/NAME``, ``/camera/NAME/image``
    and ``calibration``, ``/events``, and one per table with its columns as JSON.

    Raises
    ------
    InputError
        If the packages of the extra `mcap` are missing, or a custom vehicle is not allowed.
    """
    for package, module in (
        ("mcap", "mcap"), ("foxglove-schemas-protobuf", "foxglove_schemas_protobuf"),
    ):  # fmt: skip
        if find_spec(module) is None:
            raise missing_package("--format", package, "mcap")
    epoch = Epoch.of(flight, options).date

    def write(part: Path) -> None:
        with part.open("wb") as file:
            _record(flight, _Recording(file, epoch))

    atomic_write(out, write)


def _record(flight: Flight, recording: _Recording) -> None:
    """Write all messages of a flight."""
    recording.add_poses(flight)
    recording.add_scene(flight)
    recording.add_scans(flight)
    recording.add_maps(flight)
    for name, images in flight.images.items():
        recording.add_images(name, images)
    for table in COLUMN_TABLES:
        if columns := getattr(flight, table.name):
            recording.add_table(table, columns)
    recording.add_events(flight)
    recording.finish(flight)


class _Recording:
    """Writer of one recording; it registers schemas and topics at their first message."""

    def __init__(self, stream: IO[bytes], epoch: np.datetime64) -> None:
        from mcap.writer import Writer  # noqa: PLC0415  (optional package)

        from lunarsim.exports import foxglove_messages  # noqa: PLC0415  (optional package)

        self._messages = foxglove_messages
        self._epoch = epoch
        self._writer = Writer(stream)
        self._writer.start(profile="", library="lunarsim")
        self._schemas: dict[type, int] = {}
        self._channels: dict[str, int] = {}

    def _date(self, time: float) -> int:
        """Return the date of a time since the start, s, in ns since 1970."""
        return int(dates(self._epoch, np.array([time]))[0].astype(np.int64))

    def _write(self, topic: str, when: int, message: Any) -> None:
        """Write a Protobuf message."""
        kind = type(message)
        if topic not in self._channels:
            if kind not in self._schemas:
                self._schemas[kind] = self._writer.register_schema(
                    kind.DESCRIPTOR.full_name, "protobuf", self._messages.descriptor_set(kind)
                )
            self._channels[topic] = self._writer.register_channel(
                topic, "protobuf", self._schemas[kind]
            )
        self._writer.add_message(self._channels[topic], when, message.SerializeToString(), when)

    def add_poses(self, flight: Flight) -> None:
        """Add the true pose at each time, and the complete true path at the start."""
        states = states_of(flight, "true")
        rows = zip(states.time, states.position, states.attitude, strict=True)
        for time, position, attitude in rows:
            when = self._date(time)
            self._write(
                "/tf", when,
                self._messages.transform(when, self._messages.LANDER, position, attitude),
            )  # fmt: skip
        start = self._date(states.time[0])
        self._write("/path", start, self._messages.path(start, states.position, states.attitude))

    def add_scene(self, flight: Flight) -> None:
        """Add lander, target, diverts, and candidates of the last decision."""
        lander = Scenario.world_from_toml(flight.scenario).vehicle.make()
        start = self._date(0.0)
        self._write("/scene", start, self._messages.lander_scene(start, lander, flight.target))
        # The error of the map belongs to all sites that were chosen on it.
        for decision in flight.decisions:
            when = self._date(decision["time"])
            site = np.asarray(decision["to"]) - flight.map_error
            self._write("/scene", when, self._messages.site_scene(when, site))
        found = flight.candidates.astype(np.float64)
        found = found[np.isfinite(found[:, :4]).all(axis=1)]
        if len(found):
            when = self._date(flight.decisions[-1]["time"] if flight.decisions else flight.duration)
            scene = self._messages.candidate_scene(
                when, found[:, :3] - flight.map_error, found[:, 3]
            )
            self._write("/scene", when, scene)

    def add_scans(self, flight: Flight) -> None:
        """Add one point cloud per recorded scan, in the site frame."""
        scans = scans_in_site_frame(flight)
        for time in np.unique(scans[:, 3]):
            when = self._date(time)
            points = scans[scans[:, 3] == time, :3]
            self._write("/scans", when, self._messages.point_cloud(when, points))

    def add_maps(self, flight: Flight) -> None:
        """Add the last hazard map of each mapper, at its last update."""
        for name, record in flight.maps.items():
            when = self._date(flight.duration if record.time is None else record.time)
            self._write(f"/map/{name}", when, self._messages.hazard_grid(when, record))

    def add_images(self, name: str, images: ImageRecord) -> None:
        """Add images, calibration and true pose of a camera."""
        frame = f"camera.{name}"
        for k in range(len(images)):
            row = {key: float(values[k]) for key, values in images.columns.items()}
            when = self._date(row["time"])
            pose = (
                np.array([row[f"position_{a}"] for a in "xyz"]),
                np.array([row[f"attitude_{a}"] for a in "xyzw"]),
            )
            self._write("/tf", when, self._messages.transform(when, frame, *pose))
            topic = f"/camera/{name}"
            self._write(f"{topic}/calibration", when, self._messages.calibration(when, frame, row))
            self._write(
                f"{topic}/image", when, self._messages.image(when, frame, images.encoded[k])
            )

    def add_table(self, table: Table, columns: dict[str, Array]) -> None:
        """Add a table as JSON messages with the names of its columns; null is not finite."""
        groups = table.columns(len(columns))
        fields = {
            name: {
                "type": ["number", "null"],
                "description": "; ".join(filter(None, (g.meaning, g.unit, g.frame))),
            }
            for name, g in groups.items()
        }
        schema = {"title": f"lunarsim.{table.name}", "type": "object", "properties": fields}
        channel = self._writer.register_channel(
            f"/{table.name}", "json",
            self._writer.register_schema(
                schema["title"], "jsonschema", json.dumps(schema).encode()  # type: ignore[arg-type]
            ),
        )  # fmt: skip
        names = list(groups)
        rows = np.column_stack([columns[name] for name in names]).astype(object)
        rows[~np.isfinite(rows.astype(np.float64))] = None
        for time, row in zip(columns["time"], rows.tolist(), strict=True):
            when = self._date(time)
            data = json.dumps(dict(zip(names, row, strict=True)), allow_nan=False).encode()
            self._writer.add_message(channel, when, data, when)

    def add_events(self, flight: Flight) -> None:
        """Add events and diverts to the log."""
        named: Callable[[dict[str, Any]], str] = lambda e: str(e.get("name", "divert"))  # noqa: E731
        for event in sorted([*flight.events, *flight.decisions], key=lambda e: e["time"]):
            details = {k: v for k, v in event.items() if k not in ("time", "name")}
            when = self._date(event["time"])
            text = f"{named(event)}: {json.dumps(details)}"
            self._write("/events", when, self._messages.log(when, named(event), text))

    def finish(self, flight: Flight) -> None:
        """Add the scenario and end the recording."""
        facts = {
            "name": object_name(flight), "policy": flight.policy, "scenario": flight.scenario,
            "seed": json.dumps(flight.seed), "safe": json.dumps(flight.outcome.safe),
            "frame": "site: true ENU; x east, y north, z up, m",
        }  # fmt: skip
        self._writer.add_metadata("lunarsim", facts)
        self._writer.finish()
