"""CSV files with rocks at given places."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from lunarsim.csv_columns import read_csv_columns
from lunarsim.errors import InputError, error_reason
from lunarsim.typing import Array

# Minimum and maximum diameter of a rock, and maximum exposed height divided by the diameter.
_MIN_DIAMETER_M, _MAX_DIAMETER_M, _MAX_HEIGHT_RATIO = 0.01, 100.0, 5.0


class GivenRocks(NamedTuple):
    """Rocks at given places in the frame of the terrain.

    Attributes
    ----------
    x, y
        Centres (n,), east and north, m.
    diameter
        Diameters (n,), m.
    height
        Exposed heights (n,), m; NaN: not given.
    """

    x: Array
    y: Array
    diameter: Array
    height: Array


def load_rocks(path: Path) -> GivenRocks:
    """Read rocks from a CSV file with the columns x, y, diameter and height, m.

    The column of the heights, and single heights (``nan`` or an empty cell), may be absent.

    Raises
    ------
    InputError
        If the file is missing, too large or invalid; the error names the field "path".
    """
    try:
        names = [(name, "m") for name in ("x", "y", "diameter")]
        columns = read_csv_columns(path, names, [("height", "m")])
    except (ValueError, OSError) as error:
        reason = error_reason(error)
        raise InputError(
            "path", str(path), f"must be a valid table of rocks, because {reason}"
        ) from None
    absent = np.full(len(columns["x"]), np.nan)
    found = GivenRocks(
        columns["x"], columns["y"], columns["diameter"], columns.get("height", absent)
    )
    _check(path, found)
    return found


def _check(path: Path, rocks: GivenRocks) -> None:
    """Raise InputError for the first rock with an impossible value."""
    known = ~np.isnan(rocks.height)
    with np.errstate(divide="ignore", invalid="ignore"):  # reported below
        ratio = np.where(known, rocks.height / rocks.diameter, 0.5)
    for wrong, problem in (
        (~np.isfinite(rocks.x + rocks.y), "must have finite coordinates"),
        (
            ~((rocks.diameter >= _MIN_DIAMETER_M) & (rocks.diameter <= _MAX_DIAMETER_M)),
            f"must have a diameter between {_MIN_DIAMETER_M:g} and {_MAX_DIAMETER_M:g} m",
        ),
        (
            ~((ratio > 0.0) & (ratio <= _MAX_HEIGHT_RATIO)),
            f"must have a positive height of at most {_MAX_HEIGHT_RATIO:g} diameters",
        ),
    ):
        if wrong.any():
            number = int(np.argmax(wrong)) + 1
            raise InputError("path", str(path), f"{problem}, because rock {number} has not")
