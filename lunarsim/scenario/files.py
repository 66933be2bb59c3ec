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
        If it is missing or no TOML.
    """
    if not path.is_file():
        raise InputError(name, str(path), "an existing TOML file")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(name, str(path), f"a TOML file ({error})") from None
