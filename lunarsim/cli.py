"""The `lunarsim` command."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import lunarsim
from lunarsim.cli_campaign import campaign, replay, sweep
from lunarsim.cli_common import (
    FLIGHT,
    PATH,
    SEED,
    FloatRange,
    Group,
    IntRange,
    allow_typed,
    cache_options,
    kept_if_interrupted,
    load_scenario,
    opened_cache,
    progress_bar,
    scenario_options,
    wide_console,
)
from lunarsim.cli_evaluate import evaluate
from lunarsim.cli_scenario import parts, scenario
from lunarsim.cli_start import INTERRUPTED, run
from lunarsim.cli_terrain import terrain
from lunarsim.errors import InputError, check_folder, check_output
from lunarsim.whole_files import filled_whole, remover_of_new

if TYPE_CHECKING:
    from rich.table import Table

_POLICIES = "no-divert,safest,nearest-safe,fuel-aware,truth-oracle"


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(lunarsim.__version__, prog_name="lunarsim")
def main() -> None:
    """Simulate lunar landings in closed loop: terrain, LiDAR, hazard map, divert, touchdown.

    \b
    Start here:
      lunarsim scenario list
      lunarsim scenario new hirise
      lunarsim fly hirise.toml --policy safest --out out/one
      lunarsim fly hirise.toml --set rocks.cover=0.12 --set start.heading_deg=0
      lunarsim compare hirise.toml --flights 20 --out out/compare
    """  # noqa: D301  (click wants the character itself)


for _command in (campaign, sweep, replay, terrain, scenario, parts, evaluate):
    main.add_command(_command)


@main.command()
@scenario_options
@click.option(
    "--policy", default=None, show_default="the scenario's",
    help="A name that `lunarsim parts policy` lists, or module:Class.",
)  # fmt: skip
@click.option(
    "--guidance", default=None, show_default="the scenario's",
    help="A law that `lunarsim parts guidance` lists, with its defaults, or module:Class.",
)  # fmt: skip
@SEED
@FLIGHT
@click.option(
    "--out", type=PATH, default=None,
    help="New folder for the scenario, the record and figures.",
)  # fmt: skip
def fly(
    scenario: Path, changes: tuple[str, ...], policy: str | None, guidance: str | None, seed: int,
    flight: int, out: Path | None,
) -> None:  # fmt: skip
    """Fly one descent of SCENARIO (a TOML file, or a name of `scenario list`): print its end."""
    from lunarsim.cli_waiting import compilation_told
    from lunarsim.rng import flight_seed
    from lunarsim.simulation import Simulation
    from lunarsim.simulation.lock_forecast import lock_forecast

    loaded = load_scenario(scenario, changes, parts={"policy": policy, "guidance": guidance})
    if out is not None:
        check_folder(out)
    maps = any(mapper.kind == "gaussian-dem" for mapper in loaded.mappers.values())
    beside = ["lunarsim.safety.warming"] + ["--exact"] * (out is not None)
    with compilation_told(beside if maps else []):
        simulation = Simulation(loaded, flight_seed(seed, flight), loaded.policy.kind)
        forecast = lock_forecast(simulation.briefing)
        if forecast is not None and not forecast.can_lock:
            click.echo(f"warning: {forecast}", err=True)
        record = simulation.run()
        if out is not None:
            from lunarsim.viz import truth_shown

            # It compiles kernels, which are counted here.
            truth = truth_shown(record, simulation.world, simulation.lander)
    if out is not None:
        # Before anything is printed: whoever reads that may stop listening.
        remove = remover_of_new(out)
        with filled_whole(out):
            record.save(out)
            loaded.save(out / "scenario.toml")
    if out is None:
        click.echo(str(record))
        return
    with kept_if_interrupted(f"scenario and record are in {out}, not all figures"):
        click.echo(str(record))
        from lunarsim.viz import draw_flight

        try:
            draw_flight(record, simulation.world, truth, out)
        except OSError:
            remove()
            raise
    click.echo(f"scenario, record and figures in {out}")


@main.command()
@scenario_options
@click.option(
    "--policies", default=None, show_default=f"{_POLICIES}; with --guidance the scenario's",
    help="Policies, separated by commas.",
)  # fmt: skip
@click.option(
    "--guidance", "laws", multiple=True, metavar="LAW",
    help="A law that `lunarsim parts guidance` lists, or module:Class; once for each law.",
)  # fmt: skip
@click.option("--flights", type=int, default=20, show_default=True, help="Flights a policy.")
@SEED
@click.option(
    "--jobs", type=int, default=os.cpu_count() or 1, show_default="number of cores",
    help="Processes; the results do not depend on it.",
)  # fmt: skip
@click.option(
    "--out", type=PATH, required=True,
    help="New folder for results.parquet, every flight's record, and figures.",
)  # fmt: skip
@click.option("--figures/--no-figures", default=True, show_default=True, help="Draw figures.")
@cache_options
def compare(
    scenario: Path, changes: tuple[str, ...], policies: str | None, laws: tuple[str, ...],
    flights: int, seed: int, jobs: int, out: Path, figures: bool, cache: Path | None,
    cache_size: float,
) -> None:  # fmt: skip
    """Fly several policies, or laws of guidance, over the same worlds of SCENARIO and compare them.

    Each meets the same worlds, starts and noise. The table gives, a row a policy or law: the
    share that landed safe with its 95 % Wilson interval; the same among flights whose scanned
    ground held an exactly safe site within reach; how many climbed away; propellant; divert
    distance; the largest touchdown speeds and tilt; precision and recall of the hazard map (cells
    with p > 0.5 against the exact map); and wall-clock time a flight, where the first policy's
    holds what all of them share. With laws it tells besides what each spends more than the first,
    flight by flight.
    """
    from lunarsim.campaign.comparison import check_request
    from lunarsim.campaign.comparison import compare as fly_all
    from lunarsim.campaign.engines.local import WorkersDieError

    given = _POLICIES if policies is None else policies
    names = [name.strip() for name in given.split(",") if name.strip()]
    allow_typed(*names, *laws)
    check_request(names, flights, jobs, laws)
    # Keys of a single part apply to it; if several are compared, they apply to the scenario's own.
    single = {
        contract: kinds[0]
        for contract, kinds in {"policy": names, "guidance": laws}.items()
        if len(kinds) == 1 and any(text.strip().startswith(f"{contract}.") for text in changes)
    }
    loaded = load_scenario(scenario, changes, parts=single)
    if policies is None and laws:
        names = [loaded.policy.kind]
    kept, console = opened_cache(cache, cache_size), wide_console(195 if laws else 170)
    with progress_bar(loaded.name, flights * len(names) * max(len(laws), 1)) as advance:
        try:
            result = fly_all(
                loaded, names, flights=flights, seed=seed, jobs=jobs, out=out, figures=figures,
                progress=advance, cache=kept, apart=True, guidance=laws,
                say=lambda line: click.echo(line, err=True),
            )  # fmt: skip
        except WorkersDieError as error:
            raise click.ClickException(str(error)) from None
    if result.rows:
        console.print(_table(result))
        console.print(
            f"exactly safe share of the ground where targets are drawn: {result.safe_share:.3f} at "
            f"every heading, {result.safe_share_at_heading:.3f} at the heading flown"
        )
        console.print(f"results, records and figures in {out}", soft_wrap=True)
    if not result.complete:
        click.echo("interrupted: only finished flights were written", err=True)
        sys.exit(INTERRUPTED)
    if result.unrecorded:
        click.echo(f"error: {result.unrecorded}", err=True)
        sys.exit(1)


@main.command()
@scenario_options
@click.option("--flights", type=int, default=12, show_default=True, help="Descents, at least 2.")
@click.option(
    "--seed", type=IntRange(min=0), default=1, show_default=True,
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
    "--out", type=PATH, required=True, help="JSON file to write.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Write over a file that is there.")
def calibrate(
    scenario: Path, changes: tuple[str, ...], flights: int, seed: int, jobs: int, sites: int,
    mapper: str | None, out: Path, force: bool,
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
    from lunarsim.campaign.calibrate import calibrate as fit
    from lunarsim.campaign.calibrate import gaussian_mapper
    from lunarsim.campaign.calibration_report import calibration_table, verdicts

    check_output("--out", out, ".json")
    if out.exists() and not force:
        raise InputError("--out", str(out), "a new file, or --force to write over this one")
    loaded = load_scenario(scenario, changes)
    gaussian_mapper(loaded, mapper)
    console = wide_console(170)
    with (
        kept_if_interrupted("nothing was written"),
        progress_bar(loaded.name, max(flights, 0)) as advance,
    ):
        found = fit(
            loaded, flights=flights, seed=seed, sites=sites, jobs=jobs, mapper=mapper,
            progress=advance,
        )  # fmt: skip
    found.calibration.save(out)
    console.print(calibration_table(found))
    for line in verdicts(found):
        console.print(line, soft_wrap=True)
    console.print(f"calibration in {out}", soft_wrap=True)


@main.command()
@scenario_options
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
    "--exposure", type=FloatRange(0.0, 100.0, min_open=True), default=None,
    help="s; left out: so that the brightest ground nearly fills the detector.",
)  # fmt: skip
@click.option("--ideal", is_flag=True, help="Without blur, noise and distortion; 16 bits.")
@SEED
@FLIGHT
@click.option(
    "--out", type=PATH, required=True, help="PNG file to write.",
)  # fmt: skip
@click.option(
    "--truth", type=PATH, default=None,
    help="NPZ file for radiance, range, normal and identity of every pixel.",
)  # fmt: skip
def render(
    scenario: Path, changes: tuple[str, ...], altitude: float, sun_elevation: float | None,
    sun_azimuth: float | None,
    off_nadir: float, heading: float, exposure: float | None, ideal: bool, seed: int,
    flight: int, out: Path, truth: Path | None,
) -> None:  # fmt: skip
    """Take a picture of SCENARIO's ground with its camera."""
    from lunarsim.simulation.picture import render as render_image

    check_output("--out", out, ".png")
    if truth is not None:
        check_output("--truth", truth, ".npz")
    image = render_image(
        load_scenario(scenario, changes, flown=False),
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


def _table(result: Any) -> Table:
    from rich.table import Table

    from lunarsim.evaluation.statistics import summarise

    table = Table(title=None)
    headings = (
        "guidance" if result.by_law else "policy", "landed safe [95 %]", "safe, site in reach",
        "aborted",
        "propellant kg\nmedian / 95 %",
        "divert m\nmedian", "touchdown m/s\ndown / side max", "tilt deg\nmax",
        "map\nprecision", "map\nrecall", "s a flight",
        *(["kg over the first\nmean, 95 %"] if result.by_law else []),
    )  # fmt: skip
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 else "right", no_wrap=i == 0)
    rows, first = result.shown, None
    for policy, row in summarise(rows).items():
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
            *([_more(rows, first, policy)] if result.by_law else []),
        )
        first = first or policy
    return table


def _more(rows: list[dict[str, Any]], first: str | None, other: str) -> str:
    """Return what one arm spends more than the first, flight by flight, in words."""
    from lunarsim.evaluation.statistics import mean_interval
    from lunarsim.viz.comparison import paired

    if first is None:
        return ""
    found = mean_interval(paired(rows, first, other, "propellant_kg"))
    return f"{found.mean:+.2f} ± {found.half:.2f}"


if __name__ == "__main__":
    run(main)
