"""Read untrusted JSON files; every defect raises `ValueError`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

# Maximum size of a file, bytes. The manifest of 1,000 arms and 10,000 parts has 3 MB.
MAX_JSON_BYTES = 2**23


def read_json(path: Path) -> Any:
    """Return the contents of an untrusted JSON file.

    Raises
    ------
    ValueError
        If the file cannot be read, is not JSON in UTF-8, is nested too deep or is too large.
    """
    try:
        is_too_large = path.stat().st_size > MAX_JSON_BYTES
        found = None if is_too_large else json.loads(path.read_text(encoding="utf-8"))
        json.dumps(found, ensure_ascii=False).encode()  # fails for unpaired surrogates
    except RecursionError:
        raise ValueError("its values are nested too deep") from None
    except OSError as error:
        raise ValueError(error.strerror or "the file cannot be read") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"invalid JSON at line {error.lineno}, column {error.colno}") from None
    except UnicodeError:
        raise ValueError("it is not text in UTF-8") from None
    except ValueError:
        raise ValueError("an integer has too many digits") from None
    if is_too_large:
        raise ValueError(f"the file is larger than {MAX_JSON_BYTES // 2**20} MiB")
    return found
