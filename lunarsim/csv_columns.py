"""Read columns of numbers with units from CSV files of others, within size limits."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lunarsim.typing import Array

# Maximum size of a file, bytes, and maximum number of rows.
MAX_BYTES, MAX_ROWS = 2**26, 200_000
_HEADING = re.compile(r"\s*(.*?)\s*\(([^()]*)\)\s*")


def read_text_lines(path: Path) -> list[str]:
    """Return the lines of a text file from others.

    Raises
    ------
    ValueError
        If it is not a file, is larger than 64 MiB, or is not text in UTF-8.
    OSError
        If it cannot be read.
    """
    if not path.is_file():
        raise ValueError("it is not an existing file")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(f"it is larger than {MAX_BYTES // 2**20} MiB")
    return path.read_text(encoding="utf-8-sig").splitlines()


def read_csv_columns(
    path: Path, columns: Sequence[tuple[str, str]], optional: Sequence[tuple[str, str]] = ()
) -> dict[str, Array]:
    """Return columns (n,) by name from a CSV file with units in its header.

    A heading is, for instance, ``time (s)``. Empty cells are NaN; empty rows and lines that begin
    with "#" are ignored.

    Parameters
    ----------
    path
        File to read.
    columns, optional
        Names and units of the required columns, and of those that may be absent. The file may have
        other columns.

    Raises
    ------
    ValueError
        If the file is missing, too large, or not a table with these columns and units. The message
        completes a sentence after "because".
    OSError
        If the file cannot be read.
    """
    lines = ("" if line.startswith("#") else line for line in read_text_lines(path))
    reader = csv.reader(lines, strict=True)
    try:
        header = next((cells for cells in reader if any(map(str.strip, cells))), [])
        headings = [(k, m) for k, text in enumerate(header) if (m := _HEADING.fullmatch(text))]
        found = {m[1]: (k, m[2]) for k, m in headings}
        wanted = [*columns, *((name, unit) for name, unit in optional if name in found)]
        for name, unit in wanted:
            if name not in found:
                raise ValueError(f"its header has no column '{name} ({unit})'")
            if sum(m[1] == name for _, m in headings) > 1:
                raise ValueError(f"its header has more than one column {name!r}")
            if found[name][1] != unit:
                raise ValueError(f"its column {name} has the unit {found[name][1]!r}, not {unit!r}")
        rows: list[list[float]] = []
        for cells in reader:
            if any(map(str.strip, cells)):
                rows.append(_numbers(cells, [found[name][0] for name, _ in wanted], reader))
            if len(rows) > MAX_ROWS:
                raise ValueError(f"it has more than {MAX_ROWS} rows")
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num} is not CSV ({error})") from None
    table = np.array(rows, dtype=np.float64).reshape(-1, len(wanted))
    return {name: table[:, k].copy() for k, (name, _) in enumerate(wanted)}


def _numbers(cells: list[str], columns: list[int], reader: Any) -> list[float]:
    """Return the numbers of one row; the error names the line."""
    try:
        return [float(cells[k]) if cells[k].strip() else np.nan for k in columns]
    except (ValueError, IndexError):
        raise ValueError(f"line {reader.line_num} has a value that is not a number") from None
