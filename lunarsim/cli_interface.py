"""Define the commands `lunarsim interface ...`."""

from __future__ import annotations

import sys
from importlib import resources
from pathlib import Path

import click

from lunarsim.atomic_files import atomic_write_text
from lunarsim.cli_common import PATH, ErrorReportingGroup, FloatRange
from lunarsim.errors import InputError, check_output


@click.group(cls=ErrorReportingGroup)
def interface() -> None:
    """Connect flight software in C, C++ or another language.

    \b
    Example:
      lunarsim interface header --out lunarsim.h
    """  # noqa: D301  (click wants the character itself)


_OUT = click.option(
    "--out", type=PATH, default=None, show_default="standard output", help="File to write."
)


def _write(name: str, out: Path | None) -> None:
    """Write a text file of the interface to `out`, or print it."""
    text = resources.files("lunarsim.interface").joinpath(name).read_text(encoding="utf-8")
    if out is None:
        click.echo(text, nl=False)
        return
    check_output("--out", out, Path(name).suffix)
    atomic_write_text(out, text)


@interface.command()
@_OUT
def header(out: Path | None) -> None:
    """Print the C header of the interface."""
    _write("lunarsim.h", out)


@interface.command()
@_OUT
def proto(out: Path | None) -> None:
    """Print the Protobuf schema for programs."""
    _write("lunarsim.proto", out)


@interface.command("replay")
@click.argument("record", type=PATH)
@click.argument("software", type=PATH)
@click.argument("arguments", nargs=-1)
@click.option(
    "--deadline", type=FloatRange(min=0, min_open=True), default=5.0, show_default=True,
    metavar="SECONDS", help="Maximum wall-clock time of an answer.",
)  # fmt: skip
def replay_calls(record: Path, software: Path, arguments: tuple[str, ...], deadline: float) -> None:
    """Repeat recorded calls with SOFTWARE and compare its answers.

    RECORD is a file of `lunarsim fly --record-messages`. SOFTWARE is a shared library (.so), an
    FMU (.fmu), or a program with its ARGUMENTS. It gets the recorded briefing and inputs; there is
    no simulation. The exit code is 1 if an answer differs in any byte.

    \b
    Example:
      lunarsim interface replay out/messages/guidance.messages build/e_guidance.so
    """  # noqa: D301  (click wants the character itself)
    from lunarsim.onboard.external.failure import SoftwareFailure
    from lunarsim.onboard.external.process import ProcessConnection, program_arguments
    from lunarsim.onboard.external.recording import read_record, replay
    from lunarsim.onboard.external.settings import hosted

    calls = read_record(record)
    if not software.is_file():
        raise InputError("SOFTWARE", str(software), "must be an existing file")
    command = (
        hosted(software.resolve(), calls.role)
        if software.suffix in (".so", ".fmu")
        else program_arguments(software.resolve(), arguments)
    )
    try:
        connection = ProcessConnection(command, calls.role, calls.briefing, deadline=deadline)
    except InputError as error:
        raise InputError("SOFTWARE", str(software), error.problem, error.remedy) from None
    try:
        found = replay(calls, connection)
    except SoftwareFailure as failure:
        raise click.ClickException(str(failure)) from None
    finally:
        connection.close()
    if found.first_difference is None:
        click.echo(f"{found.calls} calls of the role {calls.role}: all answers are identical")
        return
    click.echo(f"call {found.first_difference}: the answer differs in {found.fields}")
    sys.exit(1)
