"""Define the commands `lunarsim scenario ...` and `lunarsim parts`."""

from __future__ import annotations

from pathlib import Path

import click

from lunarsim.cli_common import PATH, ErrorReportingGroup, load_scenario, scenario_options
from lunarsim.errors import check_output


@click.command()
@click.argument("contract", required=False)
@click.option("--units", is_flag=True, help="List sensor units, their values and sources.")
def parts(contract: str | None, units: bool) -> None:
    """List the components that a scenario can select.

    A component (part) is what a scenario selects by its `kind`, for example a guidance law.
    CONTRACT limits the list to one type of component, for example guidance or policy. A table
    [sensors.NAME] with unit = "NAME" starts from the values of a unit that --units lists.
    """
    if units:
        from lunarsim.sensors.catalogue import catalogue_lines

        for line in catalogue_lines():
            click.echo(line)
        return
    from lunarsim.scenario.reference import parts_list

    for line in parts_list(contract):
        click.echo(line)


@click.group(cls=ErrorReportingGroup)
def scenario() -> None:
    """List, copy, check and document scenario files."""


@scenario.command()
@click.option("--markdown", is_flag=True, help="Print Markdown tables instead of plain text.")
def reference(markdown: bool) -> None:
    """Print default, unit and meaning of all scenario keys."""
    from lunarsim.scenario.reference import reference_text

    click.echo(reference_text(markdown=markdown))


@scenario.command()
@scenario_options
def check(scenario: Path, changes: tuple[str, ...]) -> None:
    """Check SCENARIO and print it with all default values.

    SCENARIO is a TOML file or a name from `lunarsim scenario list`. The command also reads the
    terrain files that the scenario names. It prints warnings, an estimate of memory and time, and
    the findings of `lunarsim vehicle check`, on stderr.
    """
    from lunarsim.cli_vehicle import scenario_findings
    from lunarsim.scenario.resource_estimate import estimate

    loaded = load_scenario(scenario, changes)
    loaded.check_files()
    # A flight makes the same check before it starts.
    loaded.check_hover()
    click.echo(f"estimate: {estimate(loaded)}", err=True)
    click.echo(loaded.to_toml(), nl=False)
    for line in scenario_findings(loaded):
        click.echo(line, err=True)


@scenario.command("list")
def list_command() -> None:
    """List the scenarios supplied with lunarsim."""
    from lunarsim.scenario import shipped

    for name, path in shipped.names().items():
        click.echo(f"{name:16s} {shipped.description_of(path)}".rstrip())


@scenario.command()
@click.argument("name")
def show(name: str) -> None:
    """Print the file of scenario NAME supplied with lunarsim."""
    from lunarsim.scenario import shipped

    click.echo(shipped.path_of(name).read_text(encoding="utf-8"), nl=False)


@scenario.command()
@click.argument("file", type=PATH)
def upgrade(file: Path) -> None:
    """Replace outdated names of keys in FILE by current names.

    FILE is a scenario or a campaign file. Only names change; comments and layout stay. The command
    prints each change.
    """
    from lunarsim.scenario.upgrade import upgrade_file

    changes = upgrade_file(file)
    for change in changes:
        click.echo(change)
    if not changes:
        click.echo(f"{file}: no key to rename")


@scenario.command()
@click.argument("name")
@click.option(
    "--out", type=PATH, default=None, show_default="NAME.toml in the working folder",
    help="TOML file to write. Data files of the scenario are copied to the same folder.",
)  # fmt: skip
def new(name: str, out: Path | None) -> None:
    """Copy supplied scenario NAME and its data files."""
    from lunarsim.scenario import shipped

    source = shipped.path_of(name)
    target = Path(source.name) if out is None else out
    check_output("--out", target, ".toml")
    for path in shipped.copy_to(name, target):
        click.echo(f"wrote {path}")
