"""Keyword-value notation of the CCSDS navigation messages."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

import lunarsim
from lunarsim.exports.frames_and_times import Epoch, ExportFrame
from lunarsim.simulation import Flight


def date_texts(when: NDArray[np.datetime64]) -> list[str]:
    """Return dates as ISO 8601 texts with nanoseconds, without a time zone."""
    return [str(date) for date in when.astype("datetime64[ns]")]


def header(message: str, version: str) -> list[str]:
    """Return the lines of a header; `message` is the kind, such as OEM."""
    return [
        f"CCSDS_{message}_VERS = {version}",
        f"COMMENT Written by lunarsim {lunarsim.__version__}.",
        f"CREATION_DATE = {datetime.now(UTC):%Y-%m-%dT%H:%M:%S}",
        "ORIGINATOR = LUNARSIM",
        "",
    ]


def comments(flight: Flight, frame: ExportFrame, state: str, epoch: Epoch) -> list[str]:
    """Return comments on state, frame, epoch and origin of the data.

    `state` is "true" or "estimate".
    """
    state = "True state" if state == "true" else "State estimated by navigation"
    seed = f"seed {flight.seed.get('entropy')}, flight {flight.seed.get('spawn_key')}"
    lines = (
        f"{state} of a simulated lander, centre of mass. Scenario {object_name(flight)}, {seed}.",
        *frame.comments,
        epoch.comment,
    )
    return [f"COMMENT {line}" for line in lines]


def object_name(flight: Flight) -> str:
    """Return the name of the scenario as one printable word."""
    try:
        name = str(tomllib.loads(flight.scenario).get("name", "lander"))
    except tomllib.TOMLDecodeError:  # a record from others
        name = "lander"
    word = "".join(c if c.isascii() and (c.isalnum() or c in "-.") else "_" for c in name)
    return word[:60] or "lander"


def metadata(pairs: Iterable[tuple[str, str]], notes: Iterable[str]) -> list[str]:
    """Return the lines of a metadata block with comments and keywords."""
    return ["META_START", *notes, *(f"{key} = {value}" for key, value in pairs), "META_STOP", ""]


def numbers_text(numbers: Iterable[float]) -> str:
    """Return numbers with 16 significant digits, separated by blanks."""
    return " ".join(f"{number:.15e}" for number in numbers)
