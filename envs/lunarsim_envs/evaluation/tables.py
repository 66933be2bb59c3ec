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


def agents_table(found: list[AgentMetrics], within: float) -> Table:
    """Return the table of metrics that `lunarsim evaluate` prints, one row per agent.

    `within` is the distance of an on-target landing from the target, m.
    """
    table = _table(
        ("Agent", "Episodes", "Landed safely [95 % CI]", f"Safe within {within:g} m", "Score, mean",
         "Propellant (kg)\nsafe landings", "Miss (m)\nsafe landings", "Steps,\nmean")
    )  # fmt: skip
    for agent in found:
        table.add_row(
            agent.name, str(agent.episodes),
            "-" if agent.safe is None else str(agent.safe),
            "-" if agent.on_target is None else str(agent.on_target),
            agent.score.text(3), agent.propellant.text(1), agent.miss.text(1),
            f"{agent.steps.value:.0f}",
        )  # fmt: skip
    return table


def _interval(d: Difference) -> str:
    """Format a difference with its 95 % interval, if there is one."""
    value = f"{d.value:+.3f}"
    return value if np.isnan(d.low) else f"{value} [{d.low:+.3f}, {d.high:+.3f}]"


def differences_table(between: dict[str, list[Difference]]) -> Table:
    """Return the table of paired differences, one row per pair of agents and metric."""
    table = _table(("Paired difference", "Metric", "Pairs", "Difference [95 % CI]", "p (Holm)"))
    for metric, many in between.items():
        for d in many:
            table.add_row(
                f"{d.second} - {d.first}", _UNITS[metric], str(d.pairs),
                _interval(d), "-" if np.isnan(d.corrected) else f"{d.corrected:.3g}",
            )  # fmt: skip
    return table
