"""Rich consoles that print names, paths and messages exactly as they are.

Rich reads square brackets as markup and ``:name:`` as an emoji. Both occur in file names, scenario
names and messages of errors, and every text of this project is data or plain prose.
"""

from __future__ import annotations

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)


def plain_console(
    width: int | None = None, *, stderr: bool = False, soft_wrap: bool = False
) -> Console:
    """Return a Rich console that prints text as it is, without markup and emoji codes.

    Parameters
    ----------
    width
        Number of columns; omitted: the width of the terminal.
    stderr
        Print to standard error instead of standard output.
    soft_wrap
        Do not break long lines.
    """
    return Console(width=width, stderr=stderr, soft_wrap=soft_wrap, markup=False, emoji=False)


def plain_progress(console: Console, *, transient: bool = False) -> Progress:
    """Return a Rich progress display that prints descriptions as they are.

    Parameters
    ----------
    console
        Console that shows the display.
    transient
        Whether the display is removed when it ends.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console, transient=transient)
