"""Search for the worst case, evaluate what it finds on fresh draws, and shrink it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError
from lunarsim.search.optimisers import (
    Evaluation,
    differential_evolution_search,
    random_search,
)
from lunarsim.search.shrinking import Values, changed_keys, shrink
from lunarsim.search.space import SearchSpace
from lunarsim.typing import Array

# Methods of the search, in the order of the results: the second is the baseline.
METHODS = ("differential evolution", "random search")
# Phases after the search: fresh draws of candidates, evaluations while shrinking, fresh draws of a
# finding as found and as shrunk, and of a shrunk finding with one key nominal.
SCREENED, SHRINKING, FOUND, SHRUNK, ONE_NOMINAL = (
    "screened", "shrinking", "found", "shrunk", "one key nominal",
)  # fmt: skip
# First draw of each phase. Phases with different numbers share no random numbers. Candidates are
# chosen on other draws than those that a finding is reported on.
_FIRST_DRAW = {
    SCREENED: 1_000_000, SHRINKING: 2_000_000, FOUND: 3_000_000, SHRUNK: 3_000_000,
    ONE_NOMINAL: 3_000_000,
}  # fmt: skip
# Values closer than this on average over the keys, in fractions of the ranges, are one finding.
_MIN_DISTANCE = 0.1


@dataclass(frozen=True)
class Trial:
    """One evaluation that a search asks for.

    Attributes
    ----------
    phase
        Name from `METHODS`, or of a phase after the search.
    values
        Value of each key.
    draw
        Number of the random draw. Equal numbers stand for equal noise and worlds.
    finding
        Number of the finding that it belongs to, from 0; -1 during the search.
    key
        In the phase "one key nominal": the key that is nominal.
    """

    phase: str
    values: Values
    draw: int
    finding: int = -1
    key: str = ""


@dataclass(frozen=True)
class Finding:
    """Values with a failure, before and after shrinking.

    Attributes
    ----------
    found, shrunk
        Value of each key.
    method
        Method that found the values, from `METHODS`.
    found_score, shrunk_score
        Mean score over fresh draws.
    scores_with_nominal
        Mean score over fresh draws if one key of the shrunk values is nominal, by key.
    """

    found: Values
    shrunk: Values
    method: str
    found_score: float
    shrunk_score: float
    scores_with_nominal: Mapping[str, float]


Evaluate = Callable[[Sequence[Trial]], Sequence[float]]


@dataclass(frozen=True)
class WorstCaseSearch:
    """Settings of a search for the worst case.

    Attributes
    ----------
    space
        Admissible values.
    level
        Score of a case without failure. A finding has a lower mean score.
    evaluations
        Evaluations of each method.
    findings
        Maximum number of findings.
    draws
        Fresh draws on which a finding is evaluated.
    candidates
        Candidates of each method that are evaluated on fresh draws to select the findings.
    screening_draws
        Fresh draws for each candidate, and for each step of shrinking.
    kept_deficit
        Fraction of `level` minus score that a shrunk finding retains.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    space: SearchSpace
    level: float
    evaluations: int = 200
    findings: int = 3
    draws: int = 10
    candidates: int = 5
    screening_draws: int = 4
    kept_deficit: float = 0.75

    def __post_init__(self) -> None:
        for name in ("findings", "draws", "candidates", "screening_draws"):
            if getattr(self, name) < 1:
                raise InputError(name, getattr(self, name), "must be 1 or more")
        if not 0.0 < self.kept_deficit <= 1.0:
            raise InputError(
                "kept_deficit", self.kept_deficit, "must be above 0 and not more than 1"
            )

    def run(self, evaluate: Evaluate, seed: int) -> list[Finding]:
        """Search, select findings on fresh draws, shrink them, and evaluate them again.

        Parameters
        ----------
        evaluate
            Function that returns the score of each trial of a batch.
        seed
            Seed of the points of both methods.

        Returns
        -------
        list
            Findings, lowest screened score first. It is empty if no candidate is below `level`.
        """
        candidates = []
        for index, method in enumerate(METHODS):
            rng = np.random.default_rng([seed, index])
            search = random_search if index else differential_evolution_search

            def score(batch: Sequence[Values], first: int, method: str = method) -> Sequence[float]:
                return evaluate([Trial(method, v, first + n) for n, v in enumerate(batch)])

            done = search(self.space, score, self.evaluations, rng)
            candidates += [(method, one) for one in self._distinct(done, self.candidates)]
        return [
            self._finding(evaluate, number, *one)
            for number, one in enumerate(self._selected(evaluate, candidates))
        ]

    def _distinct(self, evaluated: Sequence[Evaluation], count: int) -> list[Evaluation]:
        """Return the `count` lowest scores with values that differ, lowest first."""
        kept: list[Evaluation] = []
        for one in sorted(evaluated, key=lambda e: e.score):
            apart = (self.space.distance(one.values, k.values) for k in kept)
            if len(kept) < count and all(d >= _MIN_DISTANCE for d in apart):
                kept.append(one)
        return kept

    def _selected(
        self, evaluate: Evaluate, candidates: Sequence[tuple[str, Evaluation]]
    ) -> list[tuple[str, Values]]:
        """Return method and values of the candidates that are lowest on fresh draws."""
        trials = [
            trial
            for number, (_, one) in enumerate(candidates)
            for trial in self._trials(SCREENED, one.values, self.screening_draws, number)
        ]
        scores = np.reshape(evaluate(trials), (len(candidates), -1)).mean(axis=1)
        fresh = [Evaluation(one.values, s) for (_, one), s in zip(candidates, scores, strict=True)]
        methods = {id(e): method for e, (method, _) in zip(fresh, candidates, strict=True)}
        failed = [one for one in fresh if one.score < self.level]
        return [(methods[id(e)], e.values) for e in self._distinct(failed, self.findings)]

    def _finding(self, evaluate: Evaluate, number: int, method: str, found: Values) -> Finding:
        """Shrink one set of values, and evaluate it on fresh draws before and after."""

        def screen(values: Values) -> float:
            trials = self._trials(SHRINKING, values, self.screening_draws, number)
            return float(np.mean(evaluate(trials)))

        deficit = self.level - screen(found)
        limit = self.level - self.kept_deficit * deficit
        shrunk = found
        if deficit > 0.0:
            shrunk = shrink(self.space, found, lambda values: screen(values) <= limit)
        keys = changed_keys(self.space, shrunk)
        nominal = self.space.nominal()
        trials = [
            *self._trials(FOUND, found, self.draws, number),
            *self._trials(SHRUNK, shrunk, self.draws, number),
        ]
        for key in keys:
            values = {**shrunk, key: nominal[key]}
            trials += self._trials(ONE_NOMINAL, values, self.draws, number, key)
        scores: Array = np.reshape(evaluate(trials), (2 + len(keys), -1)).mean(axis=1)
        return Finding(
            found, shrunk, method, float(scores[0]), float(scores[1]),
            {key: float(s) for key, s in zip(keys, scores[2:], strict=True)},
        )  # fmt: skip

    @staticmethod
    def _trials(phase: str, values: Values, draws: int, finding: int, key: str = "") -> list[Trial]:
        """Return trials of one set of values on all draws of a phase."""
        first = _FIRST_DRAW[phase]
        return [Trial(phase, values, first + n, finding, key) for n in range(draws)]
