"""Stated probabilities beside found frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.evaluation.reliability import frequencies


def plot_reliability(axes: Any, table: NDArray[np.float64], least: int = 50, **style: Any) -> None:
    """Draw the bins (see `reliability`) that hold at least so many cells.

    Parameters
    ----------
    axes
        Where.
    table
        Number, sum of probabilities and number that happened (bins, 3).
    least
        Fewest cells of a bin that is shown.
    style
        Colour, label and so on.
    """
    axes.plot(*frequencies(table[table[:, 0] >= least]), "o-", **{"ms": 4, **style})


def plot_ideal(axes: Any, **style: Any) -> None:
    """Draw the line on which what is said to happen happens that often."""
    axes.plot([0, 1], [0, 1], **{"color": "#999999", "lw": 1, **style})
