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
        tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            name, str(path), f"a TOML file, which is text in UTF-8 ({error})"
        ) from None
    except (ValueError, RecursionError) as error:  # a number of 5,000 digits is no TOMLDecodeError
        raise InputError(name, str(path), f"a TOML file ({error})") from None
    if not tables:
        raise InputError(name, str(path), "a file with at least one key: this one holds none")
    return tables
