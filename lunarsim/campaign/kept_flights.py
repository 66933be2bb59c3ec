"""Flights of a study that are done, in one file that a later run goes on from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lunarsim.campaign.files import code_digest, write_json
from lunarsim.errors import InputError

Flight = dict[str, Any]


class KeptFlights:
    """Flights by name, in a file that is whole after each of them.

    Parameters
    ----------
    path
        Of the file; None: nothing is kept.
    settings
        Of the study, as JSON has them; a file of another is refused.

    Attributes
    ----------
    flights
        What is done, by name.

    Raises
    ------
    InputError
        If the file cannot be read, is no such file, or holds flights of another study.
    """

    def __init__(self, path: Path | None, settings: Mapping[str, Any]) -> None:
        self._path, self._settings = path, dict(settings)
        self.flights: dict[str, Flight] = {}
        self._code: dict[str, str] = {}
        if path is not None and path.exists():
            self._load(path)

    def _load(self, path: Path) -> None:
        """Take over what a file holds."""
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(
                "flights.file", str(path), f"a file of flights, not one that breaks off: {error}"
            ) from None
        flights = data.get("flights") if isinstance(data, dict) else None
        if not isinstance(flights, dict) or not all(isinstance(f, dict) for f in flights.values()):
            raise InputError("flights.file", str(path), "a file of flights that a study has kept")
        if data.get("settings") != self._settings:
            raise InputError(
                "flights.file", str(path),
                f"one of {self._settings}: it holds flights of {data.get('settings')}",
            )  # fmt: skip
        self.flights = flights
        code = data.get("code")
        self._code = code if isinstance(code, dict) else {}

    @property
    def of_other_code(self) -> int:
        """How many of the flights other source files made, or nobody says which."""
        return sum(self._code.get(name) != code_digest() for name in self.flights)

    def keep(self, name: str, flight: Flight) -> None:
        """Add a flight, and write the file anew."""
        self.flights[name], self._code[name] = flight, code_digest()
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_json(
                self._path,
                {"settings": self._settings, "code": self._code, "flights": self.flights},
            )
