"""The `lunarsim` command."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

import lunarsim
from lunarsim.cli_campaign import campaign, replay, sweep
from lunarsim.errors import InputError, RenderingError, check_output

_INTERRUPTED = 130


class _Group(click.Group):
    """Turns a user's mistake into one line and exit code 2."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            click.echo(f"error: {error}", err=True)
            ctx.exit(2)
        except RenderingError as error:
            click.echo(f"error: {error}", err=True)
            ctx.exit(1)
        except OSError as error:
            if error.filename is None:
                raise
            click.echo(f"error: {error.filename}: {error.strerror}", err=True)
            ctx.exit(2)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(lunarsim.__version__, prog_name="lunarsim")
def main() -> None:
    """Simulate lunar landings in closed loop: terrain, LiDAR, hazard map, divert, touchdown.

    \b
    Start here:
      lunarsim fly scenarios/hirise.toml --policy safest --out out/one
      lunarsim compare scenarios/hirise.toml --flights 20 --out out/compare
    """  # noqa: D301  (click wants the character itself)


main.add_command(campaign)
main.add_command(sweep)
main.add_command(replay)

_SCENARIO = click.argument("scenario", type=click.Path(path_type=Path))
_SEED = click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Root seed."
)
_FLIGHT = click.option(
    "--flight", type=click.IntRange(min=0), default=0, show_default=True,
    help="Index of the flight: world and noise derive from the seed and this.",
)  # fmt: skip


@main.command()
@_SCENARIO
@click.option(
    "--policy", default=None, show_default="the scenario's",
    help="A name that `lunarsim parts policy` lists, or module:Class.",
)  # fmt: skip
@click.option(
    "--guidance", default=None, show_default="the scenario's",
    help="A law that `lunarsim parts guidance` lists, with its defaults, or module:Class.",
)  # fmt: skip
@_SEED
@_FLIGHT
@click.option(
    "--out", type=click.Path(path_type=Path), default=None,
    help="New folder for the record and figures.",
)  # fmt: skip
def fly(
    scenario: Path, policy: str | None, guidance: str | None, seed: int, flight: int,
    out: Path | None,
) -> None:  # fmt: skip
    """Fly one descent of SCENARIO (a TOML file) and print how it ended."""
    from lunarsim.campaign.comparison import check_folder, check_request
    from lunarsim.parts import resolve
    from lunarsim.rng import flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation import Simulation
    from lunarsim.simulation.lock_forecast import lock_forecast

    loaded = Scenario.load(scenario)
    if guidance is not None and guidance != loaded.guidance.kind:
        resolve("guidance", guidance, "--guidance")
        loaded = loaded.changed(guidance={"kind": guidance})
    chosen = policy or loaded.policy.kind
    check_request([chosen], 1, 1)
    if out is not None:
        check_folder(out)
    simulation = Simulation(loaded, flight_seed(seed, flight), chosen)
    console = Console()
    forecast = lock_forecast(simulation.briefing)
    if forecast is not None and not forecast.can_lock:
        console.print(f"warning: {forecast}", soft_wrap=True)
    record = simulation.run()
    verdict = record.verdict
    console.print("landed safe" if verdict.safe else "not safe: " + ", ".join(verdict.failed))
    table = Table(show_header=False, box=None)
    for name, value in _facts(record):
        table.add_row(name, value)
    console.print(table)
    for decision in record.decisions:
        console.print(
            f"{decision['time']:6.1f} s  divert to ({decision['to'][0]:.1f}, "
            f"{decision['to'][1]:.1f}) m: {decision['reason']}"
        )
    if out is not None:
        from lunarsim.viz import draw_flight

        record.save(out)
        draw_flight(record, simulation.world, simulation.truth, out)
        console.print(f"record and figures in {out}")


def _facts(record: Any) -> list[tuple[str, str]]:
    facts = [
        ("time of flight", f"{record.duration:.1f} s"),
        ("propellant", f"{record.propellant_used:.1f} kg"),
        ("divert", f"{record.divert_distance:.1f} m"),
    ]
    if record.first_lost is not None:
        end = "to the end" if record.lost else "believed again later"
        facts.append(("navigation", f"lost from {record.first_lost:.1f} s, {end}"))
    touchdown = record.verdict.touchdown
    if touchdown is not None:
        degrees = 57.29577951308232
        facts += [
            ("vertical speed", f"{touchdown.vertical_speed:.2f} m/s"),
            ("horizontal speed", f"{touchdown.horizontal_speed:.2f} m/s"),
            ("tilt at contact", f"{touchdown.tilt * degrees:.1f} deg"),
            ("slope under the legs", f"{touchdown.slope * degrees:.1f} deg"),
            ("roughness under the belly", f"{touchdown.roughness:.2f} m"),
            ("margin against tipping over", f"{touchdown.tip_margin:.2f}"),
        ]
    return facts


@main.command()
@_SCENARIO
@click.option(
    "--policies", default="no-divert,safest,nearest-safe,fuel-aware,truth-oracle",
    show_default=True, help="Policies, separated by commas.",
)  # fmt: skip
@click.option("--flights", type=int, default=20, show_default=True, help="Flights a policy.")
@_SEED
@click.option(
    "--jobs", type=int, default=os.cpu_count() or 1, show_default="number of cores",
    help="Processes; the results do not depend on it.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), required=True,
    help="New folder for results.parquet, every flight's record, and figures.",
)  # fmt: skip
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw figures.")
def compare(
    scenario: Path, policies: str, flights: int, seed: int, jobs: int, out: Path, figures: bool
) -> None:
    """Fly several policies over the same worlds of SCENARIO and compare them.

    Every policy meets the same worlds, starts and noise. The table gives, a row a policy: the
    share that landed safe with its 95 % Wilson interval; the same among flights whose scanned
    ground held an exactly safe site within reach; how many climbed away; propellant; divert
    distance; the largest touchdown speeds and tilt; precision and recall of the hazard map (cells
    with p > 0.5 against the exact map); and wall-clock time a flight.
    """
    from lunarsim.campaign.comparison import compare as run
    from lunarsim.scenario import Scenario

    loaded = Scenario.load(scenario)
    names = [name.strip() for name in policies.split(",") if name.strip()]
    console = Console(width=None if sys.stdout.isatty() else 170)
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        console=Console(stderr=True),
    ) as bar:  # fmt: skip
        task = bar.add_task(f"{loaded.name}", total=max(flights, 0) * len(names))
        result = run(
            loaded,
            names,
            flights=flights,
            seed=seed,
            jobs=jobs,
            out=out,
            figures=figures,
            progress=lambda n: bar.advance(task, n),
        )
    if result.rows:
        console.print(_table(result))
        console.print(
            f"exactly safe share of the ground where targets are drawn: {result.safe_share:.3f} at "
            f"every heading, {result.safe_share_at_heading:.3f} at the heading flown"
        )
        console.print(f"results, records and figures in {out}")
    if not result.complete:
        click.echo("interrupted: only finished flights were written", err=True)
        sys.exit(_INTERRUPTED)


@main.command()
@_SCENARIO
@click.option("--flights", type=int, default=12, show_default=True, help="Descents, at least 2.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True,
    help="Root seed of these flights; `compare` flies others, whatever its seed.",
)  # fmt: skip
@click.option(
    "--jobs", type=int, default=os.cpu_count() or 1, show_default="number of cores",
    help="Processes; the result does not depend on it.",
)  # fmt: skip
@click.option(
    "--sites", type=int, default=300, show_default=True,
    help="Drawn at random from each map that a decision is made on.",
)  # fmt: skip
@click.option(
    "--mapper", default=None, show_default="the one that decides, or the only one",
    help="Name of the mapper of kind gaussian-dem.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="JSON file to write.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Write over a file that is there.")
def calibrate(
    scenario: Path, flights: int, seed: int, jobs: int, sites: int, mapper: str | None,
    out: Path, force: bool,
) -> None:  # fmt: skip
    """Fit the Gaussian DEM's probability of safety to SCENARIO's own ground.

    Flies SCENARIO's descents under its own policy, draws sites from the maps that it decides on,
    and fits the last stage of the calibration to how many of them are exactly safe: once in the
    domain of the packaged calibration, once outside of it. To use what is written:

    \b
      [mappers.NAME]
      kind = "gaussian-dem"
      calibration_path = "FILE.json"    # relative to the scenario file

    The table sets the packaged probability beside the refit on the same sites. Each flight is
    judged by a refit to the others; 95 % intervals come from drawing flights anew. Over measured
    ground all flights share the relief: then the table tells of other flights there, not of other
    ground. The flights derive from the seed in a way of their own, so that flights of
    `lunarsim fly` and `compare` are never those that were fitted to.
    """  # noqa: D301
    from lunarsim.campaign.calibrate import calibrate as run
    from lunarsim.campaign.calibrate import gaussian_mapper
    from lunarsim.campaign.calibration_report import calibration_table, verdicts
    from lunarsim.scenario import Scenario

    check_output("--out", out, ".json")
    if out.exists() and not force:
        raise InputError("--out", str(out), "a new file, or --force to write over this one")
    loaded = Scenario.load(scenario)
    gaussian_mapper(loaded, mapper)
    console = Console(width=None if sys.stdout.isatty() else 170)
    try:
        with Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
            TimeRemainingColumn(), console=Console(stderr=True),
        ) as bar:  # fmt: skip
            task = bar.add_task(f"{loaded.name}", total=max(flights, 0))
            found = run(
                loaded, flights=flights, seed=seed, sites=sites, jobs=jobs, mapper=mapper,
                progress=lambda n: bar.advance(task, n),
            )  # fmt: skip
    except KeyboardInterrupt:
        click.echo("interrupted: nothing was written", err=True)
        sys.exit(_INTERRUPTED)
    found.calibration.save(out)
    console.print(calibration_table(found))
    for line in verdicts(found):
        console.print(line, soft_wrap=True)
    console.print(f"calibration in {out}", soft_wrap=True)


@main.command()
@_SCENARIO
@click.option(
    "--altitude", type=float, default=100.0, show_default=True,
    help="Height of the camera above the ground at the target, m.",
)  # fmt: skip
@click.option("--sun-elevation", type=float, default=None, help="deg; left out: the scenario's.")
@click.option("--sun-azimuth", type=float, default=None, help="deg from north, clockwise.")
@click.option(
    "--off-nadir", type=float, default=0.0, show_default=True,
    help="Tilt of the boresight from straight down, deg; the target stays in the middle.",
)  # fmt: skip
@click.option(
    "--heading", type=float, default=0.0, show_default=True,
    help="Azimuth of the top of the picture, deg.",
)  # fmt: skip
@click.option(
    "--exposure", type=click.FloatRange(min=0.0, min_open=True), default=None,
    help="s; left out: so that the brightest ground nearly fills the detector.",
)  # fmt: skip
@click.option("--ideal", is_flag=True, help="Without blur, noise and distortion; 16 bits.")
@_SEED
@_FLIGHT
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="PNG file to write.",
)  # fmt: skip
@click.option(
    "--truth", type=click.Path(path_type=Path), default=None,
    help="NPZ file for radiance, range, normal and identity of every pixel.",
)  # fmt: skip
def render(
    scenario: Path, altitude: float, sun_elevation: float | None, sun_azimuth: float | None,
    off_nadir: float, heading: float, exposure: float | None, ideal: bool, seed: int,
    flight: int, out: Path, truth: Path | None,
) -> None:  # fmt: skip
    """Take a picture of SCENARIO's ground with its camera."""
    from lunarsim.scenario import Scenario
    from lunarsim.simulation.picture import take_picture

    info = take_picture(
        Scenario.load(scenario),
        altitude=altitude,
        sun_elevation_deg=sun_elevation,
        sun_azimuth_deg=sun_azimuth,
        off_nadir_deg=off_nadir,
        heading_deg=heading,
        exposure=exposure,
        ideal=ideal,
        seed=seed,
        flight=flight,
        out=out,
        truth=truth,
    )
    click.echo(info)


@main.group(cls=_Group)
def terrain() -> None:
    """Look at measured and procedural ground."""


@terrain.command()
@click.argument("file", type=click.Path(path_type=Path))
def info(file: Path) -> None:
    """Print what a terrain model FILE (GeoTIFF, PDS .IMG) says of itself."""
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
    Console().print(table)


@terrain.command()
@_SCENARIO
@_SEED
@_FLIGHT
@click.option("--out", type=click.Path(path_type=Path), required=True, help="PNG file to write.")
def preview(scenario: Path, seed: int, flight: int, out: Path) -> None:
    """Draw the ground of SCENARIO: shaded relief, slopes, rocks."""
    from lunarsim.rng import Streams, flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation.worlds import build_world
    from lunarsim.viz.terrain import draw_terrain

    loaded = Scenario.load(scenario)
    check_output("out", out, ".png")
    world = build_world(loaded, Streams(flight_seed(seed, flight)))
    draw_terrain(world.terrain, loaded.name, out)
    click.echo(f"{out}: {len(world.terrain.rocks)} rocks on {loaded.name}")


@terrain.command()
@_SCENARIO
@_SEED
@_FLIGHT
@click.option("--posting", type=float, default=0.2, show_default=True, help="Of the maps, m.")
@click.option(
    "--size", type=float, default=60.0, show_default=True,
    help="Side of the square around the target, m.",
)  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path), required=True, help="NetCDF file (.nc).")
def truth(scenario: Path, seed: int, flight: int, posting: float, size: float, out: Path) -> None:
    """Write true maps of SCENARIO's ground: elevation, slope, rocks, exact safety, shadow."""
    from lunarsim.rng import Streams, flight_seed
    from lunarsim.scenario import Scenario
    from lunarsim.simulation.worlds import build_world
    from lunarsim.world.truth_products import TruthProducts, survey_grid

    loaded = Scenario.load(scenario)
    check_output("out", out, ".nc")
    world = build_world(loaded, Streams(flight_seed(seed, flight)))
    grid = survey_grid(world, loaded.target.position_m, size, posting)
    maps = TruthProducts.of(world, loaded.vehicle.make(), grid)
    maps.save(out)
    click.echo(
        f"{out}: {grid.rows} x {grid.cols} cells, {100 * maps.safe.mean():.1f} % exactly safe, "
        f"{100 * (maps.rock >= 0).mean():.1f} % under rocks, {100 * maps.shadow.mean():.1f} % dark"
    )


@main.command()
@click.argument("contract", required=False)
def parts(contract: str | None) -> None:
    """List the parts that scenarios choose from, or those of one CONTRACT."""
    from lunarsim.scenario.reference import parts_list

    for line in parts_list(contract):
        click.echo(line)


@main.group(cls=_Group)
def scenario() -> None:
    """Scenario files: what they may hold, and whether one is right."""


@scenario.command()
@click.option("--markdown", is_flag=True, help="As Markdown tables; else as text.")
def reference(markdown: bool) -> None:
    """Print every key of a scenario file with unit, default, bounds and meaning."""
    from lunarsim.scenario.reference import reference_text

    click.echo(reference_text(markdown=markdown))


@scenario.command()
@click.argument("file", type=click.Path(path_type=Path))
def check(file: Path) -> None:
    """Check a scenario FILE and print it whole, defaults included."""
    from lunarsim.scenario import Scenario

    click.echo(Scenario.load(file).to_toml(), nl=False)


def _table(result: Any) -> Table:
    from lunarsim.evaluation.statistics import summarise

    table = Table(title=None)
    headings = (
        "policy", "landed safe [95 %]", "safe, site in reach", "aborted",
        "propellant kg\nmedian / 95 %",
        "divert m\nmedian", "touchdown m/s\ndown / side max", "tilt deg\nmax",
        "map\nprecision", "map\nrecall", "s a flight",
    )  # fmt: skip
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 else "right", no_wrap=i == 0)
    for policy, row in summarise(result.rows).items():
        seconds = result.seconds[policy]
        reach = row["safe_in_reach"]
        table.add_row(
            policy,
            str(row["safe"]),
            f"{reach.value:.3f} ({reach.count}/{reach.total})",
            str(row["aborted"]),
            f"{row['propellant_median_kg']:.1f} / {row['propellant_p95_kg']:.1f}",
            f"{row['divert_median_m']:.1f}",
            f"{row['vertical_speed_max_m_s']:.2f} / {row['horizontal_speed_max_m_s']:.2f}",
            f"{row['tilt_max_deg']:.1f}",
            f"{row['precision']:.4f}",
            f"{row['recall']:.3f}",
            f"{sum(seconds) / len(seconds):.2f}",
        )
    return table


if __name__ == "__main__":
    main()
