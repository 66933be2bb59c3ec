"""Define the commands `lunarsim site ...`."""

from __future__ import annotations

from pathlib import Path

import click

from lunarsim.cli_common import (
    FLIGHT,
    PATH,
    SEED,
    ErrorReportingGroup,
    FloatRange,
    allow_options,
    load_scenario,
    wide_console,
)
from lunarsim.errors import InputError, check_output

# Mean length of the synodic month, days.
_SYNODIC_MONTH_DAYS = 29.53


@click.group(cls=ErrorReportingGroup)
def site() -> None:
    """Show the Sun and the Earth at a landing site."""


@site.command()
@click.argument("scenario", type=PATH, required=False)
@click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE",
    help="Set a scenario key, for example site.time=2027-03-01T12:00Z. Repeatable.",
)  # fmt: skip
@allow_options
@click.option(
    "--at", type=float, nargs=2, default=None, metavar="LAT LON",
    help="Latitude and longitude of a site without a scenario (deg, positive north and east).",
)  # fmt: skip
@click.option(
    "--time", default=None, metavar="DATE",
    help="Date and time (UTC) for --at, for example 2027-03-01T12:00Z.",
)  # fmt: skip
@click.option(
    "--dtm", type=PATH, default=None,
    show_default="terrain of the scenario; with --at, a smooth sphere",
    help="Elevation raster around the site, for the horizon.",
)  # fmt: skip
@click.option(
    "--posting", type=FloatRange(min=0, min_open=True), default=None,
    show_default="that of the raster",
    help="Grid spacing of --dtm (m); required without georeferencing.",
)  # fmt: skip
@click.option(
    "--pixel", type=float, nargs=2, default=None, metavar="ROW COLUMN",
    show_default="its centre",
    help="Place of the site in a --dtm without georeferencing, counted from 0 at its first corner.",
)  # fmt: skip
@click.option(
    "--nodata", type=float, multiple=True,
    help="Value that marks missing heights, in addition to those stated in the file. Repeatable.",
)  # fmt: skip
@click.option(
    "--range", "max_range", type=FloatRange(min=0.1, max=300), default=60.0, show_default=True,
    help="Maximum distance of terrain that forms the horizon (km).",
)  # fmt: skip
@click.option(
    "--height", type=FloatRange(min=0, max=1000), default=2.0, show_default=True,
    help="Height above the terrain from which the horizon is seen (m).",
)  # fmt: skip
@click.option(
    "--days", type=FloatRange(min=0, min_open=True, max=4000), default=_SYNODIC_MONTH_DAYS,
    show_default=True, help="Length of the period that starts at the date (days).",
)  # fmt: skip
@click.option(
    "--step", type=FloatRange(min=0, min_open=True, max=24), default=1.0, show_default=True,
    help="Time between two samples of the period (h).",
)  # fmt: skip
@click.option(
    "--sun-elevation", type=float, nargs=2, default=None, metavar="MIN MAX",
    help="Elevations of the Sun for a landing (deg): lists windows with the Earth in view.",
)  # fmt: skip
@SEED
@FLIGHT
@click.option("--out", type=PATH, default=None, help="PNG file of the figure. Default: none.")
@click.option("--csv", type=PATH, default=None, help="CSV file of all samples. Default: none.")
@click.option("--json", "file", type=PATH, default=None, help="JSON file of the results.")
def info(
    scenario: Path | None, changes: tuple[str, ...], at: tuple[float, float] | None,
    time: str | None, dtm: Path | None, posting: float | None,
    pixel: tuple[float, float] | None, nodata: tuple[float, ...], max_range: float, height: float,
    days: float, step: float, sun_elevation: tuple[float, float] | None, seed: int, flight: int,
    out: Path | None, csv: Path | None, file: Path | None,
) -> None:  # fmt: skip
    """Show Sun, Earth, sunlit hours and landing windows of a site.

    The site is that of the table [site] of SCENARIO, or that of --at and --time. Directions at the
    date are followed by a period: sunrise, sunset, illuminated hours and hours with the Earth above
    the terrain horizon.

    \b
    Examples:
      lunarsim site info --at -89.45 222.7 --time 2027-03-01T12:00Z --dtm ridge.tif --out sun.png
      lunarsim site info --at 26.13 3.63 --time 1971-07-30T22:16Z --sun-elevation 5 14
    """  # noqa: D301  (click wants the character itself)
    for option, path, suffix in (("--out", out, ".png"), ("--csv", csv, ".csv"),
                                 ("--json", file, ".json")):  # fmt: skip
        if path is not None:
            check_output(option, path, suffix)
    if sun_elevation is not None and not -90 <= sun_elevation[0] < sun_elevation[1] <= 90:
        raise InputError(
            "--sun-elevation", list(sun_elevation), "must be two increasing angles from -90 to 90"
        )
    _check_source(scenario, changes, at, time)
    if dtm is None:
        for option, value in (("--posting", posting), ("--pixel", pixel), ("--nodata", nodata)):
            if value not in (None, ()):
                raise InputError(option, value, "must be omitted without --dtm")
    from rich.table import Table

    from lunarsim.evaluation import site_report

    if scenario is not None:
        loaded = load_scenario(scenario, changes, is_flown=False)
        place = site_report.scenario_place(loaded)
    else:
        assert at is not None and time is not None
        loaded, place = None, site_report.given_place(at, time)
    if dtm is not None:
        raster = site_report.RasterOptions(dtm, posting, pixel, nodata)
        horizon = site_report.raster_horizon(raster, place, height, 1e3 * max_range)
    else:
        horizon = site_report.scenario_horizon(loaded, height, 1e3 * max_range, (seed, flight))
    report = site_report.SiteReport.of(place, horizon, days, step, sun_elevation)
    if csv is not None:
        report.write_csv(csv)
    if file is not None:
        report.write_json(file)
    if out is not None:
        from lunarsim.viz.site import draw_site

        title = f"{report.place_text}, horizon from {height:g} m above the terrain"
        draw_site(report.light, report.windows or [], title, out)
    console, table = wide_console(130), Table(show_header=False, box=None)
    for row in report.rows():
        table.add_row(*row)
    console.print(table)
    written = [f"wrote {path}" for path in (out, csv, file) if path is not None]
    for line in (*report.interval_lines(), *written):
        console.print(line, soft_wrap=True)


def _check_source(
    scenario: Path | None, changes: tuple[str, ...], at: tuple[float, float] | None,
    time: str | None,
) -> None:  # fmt: skip
    """Check that the site is given by a scenario or by --at and --time, not by both."""
    if scenario is not None:
        for option, value in (("--at", at), ("--time", time)):
            if value is not None:
                raise InputError(
                    option, value, "must be omitted with a scenario",
                    "Use --set with site.latitude_deg, site.longitude_deg or site.time.",
                )  # fmt: skip
    elif changes:
        raise InputError("--set", changes[0], "needs a scenario")
    elif at is None or time is None:
        raise InputError("SCENARIO", None, "is required, or --at and --time", show_value=False)
