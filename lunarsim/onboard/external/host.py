"""Run a shared library or an FMU in a process: ``host.py FILE ROLE``."""

from __future__ import annotations

import sys
from pathlib import Path

from lunarsim.interface.server import Software, serve
from lunarsim.interface.structs import Struct
from lunarsim.onboard.external.settings import load_software


def main(path: str, role: str) -> None:
    """Serve one role of a library or an FMU."""

    def make(briefing: Struct) -> Software:
        return load_software(Path(path), role, briefing)

    serve(**{role: make})


if __name__ == "__main__":
    main(*sys.argv[1:3])
