"""Run flight software in a shared library in a process: ``library_host.py LIBRARY ROLE``."""

from __future__ import annotations

import sys
from pathlib import Path

from lunarsim.interface.server import Software, serve
from lunarsim.interface.structs import Struct
from lunarsim.onboard.external.library import LibraryConnection


def main(path: str, role: str) -> None:
    """Serve one role of a library."""

    def make(briefing: Struct) -> Software:
        return LibraryConnection(Path(path), role, briefing)

    serve(**{role: make})


if __name__ == "__main__":
    main(*sys.argv[1:3])
