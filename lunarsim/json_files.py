"""JSON files from elsewhere: one kind of error for everything that is wrong with them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

# Bytes of a file. The manifest of a thousand arms and ten thousand parts has 3 MB.
MAX_JSON_BYTES = 2**23


def read_json(path: Path) -> Any:
    """Return what a JSON file holds.

    Raises
    ------
    ValueError
        If it cannot be read, is no JSON in UTF-8, is too deep or too large.
    """
    try:
        if path.stat().st_size > MAX_JSON_BYTES:
            raise ValueError(f"more than {MAX_JSON_BYTES} bytes")
        found = json.loads(path.read_text(encoding="utf-8"))
        json.dumps(found, ensure_ascii=False).encode()  # half a surrogate pair cannot be written
    except RecursionError:
        raise ValueError("nested too deep") from None
    except OSError as error:
        raise ValueError(error.strerror or "it cannot be read") from None
    return found
