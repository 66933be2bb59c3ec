"""Define the commands `lunarsim vehicle ...`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lunarsim.cli_common import (
    PATH,
    ErrorReportingGroup,
    load_scenario,
    scenario_options,
    wide_console,
)
from lunarsim.errors import InputError, check_output

if TYPE_CHECKING:
    from rich.table import Table

    from lunarsim.evaluation.vehicle_check import VehicleCheck
    from lunarsim.scenario import Scenario


@click.group(cls=ErrorReportingGroup)
def vehicle() -> None:
    """Check the design of landers."""


@vehicle.command()
@scenario_options
@click.option(
    "--json", "file", type=PATH, default=None,
    help="JSON file to write, with all checks. Default: no file is written.",
)  # fmt: skip
@click.pass_context
def check(ctx: click.Context, scenario: Path, changes: tuple[str, ...], file: Path | None) -> None:
    """Check the lander of SCENARIO against its mission.

    SCENARIO is a TOML file or a name from `lunarsim scenario list`. The command computes what the
    mission requires of attitude control, engine, propellant, sensors and landing gear, and what the
    lander has. It uses formulas and the planned path; it does not fly. Each check is ok, marginal
    or violated. The exit code is 1 if a check is violated, otherwise 0.

    \b
    Example:
      lunarsim vehicle check instruments --set vehicle.thrust_min_n=2000
    """  # noqa: D301  (click wants the character itself)
    from lunarsim.atomic_files import atomic_write_text

    if file is not None:
        check_output("--json", file, ".json")
    found = _checked(load_scenario(scenario, changes, is_flown=False))
    if file is not None:
        text = json.dumps(found.as_dict(), indent=1, allow_nan=False)
        atomic_write_text(file, text + "\n")
    console = wide_console(150)
    console.print(_table(found))
    for line in findings(found):
        console.print(line, soft_wrap=True)
    count, near = (len(found.with_status(s)) for s in ("violated", "marginal"))
    console.print(f"{len(found.rows)} checks: {count} violated, {near} marginal")
    if file is not None:
        console.print(f"the checks are in {file}", soft_wrap=True)
    ctx.exit(1 if count else 0)


def findings(found: VehicleCheck) -> list[str]:
    """Return the violated and the marginal checks as text, and what was not checked."""
    rows = (*found.with_status("violated"), *found.with_status("marginal"))
    return [*(row.as_warning() for row in rows), *(f"note: {n}" for n in found.not_checked)]


def scenario_findings(scenario: Scenario) -> list[str]:
    """Return the findings about a scenario's lander as lines for `scenario check`.

    A lander that cannot be checked gives one line with the reason.
    """
    try:
        return [f"vehicle check: {line}" for line in findings(_checked(scenario))]
    except InputError as error:
        return [f"vehicle check: not done. {error}"]


def _checked(scenario: Scenario) -> VehicleCheck:
    """Return the checks of a scenario's lander; report the compilation of kernels."""
    from lunarsim.compile_progress import report_compilation
    from lunarsim.evaluation.vehicle_check import check_vehicle

    with report_compilation([]):
        return check_vehicle(scenario)


def _table(found: VehicleCheck) -> Table:
    """Return the table of checks that the command prints."""
    from rich.table import Table

    from lunarsim.evaluation.vehicle_check.rows import format_value

    table = Table(title=None)
    table.add_column("Check", no_wrap=True)
    table.add_column("Quantity")
    for heading in ("Required", "Available", "Margin (%)"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("Status", no_wrap=True)
    for row in found.rows:
        bound = ">=" if row.sense == "at least" else "<="
        unit = f" {row.unit}" if row.unit else ""
        cells: list[Any] = [
            row.name, row.quantity, f"{bound} {format_value(row.required)}{unit}",
            f"{format_value(row.available)}{unit}", f"{100.0 * row.margin:.0f}", row.status,
        ]  # fmt: skip
        table.add_row(*cells)
    return table
