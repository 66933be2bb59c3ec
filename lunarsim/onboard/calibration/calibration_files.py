"""Files of calibrations: written atomically, and checked value by value when read."""

from __future__ import annotations

import json
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError
from lunarsim.untrusted_files import read_json


def check_number(key: str, value: object) -> float:
    """Return a value of a calibration as a float after checking it.

    `key` is its key, for the message of the `InputError` that is raised if the value is not a
    finite number.
    """
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and abs(value) <= sys.float_info.max):  # type: ignore[arg-type]  # nor NaN
        raise InputError(f"calibration.{key}", value, "must be a finite number")
    return float(value)  # type: ignore[arg-type]


@dataclass(frozen=True)
class CalibrationTable:
    """Table of a calibration file whose values are checked when they are read.

    Attributes
    ----------
    data
        Values by key.
    writer
        Command that writes such a file.
    """

    data: Mapping[str, Any]
    writer: str

    def value(self, key: str, kind: type | None = None) -> Any:
        """Return the value of a key, of the type `kind`; omitted: of any type.

        An `InputError` is raised if the key is missing or its value has another type.
        """
        if key not in self.data:
            raise InputError(
                f"calibration.{key}", None, "is missing from the calibration file",
                f"Write such a file with {self.writer}.", show_value=False,
            )  # fmt: skip
        value = self.data[key]
        if kind is not None and (not isinstance(value, kind) or isinstance(value, bool)):
            words = {str: "must be a text", int: "must be an integer", dict: "must be a table"}
            raise InputError(f"calibration.{key}", value, words[kind])
        return value

    def table(self, key: str) -> CalibrationTable:
        """Return the table stored under a key.

        An `InputError` is raised if the key is missing or its value is not a table.
        """
        return CalibrationTable(self.value(key, dict), self.writer)

    def number(self, key: str) -> float:
        """Return the number stored under a key.

        An `InputError` is raised if the key is missing or its value is not a finite number.
        """
        return check_number(key, self.value(key))

    def range(self, key: str) -> tuple[float, float]:
        """Return the minimum and maximum stored under a key.

        An `InputError` is raised if the value is not a list of two finite numbers.
        """
        value = self.data.get(key)
        if not isinstance(value, list) or len(value) != 2:
            raise InputError(f"calibration.{key}", value, "must be a list of minimum and maximum")
        return check_number(key, value[0]), check_number(key, value[1])


class StoredCalibration(ABC):
    """Dataclass of a calibration that is stored as a JSON file.

    Attributes
    ----------
    file_format, writer
        Value of the key `format`, and command that writes such a file.
    """

    file_format: ClassVar[str]
    writer: ClassVar[str]

    def save(self, path: Path) -> None:
        """Write the calibration to a JSON file, atomically (complete or absent).

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        data = {"format": self.file_format, **asdict(self)}  # type: ignore[call-overload]
        atomic_write_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a calibration from a JSON file written by `save`.

        Raises
        ------
        InputError
            If the file is missing, has another format, or contains an invalid value.
        """
        field, file, hint = "calibration", str(path), f" written by {cls.writer}"
        if not path.is_file():
            raise InputError(field, file, f"does not exist, but must be a file{hint}")
        try:
            data = read_json(path)
        except ValueError as error:
            raise InputError(field, file, f"must be a JSON file{hint} ({error})") from None
        if not isinstance(data, dict) or data.get("format") != cls.file_format:
            wanted = f"must be a file{hint} with format = {cls.file_format!r}"
            raise InputError(field, file, wanted)
        return cls._parsed(CalibrationTable(data, cls.writer))

    @classmethod
    @abstractmethod
    def _parsed(cls, table: CalibrationTable) -> Self:
        """Return the calibration of a table with the keys of the file."""
