"""Import optional packages in scripts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lunarsim.errors import missing_package


@contextmanager
def imports_of_extra(extra: str) -> Iterator[None]:
    """End a script with exit code 2 if an import of an optional package fails.

    The message has one line.

    Parameters
    ----------
    extra
        Extra of lunarsim that contains the packages.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        script = Path(sys.argv[0]).name
        print(missing_package(script, str(error.name), extra), file=sys.stderr)
        raise SystemExit(2) from None
