"""Prints the page of all commands: `python scripts/command_pages.py > docs/commands.md`."""

from __future__ import annotations

from collections.abc import Iterator

import click
from click.testing import CliRunner

from lunarsim.cli import main

HEAD = """# Commands

Made by `python scripts/command_pages.py > docs/commands.md` from what each command says of itself.
A user's mistake ends with exit code 2 and one line that names field, value and remedy; an interrupt
with 130.
"""


def commands(group: click.Group, before: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words of every command, groups before what they hold."""
    for name, command in sorted(group.commands.items()):
        yield *before, name
        if isinstance(command, click.Group):
            yield from commands(command, (*before, name))


def page() -> str:
    """Return the page as Markdown."""
    runner, out = CliRunner(), [HEAD]
    for words in commands(main):
        options = {"prog_name": "lunarsim", "terminal_width": 88}
        said = runner.invoke(main, [*words, "--help"], **options).output
        out.append(f"## lunarsim {' '.join(words)}\n\n```text\n{said.rstrip()}\n```\n")
    return "\n".join(out)


if __name__ == "__main__":
    print(page(), end="")
