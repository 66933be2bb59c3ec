"""Known equivalent faults, which change no result, with their reasons."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from .faults import Mutant


class BrokenListError(ValueError):
    """Error: the list of equivalent faults cannot be read."""


@dataclass(frozen=True)
class EquivalentMutant:
    """Entry in the list of faults that no test can catch, because no result changes.

    Attributes
    ----------
    fault
        `file:line:column:operator`. The line only distinguishes equal lines of code.
    code
        Line of code without the fault, stripped.
    reason
        Reason why no result changes.
    """

    fault: str
    code: str
    reason: str

    def match(self, faults: list[Mutant]) -> Mutant | None:
        """Return the fault that this entry describes, or None.

        It is the nearest fault by line that has the same file, code, column and operator.
        """
        path, line, column, operator = self.fault.rsplit(":", 3)
        alike = [
            f
            for f in faults
            if (f.path, f.column, f.operator, f.code) == (path, int(column), operator, self.code)
        ]
        return min(alike, key=lambda f: abs(f.line - int(line)), default=None)


def load_equivalents(path: Path) -> list[EquivalentMutant]:
    """Read the list of equivalent faults.

    Parameters
    ----------
    path
        TOML file with tables `[[equivalent]]` of `fault`, `code` and `reason`.

    Raises
    ------
    BrokenListError
        If an entry is invalid; the message names the entry.
    """
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8")).get("equivalent", [])
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise BrokenListError(f"{path}: {error}") from error
    found = []
    for n, entry in enumerate(entries, 1):
        known = isinstance(entry, dict) and set(entry) == {"fault", "code", "reason"}
        if not known or not all(isinstance(v, str) and v.strip() for v in entry.values()):
            raise BrokenListError(
                f"{path}: entry {n}: must have the keys fault, code and reason, and no others"
            )
        place = entry["fault"].rsplit(":", 3)
        if len(place) != 4 or not (place[1].isdigit() and place[2].isdigit()):
            raise BrokenListError(
                f"{path}: entry {n}: fault must have the form file:line:column:operator, "
                f"got {entry['fault']!r}"
            )
        found.append(EquivalentMutant(**entry))
    return found
