"""Whether what is said to happen with a probability happens that often."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Finer at either end, where policies decide.
EDGES = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0])


def reliability(probability: ArrayLike, happened: ArrayLike, edges: ArrayLike = EDGES) -> Array:
    """Return number, sum of probabilities and number that happened for each bin (bins, 3).

    Tables of the same edges add up.

    Parameters
    ----------
    probability, happened
        Of the same shape.
    edges
        Of the bins, rising; what lies beyond counts to the outermost.
    """
    edges = np.asarray(edges, dtype=np.float64)
    p = np.asarray(probability, dtype=np.float64).ravel()
    bins = np.clip(np.digitize(p, edges) - 1, 0, len(edges) - 2)
    return np.column_stack(
        [
            np.bincount(bins, weights=w, minlength=len(edges) - 1)
            for w in (None, p, np.asarray(happened).ravel())
        ]
    )


def frequencies(table: Array) -> tuple[Array, Array]:
    """Return mean probability and share that happened of each bin (bins,); NaN where empty."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return table[:, 1] / table[:, 0], table[:, 2] / table[:, 0]


def brier_score(probability: ArrayLike, happened: ArrayLike) -> float:
    """Return the mean square of the probabilities less what happened (0 or 1)."""
    p = np.asarray(probability, dtype=np.float64)
    return float(np.mean((p - np.asarray(happened, dtype=np.float64)) ** 2))


def brier_skill(probability: ArrayLike, happened: ArrayLike) -> float:
    """Return the Brier skill over the base rate; NaN where all is alike."""
    base = float(np.mean(np.asarray(happened, dtype=np.float64)))
    if base in (0.0, 1.0):
        return float("nan")
    return 1.0 - brier_score(probability, happened) / (base * (1.0 - base))


def calibration_error(table: Array) -> float:
    """Return the mean distance of the two, weighted by number (ECE); NaN of an empty table."""
    count = table[:, 0].sum()
    return float(np.abs(table[:, 1] - table[:, 2]).sum() / count) if count else float("nan")


def calibration_error_by_chance(
    probability: ArrayLike,
    rng: np.random.Generator,
    *,
    quantile: float = 0.95,
    draws: int = 400,
    edges: ArrayLike = EDGES,
) -> float:
    """Return the error that frequencies told rightly stay under this often; NaN of none.

    Few sites leave a calibration error by chance alone: what happens is drawn with the
    probabilities (n,) themselves, so often, each independent of all others.
    """
    p = np.asarray(probability, dtype=np.float64).ravel()
    if not len(p):
        return float("nan")
    found = [calibration_error(reliability(p, rng.random(len(p)) < p, edges)) for _ in range(draws)]
    return float(np.quantile(found, quantile))
