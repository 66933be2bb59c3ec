"""Draw reliability diagrams: predicted probabilities and observed frequencies."""

from __future__ import annotations

from typing import Any

from lunarsim.evaluation.reliability import bin_frequencies
from lunarsim.typing import Array


def plot_reliability(axes: Any, table: Array, min_count: int = 50, **style: Any) -> None:
    """Plot observed frequency over predicted probability from a reliability table.

    Only bins with at least `min_count` samples are drawn.

    Parameters
    ----------
    axes
        Axes to draw on.
    table
        Count, sum of probabilities and number of events (bins, 3), as from `reliability`.
    min_count
        Minimum number of cells of a bin that is drawn.
    style
        Options of the line, for instance colour and label.
    """
    given = {"marker": "o", "ms": 4, **style}
    axes.plot(*bin_frequencies(table[table[:, 0] >= min_count]), **given)


def plot_ideal(axes: Any, **style: Any) -> None:
    """Plot the diagonal of a reliability diagram, which is perfect reliability."""
    axes.plot([0, 1], [0, 1], **{"color": "#999999", "lw": 1, **style})
