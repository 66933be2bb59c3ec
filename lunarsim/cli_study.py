"""Define the commands `lunarsim study`: list, run and report the studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from lunarsim.cli_common import PATH


class _Studies(click.Group):
    """Group with one command for each study, which is loaded when called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all studies."""
        from lunarsim.studies.library import study_files

        return list(study_files())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of a study."""
        from lunarsim.studies.command import study_command
        from lunarsim.studies.library import load_study

        return study_command(load_study(cmd_name))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write no list of studies into the help: `lunarsim study list` prints it."""


@click.group()
def study() -> None:
    """List, run and report studies of guidance, sensors and maps."""


@study.command("list")
def list_studies() -> None:
    """Print names and subjects of all studies."""
    from rich.table import Table

    from lunarsim.console import plain_console
    from lunarsim.studies.library import study_files, summary

    table = Table(show_header=False, box=None)
    for name, path in study_files().items():
        table.add_row(name, summary(path))
    plain_console().print(table)


@study.group(cls=_Studies, subcommand_metavar="NAME [OPTIONS]")
def run(**_: Any) -> None:
    """Run the study NAME and print its report.

    `lunarsim study run NAME --help` prints its options.
    """


@study.command()
@click.argument("name")
@click.argument("folder", type=PATH)
def report(name: str, folder: Path) -> None:
    """Print and plot the results of the study NAME in FOLDER again."""
    from lunarsim.studies.command import report_folder
    from lunarsim.studies.library import load_study

    report_folder(load_study(name), folder)
