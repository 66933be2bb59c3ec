"""Tables read from files that users write."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError


def read_toml(path: Path, name: str) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Parameters
    ----------
    path
        The file.
    name
        What it is, for errors.

    Raises
    ------
    InputError
        If it is missing, holds nothing, or is no TOML. A byte order mark at its start is read over.
    """
    if not path.is_file():
        raise InputError(name, str(path), "an existing TOML file")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            name, str(path), f"a TOML file, which is text in UTF-8 ({error})"
        ) from None
    tables = parsed_toml(text, name, str(path))
    if not tables:
        raise InputError(name, str(path), "a file with at least one key: this one holds none")
    return tables


def parsed_toml(text: str, name: str = "scenario", shown: str = "text") -> dict[str, Any]:
    """Return the tables of a TOML text.

    Parameters
    ----------
    text
        What is parsed.
    name, shown
        Field and value of the error.

    Raises
    ------
    InputError
        If it is no TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number of 5,000 digits is no TOMLDecodeError
        raise InputError(name, shown, f"a TOML file ({error})") from None
