"""Store finished flights of a study in one file from which a later run resumes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lunarsim.campaign.files import code_digest, write_json
from lunarsim.campaign.manifest import first_difference
from lunarsim.errors import InputError

Flight = dict[str, Any]


class FlightStore:
    """Results of flights by name, in a file that is rewritten after each flight.

    Each rewrite is atomic.

    Parameters
    ----------
    path
        Path of the file; None: nothing is stored.
    settings
        Settings of the study, as JSON values; a file with other settings is refused.

    Attributes
    ----------
    flights
        Results of the finished flights by name, as JSON values.

    Raises
    ------
    InputError
        If the file cannot be read, has another format, or holds flights of another study.
    """

    def __init__(self, path: Path | None, settings: Mapping[str, Any]) -> None:
        self._path, self._settings = path, dict(settings)
        self.flights: dict[str, Flight] = {}
        self._code: dict[str, str] = {}
        if path is not None and path.exists():
            self._load(path)

    def _load(self, path: Path) -> None:
        """Load the flights stored in a file into the attribute `flights`."""
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(
                "flights.file", str(path), f"must be a complete JSON file ({error})"
            ) from None
        flights = data.get("flights") if isinstance(data, dict) else None
        if not isinstance(flights, dict) or not all(isinstance(f, dict) for f in flights.values()):
            raise InputError("flights.file", str(path), "must be a file of stored flights")
        difference = first_difference(data.get("settings"), self._settings, "settings")
        if difference is not None:
            raise InputError(
                "flights.file", str(path),
                "must contain flights with the same settings, but "
                + "{} is {!r} in the file and {!r} now".format(*difference),
            )  # fmt: skip
        self.flights = flights
        code = data.get("code")
        self._code = code if isinstance(code, dict) else {}

    @property
    def outdated_count(self) -> int:
        """Number of stored flights that were flown with other or unknown source code."""
        return sum(self._code.get(name) != code_digest() for name in self.flights)

    def keep(self, name: str, flight: Flight) -> None:
        """Add the result of a flight under its name and rewrite the file."""
        self.flights[name], self._code[name] = flight, code_digest()
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_json(
                self._path,
                {"settings": self._settings, "code": self._code, "flights": self.flights},
            )
