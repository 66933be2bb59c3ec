"""The commands that show ground: `lunarsim terrain ...`."""

from __future__ import annotations

from pathlib import Path

import click

from lunarsim.cli_common import FLIGHT, PATH, SEED, Group, load_scenario, scenario_options
from lunarsim.errors import check_output


@click.group(cls=Group)
def terrain() -> None:
    """Look at measured and procedural ground."""


@terrain.command()
@click.argument("file", type=PATH)
def info(file: Path) -> None:
    """Print what a terrain model FILE (GeoTIFF, PDS .IMG) says of itself."""
    from rich.table import Table

    from lunarsim.console import plain_console
    from lunarsim.world.terrain.dtm import read_info

    found = read_info(file)
    table = Table(show_header=False, box=None)
    posting = None
    if found.posting is None:
        resampled = found.frame.startswith(("geographic", "rotated"))
        posting = (
            "resampled to a metric frame when loaded"
            if resampled
            else "not given: set terrain.dtm_posting_m"
        )
    for name, value in (
        ("file", str(found.path)),
        ("format", found.driver),
        ("posts", f"{found.rows} x {found.cols} (rows x columns)"),
        ("posting", posting or f"{found.posting:.4g} m"),
        ("frame", found.frame),
        ("elevation", f"{found.z_range[0]:.2f} to {found.z_range[1]:.2f} m"),
        ("no data", f"{100.0 * found.no_data_share:.2f} %"),
    ):
        table.add_row(name, value)
    plain_console().print(table)


@terrain.command()
@scenario_options
@SEED
@FLIGHT
@click.option("--out", type=PATH, required=True, help="PNG file to write.")
def preview(scenario: Path, changes: tuple[str, ...], seed: int, flight: int, out: Path) -> None:
    """Draw the ground of SCENARIO: shaded relief, slopes, rocks."""
    from lunarsim.rng import Streams, flight_seed
    from lunarsim.simulation.worlds import build_world
    from lunarsim.viz.terrain import draw_terrain

    check_output("--out", out, ".png")
    loaded = load_scenario(scenario, changes, flown=False)
    world = build_world(loaded, Streams(flight_seed(seed, flight)))
    draw_terrain(world.terrain, loaded.name, out)
    click.echo(f"{out}: {len(world.terrain.rocks)} rocks on {loaded.name}")


@terrain.command()
@scenario_options
@SEED
@FLIGHT
@click.option("--posting", type=float, default=0.2, show_default=True, help="Of the maps, m.")
@click.option(
    "--size", type=float, default=60.0, show_default=True,
    help="Side of the square around the target, m.",
)  # fmt: skip
@click.option("--out", type=PATH, required=True, help="NetCDF file (.nc).")
def truth(
    scenario: Path, changes: tuple[str, ...], seed: int, flight: int, posting: float, size: float,
    out: Path,
) -> None:  # fmt: skip
    """Write true maps of SCENARIO's ground: elevation, slope, rocks, exact safety, shadow."""
    from lunarsim.rng import Streams, flight_seed
    from lunarsim.simulation.worlds import build_world
    from lunarsim.world.truth_products import TruthProducts, survey_grid

    check_output("--out", out, ".nc")
    loaded = load_scenario(scenario, changes, flown=False)
    world = build_world(loaded, Streams(flight_seed(seed, flight)))
    grid = survey_grid(world, loaded.target.position_m, size, posting)
    maps = TruthProducts.of(world, loaded.vehicle.make(), grid)
    maps.save(out)
    click.echo(
        f"{out}: {grid.rows} x {grid.cols} cells, {100 * maps.safe.mean():.1f} % exactly safe, "
        f"{100 * (maps.rock >= 0).mean():.1f} % under rocks, {100 * maps.shadow.mean():.1f} % dark"
    )
