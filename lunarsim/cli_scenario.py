"""The commands that show what scenarios hold: `lunarsim scenario ...`, `lunarsim parts`."""

from __future__ import annotations

from pathlib import Path

import click

from lunarsim.cli_common import PATH, Group, load_scenario, scenario_options
from lunarsim.errors import check_output


@click.command()
@click.argument("contract", required=False)
def parts(contract: str | None) -> None:
    """List the parts that scenarios choose from, or those of one CONTRACT."""
    from lunarsim.scenario.reference import parts_list

    for line in parts_list(contract):
        click.echo(line)


@click.group(cls=Group)
def scenario() -> None:
    """Scenario files: what they may hold, and whether one is right."""


@scenario.command()
@click.option("--markdown", is_flag=True, help="As Markdown tables; else as text.")
def reference(markdown: bool) -> None:
    """Print every key of a scenario file with unit, default, bounds and meaning."""
    from lunarsim.scenario.reference import reference_text

    click.echo(reference_text(markdown=markdown))


@scenario.command()
@scenario_options
def check(scenario: Path, changes: tuple[str, ...]) -> None:
    """Check SCENARIO (a file or a name of `scenario list`) and print it whole.

    Defaults are included, and files that it names are read. Warnings, and the memory and time
    that a flight takes, go to stderr.
    """
    from lunarsim.scenario.estimate import estimate

    loaded = load_scenario(scenario, changes)
    loaded.check_files()
    # As a flight does before it begins.
    loaded.vehicle.make().check_hover(loaded.gravity_m_s2)
    click.echo(f"estimate: {estimate(loaded)}", err=True)
    click.echo(loaded.to_toml(), nl=False)


@scenario.command("list")
def list_command() -> None:
    """List the scenarios that come with the package."""
    from lunarsim.scenario import shipped

    for name, path in shipped.names().items():
        click.echo(f"{name:16s} {shipped.description_of(path)}".rstrip())


@scenario.command()
@click.argument("name")
def show(name: str) -> None:
    """Print the file of the scenario NAME that comes with the package."""
    from lunarsim.scenario import shipped

    click.echo(shipped.path_of(name).read_text(encoding="utf-8"), nl=False)


@scenario.command()
@click.argument("name")
@click.option(
    "--out", type=PATH, default=None, show_default="NAME.toml here",
    help="TOML file to write; data goes beside it.",
)  # fmt: skip
def new(name: str, out: Path | None) -> None:
    """Write a copy of the scenario NAME, with the data that it needs, to start from."""
    from lunarsim.scenario import shipped

    source = shipped.path_of(name)
    target = Path(source.name) if out is None else out
    check_output("--out", target, ".toml")
    for path in shipped.copy_to(name, target):
        click.echo(f"wrote {path}")
