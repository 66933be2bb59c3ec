"""Attitude Ephemeris Message (CCSDS 504.0-B-1, AEM 1.0) in keyword-value notation."""

from __future__ import annotations

from pathlib import Path

from lunarsim.atomic_files import atomic_write_text
from lunarsim.exports import ccsds
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.frames_and_times import Epoch, ExportFrame, dates
from lunarsim.exports.states import states_of
from lunarsim.frames import normalised
from lunarsim.simulation import Flight


def write_aem(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write the attitudes of a flight as an AEM.

    The quaternions have the scalar last. They rotate frame A, the reference frame, into frame B,
    the body axes: `q v q*` converts components of a vector from body axes to frame A.
    """
    frame = ExportFrame.of(flight, options.longitude)
    states = states_of(flight, options.state)
    epoch = Epoch.of(flight, options)
    when = ccsds.date_texts(dates(epoch.date, states.time))
    name = ccsds.object_name(flight)
    notes = [
        *ccsds.comments(flight, frame, options.state, epoch),
        "COMMENT SC_BODY_1: z along the thrust, x forward, y left.",
        "COMMENT Frame A rotated by the quaternion has the axes of frame B.",
    ]
    lines = ccsds.header("AEM", "1.0") + ccsds.metadata(
        (
            ("OBJECT_NAME", name), ("OBJECT_ID", name), ("CENTER_NAME", "MOON"),
            ("REF_FRAME_A", frame.name), ("REF_FRAME_B", "SC_BODY_1"), ("ATTITUDE_DIR", "A2B"),
            ("TIME_SYSTEM", "UTC"), ("START_TIME", when[0]), ("STOP_TIME", when[-1]),
            ("ATTITUDE_TYPE", "QUATERNION"), ("QUATERNION_TYPE", "LAST"),
        ),
        notes,
    )  # fmt: skip
    quaternions = normalised(frame.attitudes(states.attitude))
    lines += ["DATA_START"]
    lines += [
        f"{date} {ccsds.numbers_text(row)}" for date, row in zip(when, quaternions, strict=True)
    ]
    lines += ["DATA_STOP"]
    atomic_write_text(out, "\n".join(lines) + "\n")
