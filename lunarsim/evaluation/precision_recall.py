"""Precision and recall of a safety probability at every threshold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from lunarsim.evaluation.map_quality import MapQuality
from lunarsim.typing import Array

# Symmetric about 0.5, finer towards 0 and 1.
THRESHOLDS: Array = ndtr(np.linspace(-6.0, 6.0, 241))


@dataclass(frozen=True)
class PrecisionRecall:
    """Numbers of safe and unsafe cells by predicted probability, for precision-recall.

    Attributes
    ----------
    unsafe, safe
        Number of unsafe and safe cells at or below the first threshold, between neighbouring
        thresholds, and above the last (thresholds + 1,).
    """

    unsafe: Array
    safe: Array

    @classmethod
    def of(cls, probability: ArrayLike, safe: ArrayLike) -> PrecisionRecall:
        """Count cells by predicted safety probability (n,) and true safety (n,)."""
        place = np.searchsorted(THRESHOLDS, np.asarray(probability))
        good = np.asarray(safe, np.bool_)
        counts = (np.bincount(place[own], minlength=len(THRESHOLDS) + 1) for own in (~good, good))
        return cls(*(np.asarray(n, np.float64) for n in counts))

    def __add__(self, other: PrecisionRecall) -> PrecisionRecall:
        """Add the counts of this map and another map."""
        return PrecisionRecall(self.unsafe + other.unsafe, self.safe + other.safe)

    def curve(self) -> tuple[Array, Array]:
        """Return the precision-recall curve: precision (n,) and recall (n,).

        The order is that of decreasing thresholds; thresholds above all cells are omitted.
        """
        wrong, hits = np.cumsum(self.unsafe[::-1]), np.cumsum(self.safe[::-1])
        used = hits + wrong > 0
        return hits[used] / (hits + wrong)[used], hits[used] / max(hits[-1], 1.0)

    def at_half(self) -> MapQuality:
        """Return the confusion counts at the threshold p > 0.5."""
        half = len(THRESHOLDS) // 2 + 1
        numbers = self.safe[half:], self.unsafe[half:], self.safe[:half], self.unsafe[:half]
        return MapQuality(*(int(n.sum()) for n in numbers))

    def precision_at(self, recall: float) -> float:
        """Return the precision at the highest threshold that reaches a recall.

        If no threshold reaches the recall, the lowest threshold is used.
        """
        precision, found = self.curve()
        return float(precision[min(int(np.searchsorted(found, recall)), len(found) - 1)])

    def recall_at(self, precision: float) -> float:
        """Return the maximum recall of thresholds with at least a given precision.

        The result is 0 if no threshold has this precision.
        """
        own, found = self.curve()
        return float(found[own >= precision].max(initial=0.0))
