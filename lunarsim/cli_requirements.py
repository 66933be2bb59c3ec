"""Define the commands `lunarsim campaign verify` and `campaign threshold`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from lunarsim.cli_common import PATH, FloatRange, wide_console
from lunarsim.errors import check_output


@click.command()
@click.argument("folder", type=PATH)
@click.argument("requirements", type=PATH)
@click.option("--out", type=PATH, default=None, help="JSON file for the verification.")
def verify(folder: Path, requirements: Path, out: Path | None) -> None:
    """Verify requirements on the flights of a campaign.

    FOLDER has the results of a campaign. REQUIREMENTS is a TOML file with tables [[requirements]].
    The exit code is 1 unless all flights are flown and every requirement passes with its
    confidence.
    """
    from lunarsim.atomic_files import atomic_write_text
    from lunarsim.campaign.requirements import load_requirements, verification_rows
    from lunarsim.campaign.requirements import verify as verify_results
    from lunarsim.campaign.results import load_results

    if out is not None:
        check_output("--out", out, ".json")
    stated, results = load_requirements(requirements), load_results(folder)
    rows = verification_rows(verify_results(results, stated))
    _print(rows)
    is_complete = len(results.table) >= results.expected_rows
    if not is_complete:
        click.echo(
            f"note: the campaign is not complete: {len(results.table)} of {results.expected_rows} "
            "flights",
            err=True,
        )
    if out is not None:
        atomic_write_text(out, json.dumps({"campaign": results.manifest["name"], "rows": rows}))
    if not is_complete or any(row["status"] != "pass" for row in rows):
        sys.exit(1)


def _print(rows: list[dict[str, Any]]) -> None:
    """Print one line per requirement and arm; "-" is a value that does not exist."""
    from rich.table import Table

    table = Table(
        "Requirement", "Arm", "Limit", "Share (%)", "Confidence (%)", "Violations",
        "Share kept,\nlower bound (%)", "Percentile", "Tolerance bound", "Margin", "Result",
        "Flights\nmissing",
    )  # fmt: skip
    for row in rows:
        most, least = row["at_most"], row["at_least"]
        limit = f"<= {most:g}" if most is not None else "true" if least is None else f">= {least:g}"
        numbers = ("-" if row[k] is None else f"{row[k]:.4g}"
                   for k in ("percentile", "bound", "margin"))  # fmt: skip
        table.add_row(
            row["requirement"], row["arm"], f"{row['metric']} {limit}", f"{row['percentage']:.12g}",
            f"{row['confidence']:.12g}", f"{row['violations']} of {row['flights']}",
            f"{100.0 * row['fraction_bound']:.2f}", *numbers, row["status"],
            "> 10000000" if row["missing_flights"] is None else str(row["missing_flights"]),
        )  # fmt: skip
    wide_console(170).print(table)


_LEVEL = FloatRange(0.0, 1.0, min_open=True, max_open=True)


@click.command()
@click.argument("folder", type=PATH)
@click.option(
    "--max-risk",
    type=_LEVEL,
    default=0.05,
    show_default=True,
    help="Maximum probability that a flight uses its site and fails.",
)
@click.option(
    "--confidence",
    type=_LEVEL,
    default=0.95,
    show_default=True,
    help="Confidence of the bound, over the draw of the flights.",
)
@click.option(
    "--metric", default="safe", show_default=True,
    help="Result column with the values true (success) and false.",
)  # fmt: skip
def threshold(folder: Path, max_risk: float, confidence: float, metric: str) -> None:
    """Find the p_safe above which landings have a bounded risk.

    FOLDER has the results of a campaign whose flights are independent draws of the world. A flight
    uses its last site if the site's p_safe in the map reaches the threshold. The risk is the
    probability that a flight uses its site and fails; a flight that does not use its site, or
    aborts, is no failure. The bound includes the selection of the site. It holds for new flights of
    the same campaign, not for other terrains or landers. The exit code is 1 if an arm has no
    threshold.
    """
    from rich.table import Table

    from lunarsim.campaign.results import load_results
    from lunarsim.campaign.site_risk import site_risk_thresholds

    table = Table(
        "Arm", "Flights", "Threshold of p_safe", "Used", "Failed of these", "Risk, upper bound",
        "Flights needed\nwithout failure",
    )  # fmt: skip
    found = site_risk_thresholds(load_results(folder), metric, max_risk, confidence)
    for arm, r in found.items():
        exists = r.used > 0
        table.add_row(
            arm, str(r.worlds), f"{r.threshold:.4f}" if exists else "none",
            str(r.used), str(r.failed), f"{r.upper_bound:.4f}" if exists else "-",
            str(r.needed_worlds),
        )  # fmt: skip
    wide_console(120).print(table)
    if not all(r.used for r in found.values()):
        sys.exit(1)
