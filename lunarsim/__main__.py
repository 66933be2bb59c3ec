"""Where the `lunarsim` command begins; also `python -m lunarsim`."""

from __future__ import annotations

import sys
from pathlib import Path

# `python -m` looks for modules in the working folder first, which may hold a numpy.py from
# somebody else. It stays only if the package itself is there.
if (
    __name__ == "__main__"
    and not sys.flags.safe_path
    and Path(sys.path[0]).resolve() != Path(__file__).resolve().parents[1]
):
    del sys.path[0]


def main() -> None:
    """Run the `lunarsim` command; an interrupt while it is loaded ends it as one does later."""
    from lunarsim.cli_start import run  # noqa: PLC0415  (after the search path is mended)

    def command() -> None:
        from lunarsim.cli import main as lunarsim  # noqa: PLC0415  (what may be interrupted)

        lunarsim()

    run(command)


if __name__ == "__main__":
    main()
