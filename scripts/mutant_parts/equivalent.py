"""The list of faults that change no result, with the reason of each."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from .faults import Fault


class BrokenListError(ValueError):
    """The list of equivalent faults cannot be read."""


@dataclass(frozen=True)
class Equivalent:
    """A fault that no test can catch.

    Attributes
    ----------
    fault
        `file:line:column:operator`. The line only tells equal lines of code apart.
    code
        The line of code without the fault, stripped.
    reason
        Why nothing changes.
    """

    fault: str
    code: str
    reason: str

    def match(self, faults: list[Fault]) -> Fault | None:
        """Return the fault that is meant: the nearest of those with this code and place in it."""
        path, line, column, operator = self.fault.rsplit(":", 3)
        alike = [
            f
            for f in faults
            if (f.path, f.column, f.operator, f.code) == (path, int(column), operator, self.code)
        ]
        return min(alike, key=lambda f: abs(f.line - int(line)), default=None)


def load_equivalents(path: Path) -> list[Equivalent]:
    """Read the list.

    Parameters
    ----------
    path
        TOML file with tables `[[equivalent]]` of `fault`, `code` and `reason`.

    Raises
    ------
    BrokenListError
        Saying which entry is wrong, and how.
    """
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8")).get("equivalent", [])
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise BrokenListError(f"{path}: {error}") from error
    found = []
    for n, entry in enumerate(entries, 1):
        known = isinstance(entry, dict) and set(entry) == {"fault", "code", "reason"}
        if not known or not all(isinstance(v, str) and v.strip() for v in entry.values()):
            raise BrokenListError(f"{path}: entry {n} needs fault, code and reason, and no more")
        place = entry["fault"].rsplit(":", 3)
        if len(place) != 4 or not (place[1].isdigit() and place[2].isdigit()):
            raise BrokenListError(
                f"{path}: entry {n}: {entry['fault']!r} is not file:line:column:operator"
            )
        found.append(Equivalent(**entry))
    return found
