"""Rename the keys of a scenario or campaign file from an earlier version.

The rest of the text stays as it is.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError
from lunarsim.scenario.files import parsed_toml, read_toml
from lunarsim.scenario.renamed_keys import (
    RENAMED_SCENARIOS,
    RENAMED_VALUES,
    current_path,
    current_steps,
    pattern_of,
)

_TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}' r"|'''.*?'{3,5}" r'|"(?:\\.|[^"\\\n])*"' r"|'[^'\n]*'"
    r"|#[^\n]*|[\w+:-]+|[ \t\r]+|.|\n",
    re.DOTALL,
)  # fmt: skip
# Tables of a campaign file whose keys are keys of a scenario.
_CAMPAIGN_TABLES = (["dispersions"], ["factors"], ["arms", "set"], ["scenario"])


class _Token(NamedTuple):
    text: str
    start: int

    @property
    def plain(self) -> str:
        """Text of the token without quotes and escapes."""
        if not self.is_quoted:
            return self.text
        return str(tomllib.loads(f"text = {self.text}")["text"])

    @property
    def is_quoted(self) -> bool:
        return self.text[0] in "\"'"


def upgrade_file(path: Path) -> list[str]:
    """Rename keys of an earlier version in a scenario or campaign file.

    The file keeps its comments, order and layout.

    Returns
    -------
    list of str
        Changes as "old -> new"; empty if there are none.

    Raises
    ------
    InputError
        If the file is missing or not TOML, or has both the old and the new name of a key.
    OSError
        If the file cannot be written; the file is then unchanged.
    """
    read_toml(path, "FILE")
    old = path.read_bytes().decode("utf-8")
    mark = "\ufeff" * old.startswith("\ufeff")
    text, changes = upgrade_text(old.removeprefix("\ufeff"))
    if changes:
        _replace_contents(path.resolve(), mark + text)
    return changes


def _replace_contents(path: Path, text: str) -> None:
    """Replace the text of a file and keep its permissions; refuse a read-only file."""
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    def write(part: Path) -> None:
        part.write_bytes(text.encode())
        shutil.copymode(path, part)

    atomic_write(path, write)


def upgrade_text(text: str) -> tuple[str, list[str]]:
    """Rename keys of an earlier version in TOML text; return text and changes.

    Each change has the form "old -> new".

    Raises
    ------
    InputError
        If the text is not TOML, or has both the old and the new name of a key.

    Examples
    --------
    >>> upgrade_text("policy.enough = 0.9  # half")
    ('policy.p_safe_min = 0.9  # half', ['enough -> p_safe_min'])
    """
    tables = parsed_toml(text, "FILE")
    found = _Renamer(text, tables).renamings()
    out = text
    for token, new in reversed(found):
        quote = token.text[0] if token.is_quoted else ""
        out = f"{out[: token.start]}{quote}{new}{quote}{out[token.start + len(token.text) :]}"
    changes = list(dict.fromkeys(f"{token.plain} -> {new}" for token, new in found))
    try:
        parsed_toml(out, "FILE")
    except InputError:
        raise InputError(
            "FILE", changes, "contains both the old and the new name of a key "
            f"({', '.join(changes)[:100]})", "Delete the old key.", show_value=False,
        ) from None  # fmt: skip
    return out, changes


class _Renamer:
    """Parser of TOML text that finds the keys and values that have a new name."""

    def __init__(self, text: str, tables: Mapping[str, Any]) -> None:
        tokens = [_Token(m[0], m.start()) for m in _TOKEN.finditer(text)]
        self._tokens = [t for t in tokens if t.text[0] not in "# \t\r"]
        self._next = 0
        self._is_campaign = isinstance(tables.get("scenario"), str | dict)
        self._custom_tables = _custom_tables(tables)
        self._found: list[tuple[_Token, str]] = []

    def renamings(self) -> list[tuple[_Token, str]]:
        """Return the tokens to replace, each with its new text, in the order of the text."""
        table: list[str] = []
        while self._next < len(self._tokens):
            if self._peek() == "\n":
                self._next += 1
            elif self._peek() == "[":
                while self._peek() == "[":
                    self._next += 1
                table = self._key([])
                while self._peek() == "]":
                    self._next += 1
            else:
                self._assignment(table)
        return self._found

    def _peek(self) -> str:
        return self._tokens[self._next].text if self._next < len(self._tokens) else "\n"

    def _assignment(self, table: list[str]) -> None:
        path = self._key(table)
        self._next += 1  # the equals sign
        self._value(path)

    def _key(self, table: list[str]) -> list[str]:
        """Read a dotted key of `table`, and record the tokens that have a new name.

        Returns the path of the key as in the file, with the names of its tables.
        """
        path = list(table)
        while self._peek() not in ("=", "]"):
            token = self._tokens[self._next]
            self._next += 1
            if token.text == ".":
                continue
            steps = token.plain.split(".") if self._is_campaign else [token.plain]
            path += steps
            new = self._current(path)[-len(steps) :]
            self._note(token, ".".join(new))
        return path

    def _value(self, path: list[str]) -> None:
        token = self._tokens[self._next]
        self._next += 1
        if token.text in ("[", "{"):
            while self._peek() not in ("]", "}"):
                if self._peek() in (",", "\n"):
                    self._next += 1
                elif token.text == "{":
                    self._assignment(path)
                else:
                    self._value(path)
            self._next += 1
        elif token.is_quoted:
            self._note(token, self._current_value(path, token.plain))
        else:
            while self._peek() not in (",", "]", "}", "\n"):
                self._next += 1

    def _note(self, token: _Token, new: str) -> None:
        if new != token.plain:
            self._found.append((token, new))

    def _current(self, path: list[str]) -> list[str]:
        custom = next((part for part in self._custom_tables if path[: len(part)] == part), [])
        if custom:
            return self._current_known(custom) + path[len(custom) :]
        return self._current_known(path)

    def _current_known(self, path: list[str]) -> list[str]:
        if not self._is_campaign:
            return current_steps(path)
        for table in _CAMPAIGN_TABLES:
            if path[: len(table)] == table and len(path) > len(table):
                return table + current_steps(path[len(table) :])
        return path

    def _current_value(self, path: list[str], value: str) -> str:
        if self._is_campaign and path == ["scenario"]:
            return RENAMED_SCENARIOS.get(value, value)
        if self._is_campaign and path == ["correlations", "keys"]:
            return current_path(value)
        where = self._current(path)
        for table in _CAMPAIGN_TABLES if self._is_campaign else ():
            if where[: len(table)] == table:
                where = where[len(table) :]
        return RENAMED_VALUES.get((pattern_of(where), value), value)


def _custom_tables(table: Any, path: tuple[str, ...] = ()) -> list[list[str]]:
    """Return the paths of tables of a custom kind, whose keys are never renamed."""
    if not isinstance(table, Mapping):
        return []
    if ":" in str(table.get("kind", "")):
        return [list(path)]
    return [part for key, value in table.items() for part in _custom_tables(value, (*path, key))]
