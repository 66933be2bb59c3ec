"""Evaluate a hazard probability map by classes (shadow EKF paper, V.B and V.C)."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.evaluation.statistics import Proportion
from lunarsim.typing import BoolArray

# Bin edges of the reliability diagram; most cells of a map have small probabilities.
RELIABILITY_EDGES = np.array(
    [0.0, 1e-4, 3e-4, 1e-3, 2.5e-3, 5e-3, 1e-2, 3e-2, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0]
)


@dataclass(frozen=True)
class Classification:
    """Confusion counts of a hazard map whose cells are clear, occupied or unknown.

    Rates are NaN where the denominator is 0.

    Attributes
    ----------
    cells, clear, occupied
        Number of cells of the map; truly clear; truly occupied by a hazard.
    called_clear, called_occupied
        Number of cells classified clear, and classified occupied; the other cells are unknown.
    clear_right, clear_wrong
        Number of cells classified clear that are truly clear, and that are truly occupied.
    occupied_right
        Number of cells classified occupied that are truly occupied.
    """

    cells: int
    clear: int
    occupied: int
    called_clear: int
    called_occupied: int
    clear_right: int
    clear_wrong: int
    occupied_right: int

    def __add__(self, other: Classification) -> Classification:
        """Add the counts of this map and another map."""
        mine, more = self.counts(), other.counts()
        return Classification(**{name: mine[name] + more[name] for name in mine})

    @property
    def rates(self) -> dict[str, float]:
        """Rates of the shadow EKF paper as fractions, by name; NaN without such cells.

        ``clear_recall`` is the fraction of truly clear cells that are classified clear,
        ``occupied_called_clear`` that of truly occupied cells classified clear, ``clear_false``
        that of cells classified clear that are occupied, and ``occupied_correct`` that of cells
        classified occupied that are occupied. ``called_clear`` and ``unknown`` are fractions of all
        cells.
        """
        return {
            "clear_recall": _share(self.clear_right, self.clear),
            "occupied_called_clear": _share(self.clear_wrong, self.occupied),
            "clear_false": _share(self.clear_wrong, self.called_clear),
            "occupied_correct": _share(self.occupied_right, self.called_occupied),
            "called_clear": _share(self.called_clear, self.cells),
            "unknown": _share(self.cells - self.called_clear - self.called_occupied, self.cells),
        }

    def counts(self) -> dict[str, int]:
        """Return the counts by name."""
        return asdict(self)


def _share(part: int, total: int) -> float:
    return Proportion(part, total).value


def classify(
    probability: NDArray[np.float32],
    occupied: BoolArray,
    clear_below: float = 0.0025,
    occupied_above: float = 0.8,
    *,
    observed: BoolArray,
) -> Classification:
    """Classify cells by their hazard probability, and count agreement with the truth.

    `probability`, `occupied` (the truth) and `observed` are (rows, cols).

    A cell is classified clear if it was observed and its probability is below `clear_below`: where
    few rocks are expected, the probability is small before any image. A cell is classified occupied
    if its probability is above `occupied_above`.
    """
    called_clear = observed & (probability < clear_below)
    called_occupied = probability > occupied_above
    return Classification(
        cells=probability.size,
        clear=int((~occupied).sum()),
        occupied=int(occupied.sum()),
        called_clear=int(called_clear.sum()),
        called_occupied=int(called_occupied.sum()),
        clear_right=int((called_clear & ~occupied).sum()),
        clear_wrong=int((called_clear & occupied).sum()),
        occupied_right=int((called_occupied & occupied).sum()),
    )
