"""Define the commands `lunarsim site ...`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

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
from lunarsim.models.site import LandingSite, parse_time, time_text

if TYPE_CHECKING:
    from rich.table import Table

    from lunarsim.scenario import Scenario
    from lunarsim.world.horizon import Horizon
    from lunarsim.world.illumination import Illumination, Window
    from lunarsim.world.terrain import Heightfield

# Mean length of the synodic month, days.
_SYNODIC_MONTH_DAYS = 29.53
# Maximum number of intervals of one type that are printed.
_MAX_INTERVALS_PRINTED = 8


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
    loaded = None if scenario is None else load_scenario(scenario, changes, is_flown=False)
    place = _place(loaded, at, time, changes)
    if dtm is not None:
        field = _load(dtm, place, 1e3 * max_range, posting, pixel, nodata)
        horizon = _raster_horizon(field, 1e3 * max_range, height)
    else:
        for option, value in (("--posting", posting), ("--pixel", pixel), ("--nodata", nodata)):
            if value not in (None, ()):
                raise InputError(option, value, "must be omitted without --dtm")
        horizon = _horizon(loaded, 1e3 * max_range, height, (seed, flight))
    found = _illumination(place, horizon, days, step)
    windows = None
    if sun_elevation is not None:
        windows = found.landing_windows(*np.deg2rad(sun_elevation))
    console = wide_console(130)
    console.print(_table(place, found, horizon))
    for line in _interval_lines(found, windows):
        console.print(line, soft_wrap=True)
    if csv is not None:
        _write_csv(found, csv)
    if file is not None:
        _write_json(place, found, windows, file)
    if out is not None:
        from lunarsim.viz.site import draw_site

        title = f"{_place_text(place)}, horizon from {height:g} m above the terrain"
        draw_site(found, windows or [], title, out)
    for path in (out, csv, file):
        if path is not None:
            console.print(f"wrote {path}", soft_wrap=True)


def _place(
    loaded: Scenario | None, at: tuple[float, float] | None, time: str | None,
    changes: tuple[str, ...],
) -> LandingSite:  # fmt: skip
    """Return the site of the scenario, or that of --at and --time."""
    if loaded is not None:
        for option, value in (("--at", at), ("--time", time)):
            if value is not None:
                raise InputError(
                    option, value, "must be omitted with a scenario",
                    "Use --set with site.latitude_deg, site.longitude_deg or site.time.",
                )  # fmt: skip
        if loaded.site is None or loaded.site.time is None:
            raise InputError(
                "site.time", None, "is required by this command", "Add a table [site] with a time.",
                show_value=False,
            )  # fmt: skip
        return loaded.site.make()  # type: ignore[no-any-return]
    if changes:
        raise InputError("--set", changes[0], "needs a scenario")
    if at is None or time is None:
        raise InputError("SCENARIO", None, "is required, or --at and --time", show_value=False)
    parse_time("--time", time)
    try:
        latitude, longitude = np.deg2rad(at)
        return LandingSite(float(latitude), float(longitude), time)
    except InputError as error:
        raise error.with_field("--at") from None


def _raster_horizon(field: Heightfield, max_range: float, height: float) -> Horizon:
    """Return the horizon at the origin of a heightfield."""
    from lunarsim.world.ephemeris import MOON_RADIUS_M
    from lunarsim.world.horizon import terrain_horizon

    try:
        return terrain_horizon(
            field, height=height, radius=MOON_RADIUS_M, posting=field.grid.posting,
            max_range=max_range,
        )  # fmt: skip
    except InputError as error:
        raise error.with_field("--dtm") from None


def _horizon(
    loaded: Scenario | None, max_range: float, height: float, seeds: tuple[int, int]
) -> Horizon:
    """Return the horizon at the target of a scenario, or of a smooth sphere.

    `seeds` are those of the terrain of the scenario: seed and flight.
    """
    from lunarsim.world.ephemeris import MOON_RADIUS_M
    from lunarsim.world.horizon import height_function, smooth_horizon, terrain_horizon

    if loaded is None:
        return smooth_horizon(height, MOON_RADIUS_M)
    from lunarsim.rng import RandomStreams, flight_seed
    from lunarsim.simulation.worlds import build_world

    world = build_world(loaded, RandomStreams(flight_seed(*seeds)))
    relief, far = world.terrain.relief, world.far_terrain
    return terrain_horizon(
        height_function(relief) if far is None else far.elevation,
        loaded.target.position_m, height=height,
        radius=MOON_RADIUS_M if world.moon is None else world.moon.radius,
        posting=relief.grid.posting, max_range=max_range,
    )  # fmt: skip


def _load(
    path: Path, place: LandingSite, max_range: float, posting: float | None,
    pixel: tuple[float, float] | None, nodata: tuple[float, ...],
) -> Heightfield:  # fmt: skip
    """Load the raster of --dtm around a site; errors name the options."""
    from lunarsim.world.terrain.dtm import load_surroundings

    latitude, longitude = (float(v) for v in np.rad2deg([place.latitude, place.longitude]))
    try:
        return load_surroundings(
            path, latitude, longitude, max_range=max_range, posting=posting, pixel=pixel,
            nodata=nodata or None,
        )  # fmt: skip
    except InputError as error:
        names = {"terrain.path": "--dtm", "terrain.dtm_posting_m": "--posting", "pixel": "--pixel"}
        remedy = error.remedy.replace("terrain.dtm_posting_m", "--posting")
        if "terrain.dtm_nodata" in remedy:
            remedy = "Give it with --nodata, or another value if these heights are real."
        field = names.get(error.field, error.field)
        raise InputError(field, error.value, error.problem, remedy, error.show_value) from None


def _illumination(place: LandingSite, horizon: Horizon, days: float, step: float) -> Illumination:
    """Return the illumination of a site from its date on."""
    from lunarsim.world.illumination import Illumination

    assert place.date is not None
    try:
        return Illumination.over(place.latitude, place.longitude, horizon, place.date, days, step)
    except InputError as error:
        raise error.with_field("--days") from None


def _place_text(place: LandingSite) -> str:
    """Return latitude and longitude of a site as text."""
    latitude, longitude = np.rad2deg([place.latitude, place.longitude])
    return f"latitude {latitude:.4f} deg, longitude {longitude:.4f} deg east"


def _table(place: LandingSite, found: Illumination, horizon: Horizon) -> Table:
    """Return the table of the command, with one quantity per row."""
    from rich.table import Table

    table = Table(show_header=False, box=None)
    for name, value in _rows(place, found, horizon):
        table.add_row(name, value)
    return table


def _rows(place: LandingSite, found: Illumination, horizon: Horizon) -> Iterator[tuple[str, str]]:
    """Yield name and value of each row of the table of the command."""
    sky = found.sky
    sun, earth = (
        np.rad2deg([az[0], el[0], edge[0]])
        for az, el, edge in (
            (sky.sun_azimuth, sky.sun_elevation, found.sun_horizon),
            (sky.earth_azimuth, sky.earth_elevation, found.earth_horizon),
        )
    )
    yield "site", f"{_place_text(place)} (MOON_ME)"
    low, high = np.rad2deg([horizon.elevation.min(), horizon.elevation.max()])
    near, far = 1e-3 * horizon.reach.min(), 1e-3 * horizon.reach.max()
    terrain = f"terrain known to {near:.1f} to {far:.1f} km" if far > 0 else "smooth sphere"
    yield "horizon", f"{low:.2f} to {high:.2f} deg, {terrain}"
    yield "time", time_text(sky.time[0])
    yield (
        "Sun",
        (
            f"azimuth {sun[0]:.2f} deg, elevation {sun[1]:.2f} deg, horizon there "
            f"{sun[2]:.2f} deg, diameter {np.rad2deg(sky.sun_diameter[0]):.3f} deg"
        ),
    )
    yield (
        "Earth",
        (
            f"azimuth {earth[0]:.2f} deg, elevation {earth[1]:.2f} deg, horizon there "
            f"{earth[2]:.2f} deg, diameter {np.rad2deg(sky.earth_diameter[0]):.3f} deg"
        ),
    )
    yield (
        "earthshine",
        (f"{sky.earthshine[0]:.3g} of sunlight, {100 * sky.earth_phase[0]:.1f} % of the Earth lit"),
    )
    yield "period", f"{time_text(sky.time[0])} to {time_text(sky.time[-1])}"
    low, high = np.rad2deg([sky.sun_elevation.min(), sky.sun_elevation.max()])
    yield "Sun elevation", f"{low:.2f} to {high:.2f} deg"
    low, high = np.rad2deg([sky.earth_elevation.min(), sky.earth_elevation.max()])
    yield "Earth elevation", f"{low:.2f} to {high:.2f} deg"
    for name, hours in (
        ("sunlight", found.illuminated_hours),
        ("Earth in view", found.earth_hours),
    ):
        yield name, f"{hours:.1f} h of {found.hours:.1f} h ({100 * hours / found.hours:.1f} %)"


def _interval_lines(found: Illumination, windows: list[Window] | None) -> Iterator[str]:
    """Yield lines with the intervals of sunlight, Earth in view, and landing."""
    named = [("sunrise to sunset", found.sunlit()), ("Earth in view", found.earth_in_view())]
    if windows is not None:
        named.append(("landing window", windows))
    for name, intervals in named:
        if not intervals:
            yield f"{name}: none"
        for one in intervals[:_MAX_INTERVALS_PRINTED]:
            start = "before " * one.starts_before + time_text(one.start)
            end = "after " * one.ends_after + time_text(one.end)
            lit = f", Sun {100 * one.sun_visible:.0f} % visible" if intervals is windows else ""
            yield f"{name}: {start} to {end}, {one.hours:.1f} h{lit}"
        if len(intervals) > _MAX_INTERVALS_PRINTED:
            yield f"{name}: {len(intervals) - _MAX_INTERVALS_PRINTED} more; --json lists all"


def _write_csv(found: Illumination, path: Path) -> None:
    """Write all samples to a CSV file."""
    from lunarsim.atomic_files import atomic_write_text

    sky = found.sky
    angles = {
        "sun_azimuth_deg": sky.sun_azimuth, "sun_elevation_deg": sky.sun_elevation,
        "sun_horizon_deg": found.sun_horizon, "earth_azimuth_deg": sky.earth_azimuth,
        "earth_elevation_deg": sky.earth_elevation, "earth_horizon_deg": found.earth_horizon,
    }  # fmt: skip
    shares = {
        "sun_visible": found.sun_visible, "earth_phase": sky.earth_phase,
        "earthshine": sky.earthshine,
    }  # fmt: skip
    lines = [",".join(["time_utc", *angles, *shares])]
    for k, time in enumerate(sky.time):
        cells = [f"{np.rad2deg(values[k]):.4f}" for values in angles.values()]
        cells += [f"{values[k]:.6g}" for values in shares.values()]
        lines.append(",".join([time_text(time), *cells]))
    atomic_write_text(path, "\n".join(lines) + "\n")


def _write_json(
    place: LandingSite, found: Illumination, windows: list[Window] | None, path: Path
) -> None:
    """Write the results to a JSON file."""
    from lunarsim.atomic_files import atomic_write_text

    def listed(intervals: list[Window]) -> list[dict[str, Any]]:
        return [
            {
                "start": time_text(one.start), "end": time_text(one.end), "hours": one.hours,
                "starts_before": one.starts_before, "ends_after": one.ends_after,
                "sun_visible": one.sun_visible,
            }
            for one in intervals
        ]  # fmt: skip

    sky = found.sky
    first = {
        name: float(np.rad2deg(getattr(sky, name.removesuffix("_deg"))[0]))
        for name in (
            "sun_azimuth_deg", "sun_elevation_deg", "sun_diameter_deg", "earth_azimuth_deg",
            "earth_elevation_deg", "earth_diameter_deg",
        )
    }  # fmt: skip
    results = {
        "latitude_deg": float(np.rad2deg(place.latitude)),
        "longitude_deg": float(np.rad2deg(place.longitude)),
        "time": time_text(sky.time[0]), **first,
        "earth_phase": float(sky.earth_phase[0]), "earthshine": float(sky.earthshine[0]),
        "period_hours": found.hours, "illuminated_hours": found.illuminated_hours,
        "earth_hours": found.earth_hours, "sunlit": listed(found.sunlit()),
        "earth_in_view": listed(found.earth_in_view()),
        "landing_windows": None if windows is None else listed(windows),
    }  # fmt: skip
    atomic_write_text(path, json.dumps(results, indent=1, allow_nan=False) + "\n")
