"""Read TOML files from users, with limits on size and depth."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError

# Maximum size of a file, bytes. A campaign of 10,000 arms has 1 MB, which takes 1.5 s to parse.
MAX_TOML_BYTES = 2**22
# Maximum depth of nested tables. A scenario has 4, an arm of a campaign some more.
_MAX_DEPTH = 40
_TOO_LARGE = f"must not be larger than {MAX_TOML_BYTES // 2**20} MiB"
_LARGE_INTEGER = "an integer has more than 64 bits"
_TOO_DEEP = f"tables are nested more than {_MAX_DEPTH} levels deep"
# Matches the place at the end of an error of tomllib.
_PLACE = re.compile(r" \((at [^()]*)\)$")
# Matches keys with more parts than that: the memory of tomllib grows with the square of the number.
_DEEP_KEY = re.compile(
    r"""(?:(?:(?<![\w-])[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*)""" f"{{{_MAX_DEPTH}}}"
)


def read_toml(path: Path, name: str) -> dict[str, Any]:
    """Read a TOML file given by a user; return its tables as nested dictionaries.

    Parameters
    ----------
    path
        File to read. A byte order mark at its start is ignored.
    name
        Field name for errors, for instance "scenario".

    Raises
    ------
    InputError
        If the file is missing, empty, too large, or not valid TOML in UTF-8.
    """
    if not path.is_file():
        raise InputError(name, str(path), "must be an existing TOML file")
    if path.stat().st_size > MAX_TOML_BYTES:
        raise InputError(name, str(path), _TOO_LARGE)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        place = f"byte 0x{error.object[error.start]:02x} at position {error.start}"
        raise InputError(name, str(path), f"must be a text file in UTF-8 ({place})") from None
    tables = parsed_toml(text, name, str(path))
    if not tables:
        raise InputError(name, str(path), "must contain at least one key")
    return tables


def parsed_toml(text: str, name: str = "scenario", shown: str = "text") -> dict[str, Any]:
    """Parse TOML text from a user into nested dictionaries.

    Parameters
    ----------
    text
        Text to parse.
    name, shown
        Field and value for errors.

    Raises
    ------
    InputError
        If the text is too long, is not TOML, is nested too deep, or has an integer of more than 64
        bits.
    """
    if len(text) > MAX_TOML_BYTES:
        raise InputError(name, shown, _TOO_LARGE)
    if _DEEP_KEY.search(text):
        raise InputError(name, shown, f"must be a valid TOML file ({_TOO_DEEP})")
    try:
        tables = _load(text)
        _check_values(tables)
    except ValueError as error:
        raise InputError(name, shown, f"must be a valid TOML file ({error})") from None
    return tables


def _load(text: str) -> dict[str, Any]:
    """Parse TOML text; raise `ValueError` with a text for users if it is invalid."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(_PLACE.sub(r" \1", str(error))) from None
    except ValueError:  # Python does not convert integers of more than 4,300 digits.
        raise ValueError(_LARGE_INTEGER) from None


def _check_values(value: Any, depth: int = 0) -> None:
    """Raise `ValueError` for deeply nested tables and for integers above 64 bits.

    `depth` is the depth of `value` in the file. TOML excludes integers above 64 bits.
    """
    if depth > _MAX_DEPTH:
        raise ValueError(_TOO_DEEP)
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError(_LARGE_INTEGER)
    if isinstance(value, Mapping | list):
        for one in value.values() if isinstance(value, Mapping) else value:
            _check_values(one, depth + 1)
