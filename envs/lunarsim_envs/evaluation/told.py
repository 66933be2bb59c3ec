"""The tables that `lunarsim evaluate` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lunarsim.evaluation.comparisons import Difference
from lunarsim_envs.evaluation.results import AgentFigures

if TYPE_CHECKING:
    from rich.table import Table

_UNITS = {"score": "score", "safe": "share safe", "propellant_kg": "propellant, kg"}


def _table(headings: tuple[str, ...]) -> Table:
    from rich.table import Table  # noqa: PLC0415  (a library does not draw)

    table = Table()
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 else "right", no_wrap=i == 0)
    return table


def agents_table(found: list[AgentFigures], within: float) -> Table:
    """Return a row an agent."""
    table = _table(
        ("agent", "episodes", "landed safe [95 %]", f"safe within {within:g} m", "score",
         "propellant kg\nof safe", "miss m\nof safe", "steps")
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
    """Return a difference with its interval; without it where there is none, of one pair."""
    told = f"{d.value:+.3f}"
    return told if np.isnan(d.low) else f"{told} [{d.low:+.3f}, {d.high:+.3f}]"


def differences_table(between: dict[str, list[Difference]]) -> Table:
    """Return a row a pair of agents and metric."""
    table = _table(
        ("second less first, same episodes", "of", "pairs", "difference [95 %]", "p, corrected")
    )
    for metric, many in between.items():
        for d in many:
            table.add_row(
                f"{d.second} - {d.first}", _UNITS[metric], str(d.pairs),
                _interval(d), "-" if np.isnan(d.corrected) else f"{d.corrected:.3g}",
            )  # fmt: skip
    return table
