"""Search the minimum of a score: differential evolution and random search.

Both ask for the scores of a batch of points at a time, so that the points can be evaluated in
parallel. The points depend only on the random generator and on the scores. A search whose scores
were stored is therefore continued by repeating it with the stored scores.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from lunarsim.errors import InputError
from lunarsim.search.space import SearchSpace
from lunarsim.typing import Array

# Differential evolution needs at least five points.
_MIN_POPULATION = 5
# Fraction of the evaluations that sample the space before the evolution starts.
_DESIGN_FRACTION = 0.25
# Score and index of values: points of a batch are numbered on from those before.
BatchScore = Callable[[Sequence[Mapping[str, Any]], int], Sequence[float]]


@dataclass(frozen=True)
class Evaluation:
    """Values that a search has evaluated, and their score.

    Attributes
    ----------
    values
        Value of each key.
    score
        Score; lower is worse for what is tested. Infinity: not usable.
    """

    values: Mapping[str, Any]
    score: float


class _Recorder:
    """Evaluates points of the unit cube in batches, up to a number of evaluations."""

    def __init__(self, space: SearchSpace, score: BatchScore, budget: int) -> None:
        self._space, self._score, self._budget = space, score, budget
        self.done: list[Evaluation] = []

    def __call__(self, points: Iterable[Array]) -> list[float]:
        """Return the scores of points; those beyond the budget have the score infinity."""
        wanted = [self._space.values(point) for point in points]
        batch = wanted[: self._budget - len(self.done)]
        scores = [float(s) for s in self._score(batch, len(self.done))] if batch else []
        for values, score in zip(batch, scores, strict=True):
            if math.isnan(score):
                raise InputError("score", score, f"must be a number, because it ranks {values}")
            self.done.append(Evaluation(values, score))
        return scores + [math.inf] * (len(wanted) - len(batch))


def random_search(
    space: SearchSpace, score: BatchScore, evaluations: int, rng: np.random.Generator
) -> list[Evaluation]:
    """Evaluate independent random points of a space.

    Parameters
    ----------
    space
        Admissible values.
    score
        Function of a batch of values and of the number of evaluations before it; it returns a
        score for each.
    evaluations
        Number of points.
    rng
        Source of the points.

    Returns
    -------
    list
        All points in the order of their evaluation.
    """
    _check_evaluations(evaluations)
    recorder = _Recorder(space, score, evaluations)
    recorder(rng.random((evaluations, len(space.ranges))))
    return recorder.done


def differential_evolution_search(
    space: SearchSpace,
    score: BatchScore,
    evaluations: int,
    rng: np.random.Generator,
    population: int = 10,
) -> list[Evaluation]:
    """Search the minimum of a score by differential evolution (Storn and Price 1997).

    The first quarter of the evaluations is a Latin hypercube. Its best points are the first
    population. They are evaluated again, because a low score of a random case can be chance.

    The method is `scipy.optimize.differential_evolution` with deferred updates: a generation is
    one batch.

    Parameters
    ----------
    space, score, evaluations, rng
        As for `random_search`; `rng` is the source of all points.
    population
        Number of points of a generation.

    Returns
    -------
    list
        All points in the order of their evaluation.

    Raises
    ------
    InputError
        If the population is too small, there are too few evaluations for two generations, or a
        score is NaN.
    """
    _check_evaluations(evaluations)
    if population < _MIN_POPULATION:
        raise InputError("population", population, f"must be at least {_MIN_POPULATION}")
    size = max(population, round(_DESIGN_FRACTION * evaluations))
    if evaluations < size + 2 * population:
        raise InputError(
            "evaluations", evaluations,
            f"must be at least {size + 2 * population} for two generations of {population} points",
            "Use fewer points in a generation.",
        )  # fmt: skip
    recorder = _Recorder(space, score, evaluations)
    design = qmc.LatinHypercube(len(space.ranges), rng=rng).random(size)
    best = np.argsort(recorder(design), kind="stable")[:population]
    generations = math.ceil((evaluations - size) / population)
    try:
        differential_evolution(
            _unused, [(0.0, 1.0)] * len(space.ranges), strategy="currenttobest1bin",
            init=design[best], maxiter=generations - 1, mutation=(0.4, 0.9), recombination=0.7,
            # Never converged: the complete budget is used.
            tol=0.0, atol=-1.0, polish=False, updating="deferred",
            workers=lambda _, points: recorder(points), rng=rng,
        )  # fmt: skip
    except RuntimeError as error:
        # SciPy wraps errors of the evaluation.
        raise (error.__cause__ if isinstance(error.__cause__, InputError) else error) from None
    return recorder.done


def _unused(point: Array) -> float:
    raise AssertionError(f"points are evaluated in batches, not singly: {point}")


def _check_evaluations(evaluations: int) -> None:
    if evaluations < 1:
        raise InputError("evaluations", evaluations, "must be 1 or more")
