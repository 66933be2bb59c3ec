"""Where the `lunarsim` command begins; also `python -m lunarsim`."""

from __future__ import annotations

from lunarsim.cli_start import run


def main() -> None:
    """Run the `lunarsim` command; an interrupt while it is loaded ends it as one does later."""

    def command() -> None:
        from lunarsim.cli import main as lunarsim  # noqa: PLC0415  (what may be interrupted)

        lunarsim()

    run(command)


if __name__ == "__main__":
    main()
