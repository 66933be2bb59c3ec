"""Define the command `lunarsim export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from lunarsim.cli_common import PATH, allow_options
from lunarsim.errors import InputError
from lunarsim.exports.formats import (
    DEFAULT_EPOCH,
    FORMATS,
    ExportOptions,
    check_export_output,
    export_flight,
    find_format,
)


class _ExportCommand(click.Command):
    """Command whose help has a section with the formats."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options, then the formats."""
        super().format_options(ctx, formatter)
        with formatter.section("Formats"):
            formatter.write_dl([(name, one.summary) for name, one in FORMATS.items()])


@click.command(cls=_ExportCommand)
@click.argument("flight", type=PATH)
@click.option(
    "--format", "name", required=True, metavar="NAME", help="Format: a name from the list below."
)
@click.option(
    "--out", type=PATH, default=None, show_default="name of the folder with the format's suffix",
    help="File to write; for csv, a new folder. The suffix selects the kind of world: .tif, .ply "
    "or .glb.",
)  # fmt: skip
@click.option(
    "--epoch", default=None, metavar="DATE",
    show_default=f"site.time of the scenario; without it {DEFAULT_EPOCH}",
    help="Date and time (UTC) of the start of the flight, for oem, aem and mcap.",
)  # fmt: skip
@click.option(
    "--state", default="true", show_default=True, metavar="STATE",
    help="State for oem and aem: true, or estimate (of navigation). The estimate in an OEM has its "
    "covariance.",
)  # fmt: skip
@click.option(
    "--longitude", type=float, default=None,
    show_default="that of the scenario's [site]; without it, coordinates of the site frame",
    help="Longitude of the origin of the site frame (deg, positive east). OEM and AEM then have "
    "coordinates fixed to the Moon; the scenario needs a table [moon].",
)  # fmt: skip
@allow_options
def export(
    flight: Path,
    name: str,
    out: Path | None,
    epoch: str | None,
    state: str,
    longitude: float | None,
) -> None:
    """Write a saved flight in the format of other programs.

    FLIGHT is a folder of `lunarsim fly --out`. An existing file is replaced.

    \b
    Example:
      lunarsim export out/one --format oem --epoch 2027-03-01T12:00:00
    """  # noqa: D301  (click wants the character itself)
    chosen = find_format(name)
    given: dict[str, Any] = {"epoch": epoch, "state": state, "longitude": longitude}
    options = ExportOptions(**given)
    for option, value in given.items():
        if option not in chosen.options and value != getattr(ExportOptions(), option):
            raise InputError(f"--{option}", value, f"must be omitted for the format {name}")
    target = chosen.default_output(flight.resolve().name or "flight") if out is None else out
    check_export_output(chosen, target)
    from lunarsim.simulation import Flight

    written = export_flight(Flight.load(flight), name, target, options)
    click.echo(f"{written}: {chosen.summary}")
