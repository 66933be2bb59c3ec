"""Define the commands `lunarsim campaign`, `lunarsim sweep`, `lunarsim replay`."""

from __future__ import annotations

import csv
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lunarsim.atomic_files import remove_contents_on_error
from lunarsim.cli_common import (
    PATH,
    FloatRange,
    IntRange,
    add_to_interrupt_message,
    allow_named_modules,
    allow_options,
    cache_options,
    load_scenario,
    open_cache,
    progress_bar,
    scenario_options,
    wide_console,
)
from lunarsim.cli_requirements import threshold, verify
from lunarsim.cli_start import INTERRUPTED
from lunarsim.errors import InputError, check_folder, check_output

if TYPE_CHECKING:
    from lunarsim.campaign.results import Results
    from lunarsim.campaign.spec import CampaignSpec

_FOLDER = click.argument("folder", type=PATH)
_JOBS = click.option(
    "--jobs", type=IntRange(min=1), default=os.cpu_count() or 1,
    show_default="number of cores",
    help="Number of parallel processes. It does not change the results.",
)  # fmt: skip
_OUT = click.option(
    "--out", type=PATH, required=True,
    help="Results folder. If it has results of the same campaign, that campaign is continued.",
)  # fmt: skip
_RETRY = click.option(
    "--retry-failed", is_flag=True,
    help="Fly flights of an earlier run again if they raised an error, exceeded their time limit "
    "or were killed.",
)  # fmt: skip


@click.group()
def campaign() -> None:
    """Run and analyse campaigns: many flights from one file.

    \b
      lunarsim campaign plan SPEC             # list the inputs of every flight
      lunarsim campaign run SPEC --out DIR    # fly; repeat to continue after an interrupt
      lunarsim campaign status DIR
      lunarsim campaign export DIR --out results.csv
      lunarsim campaign verify DIR requirements.toml
    """  # noqa: D301


campaign.add_command(verify)
campaign.add_command(threshold)


@campaign.command()
@click.argument("spec", type=PATH)
@allow_options
@click.option(
    "--out", type=PATH, default=None, show_default="standard output",
    help="File for the planned flights, one row each: CSV (.csv) or Parquet (.parquet).",
)  # fmt: skip
def plan(spec: Path, out: Path | None) -> None:
    """Write the inputs of every flight of SPEC without flying.

    SPEC is the TOML file of the campaign.
    """
    from lunarsim.campaign.flight_execution import build_plan, check_files
    from lunarsim.campaign.spec import CampaignSpec

    if out is not None:
        suffix = out.suffix.lower()
        check_output("--out", out, suffix if suffix in (".csv", ".parquet") else ".csv")
    loaded = CampaignSpec.load(spec)
    check_files(loaded)
    _print_warnings(loaded)
    planned = build_plan(loaded)
    if out is not None:
        from lunarsim.atomic_files import atomic_write
        from lunarsim.campaign.rows import write_plan

        atomic_write(out, lambda path: write_plan(planned, path, out.suffix.lower()))
        summary = f"{planned.flights} flights of {len(planned.arms)} arms"
        if planned.chains is not None:
            summary = (
                f"{planned.chains.flights} flights of the first level; later levels depend on it"
            )
        click.echo(f"{out}: {summary}")
        return
    names = ["id", "flight", "arm", "seed", *planned.inputs]
    writer = csv.DictWriter(sys.stdout, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(planned.rows())


@campaign.command("run")
@click.argument("spec", type=PATH)
@allow_options
@_OUT
@click.option(
    "--engine", type=click.Choice(["local", "ray"]), default="local", show_default=True,
    help="Where flights run: local (processes on this machine) or ray (a Ray cluster).",
)  # fmt: skip
@_JOBS
@click.option(
    "--address",
    default=None,
    help="Address of a running Ray cluster, with --engine ray. Default: start a cluster on this "
    "machine.",
)
@cache_options
@_RETRY
def run_command(
    spec: Path, out: Path, engine: str, jobs: int, address: str | None, cache: Path | None,
    cache_size: float, retry_failed: bool,
) -> None:  # fmt: skip
    """Fly all flights of campaign SPEC, or the missing ones.

    SPEC is the TOML file of the campaign. If the folder has results of an unfinished run,
    the same command continues it.
    """
    from lunarsim.campaign.spec import CampaignSpec

    if address is not None and engine != "ray":
        raise InputError("--address", address, "must be omitted unless --engine is ray")
    loaded = CampaignSpec.load(spec)
    _fly_campaign(loaded, out, engine, jobs, address, retry_failed, (cache, cache_size))


@click.command()
@scenario_options
@click.option(
    "--over", "over", multiple=True, required=True,
    help="Scenario key and its values: KEY=A,B,C, or KEY=LOW:HIGH:COUNT for COUNT evenly spaced "
    "values. Repeat the option to fly all combinations of several keys.",
)  # fmt: skip
@click.option(
    "--flights", type=IntRange(min=1), default=20, show_default=True,
    help="Number of flights per combination of values.",
)  # fmt: skip
@click.option(
    "--seed",
    type=IntRange(min=0),
    default=1,
    show_default=True,
    help="Seed from which all random numbers derive.",
)
@_OUT
@_JOBS
@cache_options
@_RETRY
def sweep(
    scenario: Path, changes: tuple[str, ...], over: tuple[str, ...], flights: int, seed: int,
    out: Path, jobs: int, cache: Path | None, cache_size: float, retry_failed: bool,
) -> None:  # fmt: skip
    """Fly SCENARIO with all combinations of given key values.

    All combinations use the same random numbers. This is a short form of `lunarsim campaign run`.

    \b
    Example:
      lunarsim sweep hirise.toml --over rocks.cover=0.02,0.1 --out out/sweep
    """  # noqa: D301
    from lunarsim.campaign.factors import parse_factors, split_changes
    from lunarsim.campaign.spec import CampaignSpec

    allow_named_modules(*over, *changes)
    levels = parse_factors(over)
    base, of_swept_parts = split_changes(changes, levels)
    data = {
        "name": f"{scenario.stem}-sweep",
        "scenario": load_scenario(scenario, base, is_flown=False).to_dict(),
        "flights": flights,
        "seed": seed,
        "factors": levels | {key: [value] for key, value in of_swept_parts.items()},
    }
    try:
        spec = CampaignSpec.from_dict(data)
    except InputError as error:
        is_set = error.field.removeprefix("factors.") in of_swept_parts
        field = error.field.replace("factors.", "--set " if is_set else "--over ", 1)
        raise error.with_field(field) from None
    _fly_campaign(spec, out, "local", jobs, None, retry_failed, (cache, cache_size))


def _print_warnings(spec: CampaignSpec) -> None:
    """Print the warnings about the scenario of each arm (variant) of a campaign.

    The scenario of the arm's first flight is checked.
    """
    from lunarsim.scenario.scenario_warnings import warnings_for

    found: dict[str, list[str]] = {}
    for number, arm in enumerate(spec.arms):
        for note in warnings_for(spec.scenario_of(0, number)):
            found.setdefault(note, []).append(arm.name)
    for note, arms in found.items():
        whose = "" if len(arms) == len(spec.arms) else f"arm {arms[0]!r}: "
        more = f" ({len(arms)} arms)" if whose and len(arms) > 1 else ""
        click.echo(f"warning: {whose}{note}{more}", err=True)


def _fly_campaign(
    spec: CampaignSpec, out: Path, engine: str, jobs: int, address: str | None, retry: bool,
    cache: tuple[Path | None, float],
) -> None:  # fmt: skip
    """Fly a campaign with a progress bar and print its outcome.

    `retry` repeats failed flights; `cache` is the folder and the maximum size (GiB) of the cache.
    """
    from lunarsim.campaign.engines import make_engine
    from lunarsim.campaign.engines.local import WorkerStartError
    from lunarsim.campaign.fly_spec import fly_spec

    _print_warnings(spec)
    flies = make_engine(engine, jobs, address, spec.head.time_limit)
    kept = open_cache(*cache)
    total = spec.max_flights * len(spec.arms)
    with progress_bar(spec.head.name, total) as advance:
        try:
            ran = fly_spec(
                spec, flies, out, retry=retry, progress=advance, cache=kept,
                notify=lambda line: click.echo(line, err=True),
            )  # fmt: skip
        except WorkerStartError as error:
            raise click.ClickException(str(error)) from None
    for note in ran.notes:
        click.echo(f"note: {note}", err=True)
    click.echo(
        f"{ran.state}: {ran.flown} new flights, {ran.before} flights from earlier runs; "
        f"{ran.failed} of them ended without an outcome"
        if ran.failed
        else f"{ran.state}: {ran.flown} new flights, {ran.before} flights from earlier runs"
    )
    click.echo(f"results are in {out}; next: lunarsim campaign report {out}")
    if not ran.complete:
        click.echo("not complete: repeat the command to continue", err=True)
        if engine == "ray" and ran.state == "interrupted":
            from lunarsim.campaign.engines.ray_cluster import exit_immediately

            sys.stdout.flush()
            sys.stderr.flush()
            exit_immediately(INTERRUPTED)
        sys.exit(INTERRUPTED if ran.state == "interrupted" else 0)
    if ran.unrecorded:
        click.echo(f"error: {ran.unrecorded}", err=True)
        sys.exit(1)


@campaign.command()
@_FOLDER
def status(folder: Path) -> None:
    """Show the progress of the campaign in FOLDER.

    The campaign may be running.
    """
    from lunarsim.campaign.results import read_status

    found = read_status(folder)
    click.echo(f"{found.name}: {found.state}, {found.done} of {found.expected_rows} flights")
    if found.rate == found.rate:
        left = (
            ""
            if found.done >= found.expected_rows
            else f", {_format_duration(found.seconds_left)} left"
        )
        click.echo(f"{60.0 * found.rate:.1f} flights per minute{left}")
    for outcome, count in sorted(found.outcomes.items()):
        click.echo(f"{outcome}: {count}")


def _format_duration(seconds: float) -> str:
    minutes, hours = seconds / 60.0, seconds / 3600.0
    if hours >= 1.0:
        return f"{hours:.1f} h"
    return f"{minutes:.0f} min" if minutes >= 1.0 else f"{seconds:.0f} s"


@campaign.command()
@_FOLDER
@click.option(
    "--out",
    type=PATH,
    required=True,
    help="File for the results, one row per flight and arm: CSV (.csv) or Parquet (.parquet).",
)
@click.option("--timing", is_flag=True, help="Add columns with the computing time of each flight.")
def export(folder: Path, out: Path, timing: bool) -> None:
    """Write all results of the campaign in FOLDER to a table."""
    from lunarsim.campaign.results import export as write

    click.echo(f"{out}: {write(folder, out, timing=timing)} rows")


@campaign.command()
@_FOLDER
@click.option(
    "--out", type=PATH, default=None, show_default="report.html in FOLDER",
    help="HTML file to write, or Markdown file (.md) with the tables only.",
)  # fmt: skip
def report(folder: Path, out: Path | None) -> None:
    """Write a report of the campaign in FOLDER.

    The report is one HTML file that needs no network.
    """
    from lunarsim.campaign.report import write_report
    from lunarsim.campaign.results import load_results

    load_results(folder, ["outcome"])
    target = folder / "report.html" if out is None else out
    write_report(folder, target)
    click.echo(f"the report is in {target}")


@campaign.command()
@_FOLDER
@click.option(
    "--metric", default="safe", show_default=True,
    help="Result column to analyse; its values are numbers or true/false.",
)  # fmt: skip
@click.option(
    "--resamples", type=IntRange(min=20), default=100, show_default=True,
    help="Number of bootstrap samples for the 95 % intervals.",
)  # fmt: skip
def sensitivity(folder: Path, metric: str, resamples: int) -> None:
    """Print how sensitive a result is to each dispersed key.

    FOLDER has the results of a campaign. A campaign with method = "saltelli" gives Sobol indices.
    Every other method gives PAWN indices: the Kolmogorov distance between the metric's
    distribution over all flights and over flights with the key in one tenth of its range (median
    over all tenths). All indices have 95 % intervals.
    """
    from rich.table import Table

    from lunarsim.campaign.results import load_results
    from lunarsim.campaign.sensitivity import sensitivities

    for found in sensitivities(load_results(folder), metric, resamples):
        click.echo(
            f"{found.arm}: {found.metric}, {found.method}, {found.rows} flights"
            + (f", {found.left_out} excluded" if found.left_out else "")
        )
        if found.why_not:
            click.echo(f"  no indices: {found.why_not}")
            continue
        table = Table("key", *found.indices)
        for i, name in enumerate(found.names):
            cells = [
                f"{v[i][0]:.3f} [{v[i][1]:.3f}, {v[i][2]:.3f}]" for v in found.indices.values()
            ]
            table.add_row(name, *cells)
        wide_console(140).print(table)
        if found.chance == found.chance:
            click.echo(f"  noise floor (index of an unused random column): {found.chance:.3f}")


@campaign.command()
@_FOLDER
@click.option(
    "--metric", default="safe", show_default=True,
    help="Result column that defines failures. In a true/false column, false is a failure; a "
    "column of numbers needs --above or --below.",
)  # fmt: skip
@click.option(
    "--above",
    type=float,
    default=None,
    help="Limit of the metric above which a flight counts as a failure.",
)
@click.option(
    "--below",
    type=float,
    default=None,
    help="Limit of the metric below which a flight counts as a failure.",
)
def rare(folder: Path, metric: str, above: float | None, below: float | None) -> None:
    """Estimate the failure probability of rare-event campaigns.

    The campaign in FOLDER must use method "importance" or "subset". The estimate holds for the
    dispersions in the campaign file and has a 95 % interval. "Equivalent flights" is the number of
    plain Monte Carlo flights with the same precision. Method "subset" also prints its levels.
    """
    from rich.table import Table

    from lunarsim.campaign.rare_failures import estimate_failure_shares
    from lunarsim.campaign.results import load_results

    table = Table(
        "Arm", "Flights", "Failures", "No outcome", "Failure probability [95 % CI]",
        "Equivalent flights",
    )  # fmt: skip
    found = load_results(folder)
    for s in estimate_failure_shares(found, metric, above, below):
        interval = f"{s.value:.3g} [{s.low:.3g}, {s.high:.3g}]" + (
            " (rough)" if s.is_approximate else ""
        )
        interval = interval if s.value == s.value else "-"
        worth = (
            f"{s.equivalent_flights:.3g}" if s.equivalent_flights == s.equivalent_flights else "-"
        )
        table.add_row(
            s.arm, str(s.flights), str(s.failures), str(s.without_outcome), interval, worth
        )
    wide_console(140).print(table)
    if found.is_subset:
        _print_levels(found)


def _print_levels(results: Results) -> None:
    """Print the table of the failure levels of a subset simulation."""
    from rich.table import Table

    from lunarsim.campaign.rare_failures import completion_remark, level_table_rows, load_chains

    chains = load_chains(results)
    level_rows = level_table_rows(chains)
    if level_rows:
        table = Table(*level_rows[0])
        for level in level_rows:
            table.add_row(*level.values())
        wide_console(140).print(table)
    if remark := completion_remark(chains):
        click.echo(remark)


@campaign.command()
@click.argument("first", type=PATH, metavar="A")
@click.argument("second", type=PATH, metavar="B")
@click.option(
    "--margin", type=FloatRange(0.0, 1.0, min_open=True), default=0.05, show_default=True,
    help="Maximum difference between the success fractions of A and B that counts as equivalent.",
)  # fmt: skip
@click.option(
    "--metric",
    default="safe",
    show_default=True,
    help="Result column to compare. It must have the values true (success) and false.",
)
@click.option(
    "--require-equivalent", is_flag=True,
    help="Exit with code 1 also if an arm of B is not shown to be equivalent to the same arm of A.",
)  # fmt: skip
def diff(first: Path, second: Path, margin: float, metric: str, require_equivalent: bool) -> None:
    """Compare the results of campaigns A and B flight by flight.

    A and B are results folders. An arm is one variant of a campaign. The exit code is 1 if an arm
    of B is worse. "Worse" means that McNemar's exact test is significant at 5 % after Holm's
    correction over all arms. "Equivalent" means that the 90 % interval of the difference lies
    within the margin (two one-sided tests at 5 %).
    """
    from rich.table import Table

    from lunarsim.campaign.analysis import compare_campaigns as compare
    from lunarsim.campaign.manifest import first_difference
    from lunarsim.campaign.results import load_results

    a, b = load_results(first), load_results(second)
    verdicts = compare(a, b, margin, metric)
    other = first_difference(a.manifest["identity"], b.manifest["identity"])
    if other is not None:
        click.echo(
            f"note: the specs of A and B differ: {other[0]} is {other[1]!r} and {other[2]!r}",
            err=True,
        )
    table = Table()
    for heading in ("Arm", "Pairs", f"{metric}: B - A [90 % CI]", "p", "p (Holm)", "Result"):
        table.add_column(heading, justify="left" if heading in ("Arm", "Result") else "right")
    for v in verdicts:
        d = v.difference
        word = "worse" if v.worse else ("equivalent" if v.equivalent else "inconclusive")
        table.add_row(
            d.first, str(d.pairs), f"{d.value:+.3f} [{d.low:+.3f}, {d.high:+.3f}]", f"{d.p:.3g}",
            f"{d.corrected:.3g}", word,
        )  # fmt: skip
    wide_console(140).print(table)
    if any(v.worse or (require_equivalent and not v.equivalent) for v in verdicts):
        sys.exit(1)


@click.command()
@_FOLDER
@allow_options
@click.option(
    "--flight",
    required=True,
    help="ID of the flight: flight index, hyphen and number of the variant (arm), for example "
    "12-0.",
)
@click.option(
    "--out",
    type=PATH,
    default=None,
    help="New folder for the flight record and the figures. Default: no files are written.",
)
def replay(folder: Path, flight: str, out: Path | None) -> None:
    """Repeat a flight of a campaign and compare its results.

    The exit code is 1 if the repeated flight differs from its row in FOLDER.
    """
    from rich.table import Table

    from lunarsim.campaign.flight_execution import replay as fly

    if out is not None:
        check_folder(out)
    found = fly(folder, flight)
    if out is not None:
        # Save before printing: the reader of a pipe may close it early.
        with remove_contents_on_error(out):
            found.flight.save(out)
    table = Table(show_header=False, box=None)
    for name, value in found.row.items():
        table.add_row(name, _format_cell(value))
    wide_console(120).print(table)
    if found.recorded is None:
        click.echo("the campaign has no result of this flight yet")
    elif found.differences is None:
        click.echo(f"the campaign recorded no outcome: {found.recorded['error']}")
    elif not found.differences:
        click.echo("identical to the recorded result")
    for name, old, new in found.differences or []:
        click.echo(f"{name}: recorded {_format_cell(old)}, now {_format_cell(new)}")
    if out is not None:
        from lunarsim.viz import draw_flight

        with add_to_interrupt_message(f"{out} has the flight record, but not all figures"):
            draw_flight(found.flight, found.simulation.world, found.simulation.truth, out)
        click.echo(f"flight record and figures are in {out}")
    if found.differences:
        sys.exit(1)


def _format_cell(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
