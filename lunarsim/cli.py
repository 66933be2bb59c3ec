"""The `lunarsim` command: fly, compare, calibrate and render scenarios."""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import lunarsim
from lunarsim.atomic_files import new_contents_remover, remove_contents_on_error
from lunarsim.cli_agent import agent
from lunarsim.cli_campaign import campaign, replay, sweep
from lunarsim.cli_common import (
    FLIGHT,
    PATH,
    SEED,
    ErrorReportingGroup,
    FloatRange,
    IntRange,
    add_to_interrupt_message,
    allow_named_modules,
    cache_options,
    load_scenario,
    open_cache,
    progress_bar,
    scenario_options,
    wide_console,
)
from lunarsim.cli_evaluate import evaluate
from lunarsim.cli_export import export
from lunarsim.cli_interface import interface
from lunarsim.cli_scenario import parts, scenario
from lunarsim.cli_site import site
from lunarsim.cli_start import INTERRUPTED, run
from lunarsim.cli_study import study
from lunarsim.cli_terrain import terrain
from lunarsim.cli_vehicle import vehicle
from lunarsim.cli_view import check_live_view, film, live_view, view
from lunarsim.errors import InputError, check_folder, check_output

if TYPE_CHECKING:
    from rich.table import Table

_POLICIES = "no-divert,safest,nearest-safe,fuel-aware,truth-oracle"


@click.group(cls=ErrorReportingGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(lunarsim.__version__, prog_name="lunarsim")
def main() -> None:
    """Simulate lunar landings with hazard maps and diverts.

    \b
    Start here:
      lunarsim scenario list
      lunarsim scenario new hirise
      lunarsim fly hirise.toml --policy safest --out out/one
      lunarsim fly hirise.toml --set rocks.cover=0.12 --set start.heading_deg=0
      lunarsim compare hirise.toml --flights 20 --out out/compare
    """  # noqa: D301  (click wants the character itself)


for _command in (
    agent, campaign, sweep, replay, terrain, site, scenario, vehicle, parts, evaluate, study,
    interface, export, view, film,
):  # fmt: skip
    main.add_command(_command)


@main.command()
@scenario_options
@click.option(
    "--policy", default=None, show_default="policy of the scenario",
    help="Policy that selects the landing site: a name from `lunarsim parts policy`, or a Python "
    "class module:Class.",
)  # fmt: skip
@click.option(
    "--guidance", default=None, show_default="guidance law of the scenario",
    help="Guidance law: a name from `lunarsim parts guidance`, or a Python class module:Class. If "
    "it is not the scenario's law, it flies with its own default settings, not with [guidance].",
)  # fmt: skip
@SEED
@FLIGHT
@click.option(
    "--out", type=PATH, default=None,
    help="New folder for the scenario, the flight record and the figures. Default: no files are "
    "written.",
)  # fmt: skip
@click.option(
    "--pace", type=FloatRange(min=0, min_open=True), default=None, metavar="RATE",
    help="Simulated time divided by wall-clock time, for instance 1.0; prints the number of "
    "control cycles that take longer. Default: as fast as possible.",
)  # fmt: skip
@click.option(
    "--view", "is_viewed", is_flag=True,
    help="Show the flight in the Rerun viewer while it is simulated. Needs the extra `view`.",
)  # fmt: skip
@click.option(
    "--record-messages", "messages", type=PATH, default=None, metavar="DIR",
    help="New folder for records of the calls of external software, which `lunarsim interface "
    "replay` repeats.",
)  # fmt: skip
def fly(
    scenario: Path, changes: tuple[str, ...], policy: str | None, guidance: str | None, seed: int,
    flight: int, out: Path | None, pace: float | None, is_viewed: bool, messages: Path | None,
) -> None:  # fmt: skip
    """Fly one descent of SCENARIO and print its outcome.

    SCENARIO is a TOML file or a name from `lunarsim scenario list`.
    """
    from lunarsim.compile_progress import report_compilation
    from lunarsim.onboard.navigation.map_features import lock_forecast
    from lunarsim.rng import flight_seed
    from lunarsim.simulation import Simulation
    from lunarsim.simulation.pacing import Pacer

    loaded = load_scenario(scenario, changes, parts={"policy": policy, "guidance": guidance})
    for folder in (out, messages):
        if folder is not None:
            check_folder(folder)
    if is_viewed:
        check_live_view()
    maps = any(mapper.kind == "gaussian-dem" for mapper in loaded.mappers.values())
    beside = ["lunarsim.safety.compile_kernels"] + ["--exact"] * (out is not None)
    with report_compilation(beside if maps else []):
        simulation = Simulation(
            loaded, flight_seed(seed, flight), loaded.policy.kind, messages=messages
        )
        pacer = None if pace is None else Pacer(pace, simulation.briefing.cycle)
        forecast = lock_forecast(simulation.briefing)
        if forecast is not None and not forecast.can_lock:
            click.echo(f"warning: {forecast}", err=True)
        with live_view(simulation) if is_viewed else nullcontext() as watch:
            record = simulation.run(pacer, watch)
        if out is not None:
            # This call compiles kernels, so it must run inside the block that counts them.
            simulation.truth.is_safe_at(simulation.site[:2])
    if pacer is not None:
        click.echo(str(pacer), err=True)
    if messages is not None and not messages.exists():
        click.echo(f"warning: {messages}: no external software was called", err=True)
    if out is not None:
        # Save before printing: the reader of a pipe may close it early.
        remove = new_contents_remover(out)
        with remove_contents_on_error(out):
            record.save(out)
            loaded.save(out / "scenario.toml")
    if out is None:
        click.echo(str(record))
        return
    with add_to_interrupt_message(f"{out} has the scenario and the record, but not all figures"):
        click.echo(str(record))
        from lunarsim.viz import draw_flight

        try:
            draw_flight(record, simulation.world, simulation.truth, out)
        except OSError:
            remove()
            raise
    click.echo(f"scenario, flight record and figures are in {out}")


@main.command()
@scenario_options
@click.option(
    "--policies", default=None,
    show_default=f"{_POLICIES}; with --guidance: policy of the scenario",
    help="Policies to compare, separated by commas: names from `lunarsim parts policy`, or Python "
    "classes module:Class.",
)  # fmt: skip
@click.option(
    "--guidance", "laws", multiple=True, metavar="LAW",
    help="Guidance law to compare: a name from `lunarsim parts guidance`, or a Python class "
    "module:Class. Repeat the option for each law.",
)  # fmt: skip
@click.option(
    "--flights",
    type=int,
    default=20,
    show_default=True,
    help="Number of flights per policy and guidance law.",
)
@SEED
@click.option(
    "--jobs", type=int, default=os.cpu_count() or 1, show_default="number of cores",
    help="Number of parallel processes. It does not change the results.",
)  # fmt: skip
@click.option(
    "--out", type=PATH, required=True,
    help="New folder for results.parquet, the flight records and the figures.",
)  # fmt: skip
@click.option(
    "--figures/--no-figures",
    default=True,
    show_default=True,
    help="Whether to draw figures of the comparison and of single flights.",
)
@cache_options
def compare(
    scenario: Path, changes: tuple[str, ...], policies: str | None, laws: tuple[str, ...],
    flights: int, seed: int, jobs: int, out: Path, figures: bool, cache: Path | None,
    cache_size: float,
) -> None:  # fmt: skip
    """Compare policies or guidance laws on identical flights.

    All policies (or laws) fly the same worlds, start states and noise of SCENARIO. The table has
    one row per policy or law, with these columns: fraction of safe landings with its 95 % Wilson
    interval; the same fraction for flights whose scanned terrain contained a reachable site that
    is truly safe; aborts; propellant; divert distance; maximum touchdown speeds and tilt;
    precision and recall of the hazard map (cells with p > 0.5 against the true map); and
    wall-clock time per flight. The time of the first policy includes work that all policies share.
    With several laws, the last column gives the extra propellant relative to the first law,
    paired by flight.
    """
    from lunarsim.campaign.comparison import check_request
    from lunarsim.campaign.comparison import compare as fly_all
    from lunarsim.campaign.engines.local import WorkerStartError

    given = _POLICIES if policies is None else policies
    names = [name.strip() for name in given.split(",") if name.strip()]
    allow_named_modules(*names, *laws)
    check_request(names, flights, jobs, laws)
    # With one policy or law, --set keys apply to it; with several, to the scenario's own part.
    single = {
        contract: kinds[0]
        for contract, kinds in {"policy": names, "guidance": laws}.items()
        if len(kinds) == 1 and any(text.strip().startswith(f"{contract}.") for text in changes)
    }
    loaded = load_scenario(scenario, changes, parts=single)
    if policies is None and laws:
        names = [loaded.policy.kind]
    kept, console = open_cache(cache, cache_size), wide_console(195 if laws else 170)
    with progress_bar(loaded.name, flights * len(names) * max(len(laws), 1)) as advance:
        try:
            result = fly_all(
                loaded, names, flights=flights, seed=seed, jobs=jobs, out=out, figures=figures,
                progress=advance, cache=kept, separate_process=True,
                guidance=laws,
                notify=lambda line: click.echo(line, err=True),
            )  # fmt: skip
        except WorkerStartError as error:
            raise click.ClickException(str(error)) from None
    if result.rows:
        console.print(_comparison_table(result))
        console.print(
            f"truly safe fraction of the terrain where targets are drawn: {result.safe_share:.3f} "
            f"at every heading, {result.safe_share_at_heading:.3f} at the heading flown"
        )
        console.print(f"results, flight records and figures are in {out}", soft_wrap=True)
    if not result.complete:
        none = f" (none of {', '.join(result.without_flights)})" if result.without_flights else ""
        click.echo(f"interrupted: the results contain only finished flights{none}", err=True)
        sys.exit(INTERRUPTED)
    if result.unrecorded:
        click.echo(f"error: {result.unrecorded}", err=True)
        sys.exit(1)


@main.command()
@scenario_options
@click.option(
    "--flights",
    type=int,
    default=12,
    show_default=True,
    help="Number of calibration flights, 2 or more.",
)
@click.option(
    "--seed", type=IntRange(min=0), default=1, show_default=True,
    help="Seed from which the random numbers of these flights derive. No seed of `fly` or "
    "`compare` gives the same flights.",
)  # fmt: skip
@click.option(
    "--jobs", type=int, default=os.cpu_count() or 1, show_default="number of cores",
    help="Number of parallel processes. It does not change the results.",
)  # fmt: skip
@click.option(
    "--sites", type=int, default=300, show_default=True,
    help="Number of sites drawn at random from each map that was used for a divert decision.",
)  # fmt: skip
@click.option(
    "--mapper", default=None, show_default="the mapper that decisions use, or the only one",
    help="Name of the mapper to calibrate; its kind must be gaussian-dem.",
)  # fmt: skip
@click.option(
    "--out", type=PATH, required=True, help="JSON file to write with the calibration.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Overwrite the file --out if it exists.")
def calibrate(
    scenario: Path, changes: tuple[str, ...], flights: int, seed: int, jobs: int, sites: int,
    mapper: str | None, out: Path, force: bool,
) -> None:  # fmt: skip
    """Calibrate a Gaussian DEM mapper to SCENARIO's terrain.

    p_safe of a site is the probability that a touchdown there violates none of the limits of
    slope, roughness and belly clearance, whatever its heading. It excludes speed, tilt,
    tip-over and position error.

    The command flies SCENARIO with its own policy and samples random sites of the maps that divert
    decisions used. It then fits the last stage of the calibration (intercept and slope on log odds)
    to the observed fraction of truly safe sites. Sites inside and outside the domain of the
    calibration supplied with lunarsim have separate fits. To use the file:

    \b
      [mappers.NAME]
      kind = "gaussian-dem"
      calibration_path = "FILE.json"    # relative to the scenario file

    The table compares the supplied calibration with the refit on the same sites. Each flight is
    evaluated with a refit to all other flights (leave-one-out); the 95 % intervals are bootstrapped
    over flights. Over measured terrain, all flights share the same terrain: the table then
    describes other flights over it, not other terrain. Calibration flights use a separate random
    stream; `lunarsim fly` and `compare` never fly them.
    """  # noqa: D301
    from lunarsim.campaign.calibrate import calibrate as fit
    from lunarsim.campaign.calibrate import calibration_remarks, calibration_table, gaussian_mapper

    check_output("--out", out, ".json")
    if out.exists() and not force:
        raise InputError("--out", str(out), "must be a new file", "Use --force to overwrite it.")
    loaded = load_scenario(scenario, changes)
    gaussian_mapper(loaded, mapper)
    console = wide_console(170)
    with (
        add_to_interrupt_message("no file was written"),
        progress_bar(loaded.name, max(flights, 0)) as advance,
    ):
        found = fit(
            loaded, flights=flights, seed=seed, sites=sites, jobs=jobs, mapper=mapper,
            progress=advance,
        )  # fmt: skip
    found.calibration.save(out)
    console.print(calibration_table(found))
    for line in calibration_remarks(found):
        console.print(line, soft_wrap=True)
    console.print(f"the calibration is in {out}", soft_wrap=True)


@main.command()
@scenario_options
@click.option(
    "--altitude", type=float, default=100.0, show_default=True,
    help="Height of the camera above the terrain at the target (m).",
)  # fmt: skip
@click.option(
    "--sun-elevation", type=float, default=None,
    help="Elevation of the Sun above the horizon (deg). Default: value of the scenario.",
)  # fmt: skip
@click.option(
    "--sun-azimuth", type=float, default=None,
    help="Azimuth of the Sun, clockwise from north (deg). Default: value of the scenario.",
)  # fmt: skip
@click.option(
    "--off-nadir", type=float, default=0.0, show_default=True,
    help="Angle between the viewing direction and straight down (deg). The target stays in the "
    "image centre.",
)  # fmt: skip
@click.option(
    "--heading", type=float, default=0.0, show_default=True,
    help="Direction at the top of the image, clockwise from north (deg).",
)  # fmt: skip
@click.option(
    "--exposure", type=FloatRange(0.0, 100.0, min_open=True), default=None,
    help="Exposure time (s). Default: the brightest terrain is just below saturation.",
)  # fmt: skip
@click.option(
    "--ideal",
    is_flag=True,
    help="Render without blur, noise and distortion, with 16 bits per pixel.",
)
@SEED
@FLIGHT
@click.option(
    "--out", type=PATH, required=True, help="PNG file to write.",
)  # fmt: skip
@click.option(
    "--truth", type=PATH, default=None,
    help="NPZ file to write, with true radiance, range, surface normal and object ID of every "
    "pixel. Default: none.",
)  # fmt: skip
def render(
    scenario: Path, changes: tuple[str, ...], altitude: float, sun_elevation: float | None,
    sun_azimuth: float | None,
    off_nadir: float, heading: float, exposure: float | None, ideal: bool, seed: int,
    flight: int, out: Path, truth: Path | None,
) -> None:  # fmt: skip
    """Render a camera image of SCENARIO's terrain."""
    from lunarsim.simulation.image_rendering import render as render_image

    check_output("--out", out, ".png")
    if truth is not None:
        check_output("--truth", truth, ".npz")
    image = render_image(
        load_scenario(scenario, changes, is_flown=False),
        altitude=altitude,
        sun_elevation_deg=sun_elevation,
        sun_azimuth_deg=sun_azimuth,
        off_nadir_deg=off_nadir,
        heading_deg=heading,
        exposure=exposure,
        ideal=ideal,
        seed=seed,
        flight=flight,
        truth=truth is not None,
    )
    if truth is not None:
        image.save_truth(truth)
    try:
        image.save(out)
    except OSError:
        if truth is not None:
            truth.unlink(missing_ok=True)
        raise
    click.echo(f"{out}: {image.description}")


def _comparison_table(result: Any) -> Table:
    """Return the table of results that the `compare` command prints."""
    from rich.table import Table

    from lunarsim.evaluation.statistics import summarise_policies

    table = Table(title=None)
    headings = (
        "Guidance law" if result.by_law else "Policy", "Landed safely\n[95 % CI]",
        "Landed safely,\nsite in reach", "Aborted",
        "Propellant (kg)\nmedian / 95th pct.",
        "Divert (m)\nmedian", "Touchdown (m/s)\nmax. down / lateral", "Tilt (deg)\nmax.",
        "Map\nprecision", "Map\nrecall", "Time per\nflight (s)",
        *(["Extra propellant (kg)\nmean, 95 % CI"] if result.by_law else []),
    )  # fmt: skip
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 else "right", no_wrap=i == 0)
    rows, first = result.shown, None
    for policy, row in summarise_policies(rows).items():
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
            *([_extra_propellant(rows, first, policy)] if result.by_law else []),
        )
        first = first or policy
    return table


def _extra_propellant(rows: list[dict[str, Any]], first: str | None, other: str) -> str:
    """Return the mean extra propellant of a law over the first law as text, kg.

    The text includes the 95 % interval; it is empty if `first` is None, in the row of the first
    law. `rows` are the result rows of all flights.
    """
    from lunarsim.evaluation.statistics import mean_interval
    from lunarsim.viz.comparison import paired_differences

    if first is None:
        return ""
    found = mean_interval(paired_differences(rows, first, other, "propellant_kg"))
    return f"{found.mean:+.2f} ± {found.half:.2f}"


if __name__ == "__main__":
    run(main)
