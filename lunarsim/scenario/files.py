"""Tables read from files that users write."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError

# Bytes of a file. A campaign of ten thousand arms has 1 MB, which takes 1.5 s to parse.
MAX_TOML_BYTES = 2**22
# Tables in each other. A scenario has four, an arm of a campaign some more.
_MAX_DEPTH = 40
# A key of more parts than that; tomllib needs memory that grows with the square of their number.
_DEEP_KEY = re.compile(
    r"""(?:(?:(?<![\w-])[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*)""" f"{{{_MAX_DEPTH}}}"
)


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
    if path.stat().st_size > MAX_TOML_BYTES:
        raise InputError(name, str(path), f"a file of at most {MAX_TOML_BYTES} bytes")
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
        If it is no TOML, nested too deep, or holds an integer of more than 64 bits.
    """
    if len(text) > MAX_TOML_BYTES or _DEEP_KEY.search(text):
        raise InputError(name, shown, "a TOML file that is not too large, nor nested too deep")
    try:
        tables = tomllib.loads(text)
        _check_values(tables)
    except (ValueError, RecursionError) as error:  # a number of 5,000 digits is no TOMLDecodeError
        raise InputError(name, shown, f"a TOML file ({error})") from None
    return tables


def _check_values(value: Any, depth: int = 0) -> None:
    """Refuse deep tables, which end in errors anywhere, and integers that TOML does not have."""
    if depth > _MAX_DEPTH:
        raise ValueError("nested too deep")
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError("an integer has more than 64 bits")
    if isinstance(value, Mapping | list):
        for one in value.values() if isinstance(value, Mapping) else value:
            _check_values(one, depth + 1)
