"""Reliability of probabilities: compare predicted with observed frequencies."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.typing import Array

# Bin edges, finer near 0 and 1, where policies have their thresholds.
EDGES = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0])


def reliability(probability: ArrayLike, happened: ArrayLike, edges: ArrayLike = EDGES) -> Array:
    """Return the reliability table of predicted probabilities by bin (bins, 3).

    The columns are count, sum of probabilities and number of events.

    Tables with the same edges can be added.

    Parameters
    ----------
    probability, happened
        Predicted probability, and whether the event happened; of the same shape.
    edges
        Increasing bin edges; values outside count in the outermost bins.
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


def bin_frequencies(table: Array) -> tuple[Array, Array]:
    """Return mean probability and observed frequency per bin (bins,); NaN if empty.

    `table` (bins, 3) is from `reliability`.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        return table[:, 1] / table[:, 0], table[:, 2] / table[:, 0]


def brier_score(probability: ArrayLike, happened: ArrayLike) -> float:
    """Return the Brier score: mean squared difference of probability and outcome.

    The outcome is 0 or 1.
    """
    p = np.asarray(probability, dtype=np.float64)
    return float(np.mean((p - np.asarray(happened, dtype=np.float64)) ** 2))


def brier_skill(probability: ArrayLike, happened: ArrayLike) -> float:
    """Return the Brier skill score of probabilities relative to the base rate.

    The base rate is the mean outcome; 1 is perfect, 0 is no better than the base rate.

    The result is NaN if all outcomes are equal.
    """
    base = float(np.mean(np.asarray(happened, dtype=np.float64)))
    if base in (0.0, 1.0):
        return float("nan")
    return 1.0 - brier_score(probability, happened) / (base * (1.0 - base))


def calibration_error(table: Array) -> float:
    """Return the expected calibration error (ECE) of a reliability table (bins, 3).

    It is NaN for an empty table.
    """
    count = table[:, 0].sum()
    return float(np.abs(table[:, 1] - table[:, 2]).sum() / count) if count else float("nan")


def chance_calibration_error(
    probability: ArrayLike,
    rng: np.random.Generator,
    *,
    quantile: float = 0.95,
    draws: int = 400,
    edges: ArrayLike = EDGES,
) -> float:
    """Return a quantile of the ECE that calibrated probabilities have by chance.

    ECE is the expected calibration error. Outcomes are sampled independently with the probabilities
    (n,), `draws` times. The result is NaN without probabilities.
    """
    p = np.asarray(probability, dtype=np.float64).ravel()
    if not len(p):
        return float("nan")
    found = [calibration_error(reliability(p, rng.random(len(p)) < p, edges)) for _ in range(draws)]
    return float(np.quantile(found, quantile))
