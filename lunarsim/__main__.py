"""Entry point of the `lunarsim` command and of `python -m lunarsim`."""

from __future__ import annotations

import sys
from pathlib import Path

# `python -m` searches the working folder first, which may contain an unrelated numpy.py. The
# folder stays on the search path only if it contains this package.
if (
    __name__ == "__main__"
    and not sys.flags.safe_path
    and Path(sys.path[0]).resolve() != Path(__file__).resolve().parents[1]
):
    del sys.path[0]


def main() -> None:
    """Run the `lunarsim` command; handle Ctrl-C also while the command is imported."""
    from lunarsim.cli_start import run  # noqa: PLC0415  (after the search path is corrected)

    def command() -> None:
        from lunarsim.cli import main as lunarsim  # noqa: PLC0415  (this import may be interrupted)

        lunarsim()

    run(command)


if __name__ == "__main__":
    main()
