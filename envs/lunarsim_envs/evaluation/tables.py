"""Format the tables that `lunarsim evaluate` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lunarsim.evaluation.comparisons import Difference
from lunarsim_envs.evaluation.results import AgentMetrics

if TYPE_CHECKING:
    from rich.table import Table

_UNITS = {"score": "Score", "safe": "Landed safely", "propellant_kg": "Propellant (kg)"}


def _table(headings: tuple[str, ...]) -> Table:
    from rich.table import Table  # noqa: PLC0415  (only needed for printing)

    table = Table()
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 else "right", no_wrap=i == 0)
    return table


def agents_table(metrics: list[AgentMetrics], max_distance: float) -> Table:
    """Return the table of metrics that `lunarsim evaluate` prints, one row per agent.

    `max_distance` is the maximum distance of an on-target landing from the target, m. Columns
    without any value, such as the miss distance in ``Retarget-v1``, are omitted.
    """
    headings = (
        "Agent", "Episodes", "Landed safely [95 % CI]", f"Safe within {max_distance:g} m",
        "Score, mean", "Propellant (kg)\nsafe landings", "Miss (m)\nsafe landings", "Steps,\nmean",
    )  # fmt: skip
    rows = [
        (
            agent.name, str(agent.episodes),
            "-" if agent.safe is None else str(agent.safe),
            "-" if agent.on_target is None else str(agent.on_target),
            agent.score.text(3), agent.propellant.text(1), agent.miss.text(1),
            f"{agent.steps.value:.0f}",
        )
        for agent in metrics
    ]  # fmt: skip
    shown = [k for k in range(len(headings)) if any(row[k] != "-" for row in rows)]
    table = _table(tuple(headings[k] for k in shown))
    for row in rows:
        table.add_row(*(row[k] for k in shown))
    return table


def _interval(difference: Difference) -> str:
    """Format a difference with its 95 % interval, if there is one."""
    value = f"{difference.value:+.3f}"
    return (
        value
        if np.isnan(difference.low)
        else f"{value} [{difference.low:+.3f}, {difference.high:+.3f}]"
    )


def differences_table(paired_differences: dict[str, list[Difference]]) -> Table:
    """Return the table of paired differences, one row per pair of agents and metric."""
    table = _table(
        (
            "Paired difference",
            "Metric",
            "Pairs",
            "Difference [95 % CI]\nof one pair",
            "p, all pairs\n(Holm)",
        )
    )
    for metric, many in paired_differences.items():
        for d in many:
            table.add_row(
                f"{d.second} - {d.first}", _UNITS[metric], str(d.pairs),
                _interval(d), "-" if np.isnan(d.corrected) else f"{d.corrected:.3g}",
            )  # fmt: skip
    return table
