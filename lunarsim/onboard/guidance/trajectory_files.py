"""Files with a reference trajectory: CCSDS OEM (keyword-value notation) and CSV."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from lunarsim.csv_columns import MAX_ROWS, read_csv_columns, read_text_lines
from lunarsim.errors import InputError, error_reason
from lunarsim.onboard.guidance.reference_trajectory import ReferenceTrajectory
from lunarsim.typing import Array

# Frame of the positions in an OEM, as `lunarsim export --format oem` writes it.
SITE_FRAME_NAME = "LUNARSIM_SITE_ENU"
# Columns of a CSV file with their units, as `lunarsim export --format csv` writes them.
_COLUMNS = (
    ("time", "s"),
    *((f"position_{axis}", "m") for axis in "xyz"),
    *((f"velocity_{axis}", "m/s") for axis in "xyz"),
)
# Calendar date, or year and day of the year (CCSDS 301.0-B, ASCII time codes A and B).
_DATE = re.compile(r"(\d{4})-(?:\d\d-\d\d|(\d{3}))(T\d\d:\d\d:\d\d(?:\.\d+)?)Z?")
# Keys of the metadata, and the values that they must have.
_REQUIRED = {"CENTER_NAME": "MOON", "REF_FRAME": SITE_FRAME_NAME}


def load_trajectory(path: Path) -> ReferenceTrajectory:
    """Read a reference trajectory from an OEM (.oem) or a CSV file (.csv).

    Raises
    ------
    InputError
        If the file is missing, too large or invalid; the error names the field "path".
    """
    suffix = path.suffix.lower()
    if suffix not in (".oem", ".csv"):
        raise InputError("path", str(path), "must be a file name that ends in .oem or .csv")
    try:
        table = _read_csv(path) if suffix == ".csv" else _read_oem(path)
    except (ValueError, OSError) as error:
        reason = error_reason(error)
        raise InputError(
            "path", str(path), f"must be a valid trajectory, because {reason}"
        ) from None
    try:
        return ReferenceTrajectory(table[:, 0], table[:, 1:4], table[:, 4:])
    except InputError as error:
        problem = f"{error.problem} ({error.value})"
        raise InputError("path", str(path), problem, error.remedy) from None


def _read_csv(path: Path) -> Array:
    """Return time, position and velocity (n, 7) of a CSV file, s, m, m/s."""
    return np.column_stack(list(read_csv_columns(path, _COLUMNS).values()))


def _read_oem(path: Path) -> Array:
    """Return time, position and velocity (n, 7) of an OEM, s, m, m/s."""
    rows = list(islice(_oem_rows(read_text_lines(path)), MAX_ROWS + 1))
    if len(rows) > MAX_ROWS:
        raise ValueError(f"it has more than {MAX_ROWS} states")
    return np.array(rows, dtype=np.float64).reshape(-1, 7)


def _oem_rows(lines: list[str]) -> Iterator[list[float]]:
    """Yield time since the first state, s, position, m, and velocity, m/s, of an OEM."""
    if not lines or not lines[0].strip().startswith("CCSDS_OEM_VERS"):
        raise ValueError("it does not begin with CCSDS_OEM_VERS")
    start, is_metadata, is_covariance, blocks = None, False, False, 0
    keys: set[str] = set()
    for number, line in enumerate(map(str.strip, lines), start=1):
        words = line.split()
        if line == "META_START":
            is_metadata, blocks = True, blocks + 1
            if blocks > 1:
                raise ValueError("it has more than one segment")
        elif line in ("META_STOP", "COVARIANCE_START", "COVARIANCE_STOP"):
            is_metadata, is_covariance = False, line == "COVARIANCE_START"
        elif is_metadata:
            keys.add(_checked_key(line))
        elif words and _DATE.fullmatch(words[0]) and not is_covariance:
            if missing := sorted(_REQUIRED.keys() - keys):
                raise ValueError(f"its metadata do not state {missing[0]}")
            if len(words) not in (7, 10):
                raise ValueError(f"line {number} has {len(words) - 1} numbers instead of 6 or 9")
            date = _date(words[0])
            start = date if start is None else start
            numbers = _numbers(words[1:7], number)
            time = float((date - start) / np.timedelta64(1, "ns")) * 1e-9
            yield [time, *(1e3 * value for value in numbers)]
        elif blocks and words and not is_covariance and words[0] != "COMMENT":
            raise ValueError(f"line {number} is not a state")


def _checked_key(line: str) -> str:
    """Return the key of a metadata line; ValueError for another body or frame."""
    key, _, value = (text.strip() for text in line.partition("="))
    if key in _REQUIRED and value.upper() != _REQUIRED[key]:
        raise ValueError(f"{key} is {value!r} instead of {_REQUIRED[key]}")
    return key


def _date(text: str) -> np.datetime64:
    """Return a calendar date or a day of the year; ValueError if there is none."""
    date = _DATE.fullmatch(text)
    assert date is not None
    year, day, time = date.groups()
    if day is None:
        return np.datetime64(text.removesuffix("Z"), "ns")
    first = np.datetime64(f"{year}-01-01", "D")
    found = first + np.timedelta64(int(day) - 1, "D")
    if str(found)[:4] != year:
        raise ValueError(f"the year {year} has no day {day}")
    return np.datetime64(f"{found}{time}", "ns")


def _numbers(texts: list[str], line: int) -> list[float]:
    """Return texts as numbers; the error names the line."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        raise ValueError(f"line {line} has a value that is not a number") from None
