"""Define the commands `lunarsim terrain ...`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lunarsim.cli_common import (
    FLIGHT,
    PATH,
    SEED,
    ErrorReportingGroup,
    load_scenario,
    scenario_options,
)
from lunarsim.errors import check_output

if TYPE_CHECKING:
    from lunarsim.world.terrain.dtm import DtmInfo


@click.group(cls=ErrorReportingGroup)
def terrain() -> None:
    """Describe, import, plot and export terrain."""


@terrain.command()
@click.argument("file", type=PATH)
@click.option(
    "--window", type=int, nargs=4, metavar="TOP BOTTOM LEFT RIGHT",
    help="Part of the raster to describe: first row, end row, first column, end column. The "
    "end row and the end column are not included. Default: all.",
)  # fmt: skip
@click.option(
    "--unit", help="Unit of the heights: m, km, ft or us-ft. Default: unit stated in the file."
)
@click.option(
    "--nodata",
    type=float,
    multiple=True,
    help="Value that marks missing heights, in addition to those stated in the file. Repeatable.",
)
def info(
    file: Path, window: tuple[int, int, int, int] | None, unit: str | None,
    nodata: tuple[float, ...],
) -> None:  # fmt: skip
    """Describe the elevation raster FILE (GeoTIFF, PDS, ...)."""
    from rich.table import Table

    from lunarsim.console import plain_console
    from lunarsim.world.terrain.dtm import read_info

    found = read_info(file, window=window, unit=unit, nodata=nodata or None)
    table = Table(show_header=False, box=None)
    for name, value in _description(found):
        table.add_row(name, value)
    plain_console().print(table)


def _description(dtm_info: DtmInfo) -> Iterator[tuple[str, str]]:
    """Yield name and value of each row of the table that `terrain info` prints."""
    yield "file", str(dtm_info.path)
    yield "format", dtm_info.driver
    yield "posts", f"{dtm_info.rows} x {dtm_info.cols} (rows x columns)"
    if dtm_info.posting is None or dtm_info.spacing is None:
        yield "posting", "not given: set terrain.dtm_posting_m"
    elif dtm_info.resampled:
        along, across = dtm_info.spacing
        yield "posting", f"{along:.4g} m along rows, {across:.4g} m along columns"
        yield "loaded", f"resampled to {dtm_info.posting:.4g} m, north up"
    else:
        yield "posting", f"{dtm_info.posting:.4g} m"
        yield "loaded", "post by post, without interpolation"
    if dtm_info.extent is not None:
        width, height = dtm_info.extent
        yield "extent", f"{width:.6g} m along east, {height:.6g} m along north"
    yield "frame", dtm_info.frame
    yield "orientation", dtm_info.orientation
    if dtm_info.extent is not None:
        direction = f"{dtm_info.column_direction_deg + 0.0:.2f} deg anticlockwise from east"
        yield "direction of rows", f"{direction} (at the centre)"
    if dtm_info.map_scale is not None:
        along, across = dtm_info.map_scale
        scale = f"1 m of terrain is {along:.4f} m of map along rows, {across:.4f} m along columns"
        yield "map scale", scale
    heights = dtm_info.height_scale
    length = "" if heights.metres == 1.0 else f" ({heights.metres:.10g} m)"
    yield "height unit", heights.unit + length
    yield "scale, offset", f"stored value x {heights.scale:g} + {heights.offset:.10g}"
    if dtm_info.statistics is None:
        yield "elevation", f"not read: {dtm_info.rows * dtm_info.cols} posts; use --window"
    else:
        low, high = dtm_info.z_range
        yield "elevation", f"{low:.2f} to {high:.2f} m"
        zero = "the mean after resampling" if dtm_info.resampled else "it"
        mean = f"{dtm_info.statistics.mean:.2f} m; loading subtracts {zero} from all heights"
        yield "mean elevation", mean
        yield "no data", f"{100.0 * dtm_info.no_data_share:.2f} %"


class _Length(click.ParamType[float]):
    """Length with a unit, such as 4km or 800m; m without a unit."""

    name = "length"

    def convert(self, value: Any, param: Any, ctx: click.Context | None) -> float:
        """Return the length, m."""
        found = re.fullmatch(r"\s*([\d.eE+-]+)\s*(m|km|)\s*", str(value))
        try:
            length = float(found[1]) * (1000.0 if found[2] == "km" else 1.0) if found else 0.0
        except ValueError:
            length = 0.0
        if not (math.isfinite(length) and length > 0.0):
            self.fail(f"must be a positive length such as 4km or 800m, got {value!r}.", param, ctx)
        return length


@terrain.command("import")
@click.argument("file", type=PATH)
@click.option(
    "--at", type=float, nargs=2, metavar="LAT LON", default=None,
    show_default="centre of the raster",
    help="Centre: planetocentric latitude and longitude (deg).",
)  # fmt: skip
@click.option("--size", type=_Length(), required=True, help="Side of the square, such as 4km.")
@click.option(
    "--posting", type=_Length(), default=None, show_default="that of the raster",
    help="Spacing of the heights. Required for a raster without georeferencing.",
)  # fmt: skip
@click.option(
    "--fill-voids", type=click.IntRange(min=0), default=100, show_default=True,
    help="Largest number of connected missing heights that are filled.",
)  # fmt: skip
@click.option("--unit", help="Unit of the heights: m, km, ft or us-ft.")
@click.option(
    "--nodata", type=float, multiple=True, help="Value that marks missing heights. Repeatable."
)
@click.option(
    "--out", type=PATH, required=True,
    help="Scenario file (.toml) to write, with a GeoTIFF of the same name beside it.",
)  # fmt: skip
def import_file(
    file: Path, at: tuple[float, float] | None, size: float, posting: float | None,
    fill_voids: int, unit: str | None, nodata: tuple[float, ...], out: Path,
) -> None:  # fmt: skip
    """Cut a landing area out of a terrain product FILE.

    Reads only the part around the area, reprojects it, fills small voids, and writes a scenario
    that flies over it.

    \b
    Example:
      lunarsim terrain import ldem.tif --at -89.45 222.7 --size 4km --out ridge.toml
    """  # noqa: D301  (click wants the character itself)
    from rich.table import Table

    from lunarsim.console import plain_console
    from lunarsim.world.terrain.imported_scenario import area_description, write_scenario
    from lunarsim.world.terrain.terrain_import import import_area

    check_output("--out", out, ".toml")
    area = import_area(
        file, at, size, posting=posting, max_void=fill_voids, unit=unit, nodata=nodata or None
    )
    raster = write_scenario(area, file, out)
    table = Table(show_header=False, box=None)
    for name, value in area_description(area):
        table.add_row(name, value)
    table.add_row("written", f"{out}, {raster}")
    table.add_row("next", f"lunarsim terrain preview {out} --out {out.with_suffix('.png')}")
    plain_console().print(table)


@terrain.command()
@scenario_options
@SEED
@FLIGHT
@click.option("--out", type=PATH, required=True, help="PNG file to write.")
def preview(scenario: Path, changes: tuple[str, ...], seed: int, flight: int, out: Path) -> None:
    """Plot hillshade, slopes and rocks of SCENARIO's terrain."""
    from lunarsim.rng import RandomStreams, flight_seed
    from lunarsim.simulation.worlds import build_world
    from lunarsim.viz.terrain import draw_terrain

    check_output("--out", out, ".png")
    loaded = load_scenario(scenario, changes, is_flown=False)
    world = build_world(loaded, RandomStreams(flight_seed(seed, flight)))
    draw_terrain(world.terrain, loaded.name, out)
    click.echo(f"{out}: {len(world.terrain.rocks)} rocks on {loaded.name}")


@terrain.command()
@scenario_options
@SEED
@FLIGHT
@click.option(
    "--posting", type=float, default=0.2, show_default=True, help="Cell size of the maps (m)."
)
@click.option(
    "--size", type=float, default=60.0, show_default=True,
    help="Side of the square around the target that the maps cover (m).",
)  # fmt: skip
@click.option("--out", type=PATH, required=True, help="NetCDF file (.nc) to write.")
def truth(
    scenario: Path, changes: tuple[str, ...], seed: int, flight: int, posting: float, size: float,
    out: Path,
) -> None:  # fmt: skip
    """Write true maps of SCENARIO's terrain to a NetCDF file.

    The maps are elevation, slope, rocks, true safety and shadow.
    """
    from lunarsim.rng import RandomStreams, flight_seed
    from lunarsim.simulation.worlds import build_world
    from lunarsim.world.truth_products import TruthProducts, truth_grid

    check_output("--out", out, ".nc")
    loaded = load_scenario(scenario, changes, is_flown=False)
    world = build_world(loaded, RandomStreams(flight_seed(seed, flight)))
    grid = truth_grid(world, loaded.target.position_m, size, posting)
    maps = TruthProducts.of(world, loaded.vehicle.make(), grid)
    maps.save(out)
    click.echo(
        f"{out}: {grid.rows} x {grid.cols} cells, {100 * maps.safe.mean():.1f} % truly safe, "
        f"{100 * (maps.rock >= 0).mean():.1f} % rock, {100 * maps.shadow.mean():.1f} % in shadow"
    )


@terrain.command()
@scenario_options
@SEED
@FLIGHT
@click.option(
    "--posting", type=float, default=None, show_default="grid spacing of the terrain",
    help="Spacing of the grid points (m).",
)  # fmt: skip
@click.option(
    "--rocks/--no-rocks", default=True, show_default=True, help="Whether the file has the rocks."
)
@click.option(
    "--out", type=PATH, required=True,
    help="File to write: GeoTIFF (.tif) of the elevation, or mesh (.ply or .glb).",
)  # fmt: skip
def export(
    scenario: Path, changes: tuple[str, ...], seed: int, flight: int, posting: float | None,
    rocks: bool, out: Path,
) -> None:  # fmt: skip
    """Write SCENARIO's terrain as a GeoTIFF or a mesh.

    Coordinates are those of the site frame (x east, y north, z up, m); glTF (.glb) has y up. A
    scenario with [terrain] kind = "dtm" can fly over the GeoTIFF.
    """
    from lunarsim.exports.formats import FORMATS, check_export_output
    from lunarsim.exports.world import write_world
    from lunarsim.rng import RandomStreams, flight_seed
    from lunarsim.simulation.worlds import build_world

    check_export_output(FORMATS["world"], out)
    loaded = load_scenario(scenario, changes, is_flown=False)
    world = build_world(loaded, RandomStreams(flight_seed(seed, flight)))
    points = write_world(world.terrain, out, posting, has_rocks=rocks)
    count = len(world.terrain.rocks) if rocks else 0
    click.echo(f"{out}: {points} grid points, {count} rocks")
