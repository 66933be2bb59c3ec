"""Orbit Ephemeris Message (CCSDS 502.0-B-2, OEM 2.0) in keyword-value notation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lunarsim.atomic_files import atomic_write_text
from lunarsim.exports import ccsds
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.frames_and_times import Epoch, ExportFrame, dates
from lunarsim.exports.states import states_of
from lunarsim.simulation import Flight
from lunarsim.typing import Array

# Kilometres per metre: the unit of OEM is the kilometre.
_KM = 1e-3


def write_oem(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write positions and velocities of a flight as an OEM.

    The estimated state has the covariance of position and velocity at each time at which it is
    finite and not zero.
    """
    frame = ExportFrame.of(flight, options.longitude)
    states = states_of(flight, options.state)
    epoch = Epoch.of(flight, options)
    when = ccsds.date_texts(dates(epoch.date, states.time))
    name = ccsds.object_name(flight)
    lines = ccsds.header("OEM", "2.0") + ccsds.metadata(
        (
            ("OBJECT_NAME", name), ("OBJECT_ID", name), ("CENTER_NAME", "MOON"),
            ("REF_FRAME", frame.name), ("TIME_SYSTEM", "UTC"), ("START_TIME", when[0]),
            ("STOP_TIME", when[-1]), ("INTERPOLATION", "HERMITE"), ("INTERPOLATION_DEGREE", "3"),
        ),
        ccsds.comments(flight, frame, options.state, epoch),
    )  # fmt: skip
    vectors = _KM * np.hstack((frame.positions(states.position), frame.vectors(states.velocity)))
    lines += [f"{date} {ccsds.numbers_text(row)}" for date, row in zip(when, vectors, strict=True)]
    if states.covariance is not None:
        lines += _covariance_lines(when, frame.covariances(states.covariance))
    atomic_write_text(out, "\n".join(lines) + "\n")


def _covariance_lines(when: list[str], covariances: Array) -> Iterator[str]:
    """Yield the covariance block: lower triangles of matrices (n, 6, 6) in m and m/s."""
    # External software that states no covariance has one of zeros.
    known = np.asarray(np.isfinite(covariances).all(axis=(1, 2)) & covariances.any(axis=(1, 2)))
    if not known.any():
        return
    yield from ("", "COVARIANCE_START")
    for date, covariance, is_known in zip(when, _KM**2 * covariances, known, strict=True):
        if is_known:
            yield f"EPOCH = {date}"
            yield from (ccsds.numbers_text(covariance[i, : i + 1]) for i in range(6))
    yield "COVARIANCE_STOP"
