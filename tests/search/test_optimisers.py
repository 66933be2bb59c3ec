"""Searches on functions with a known minimum."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.search import (
    ChoiceRange,
    ContinuousRange,
    IntegerRange,
    SearchSpace,
    differential_evolution_search,
    random_search,
)

SPACE = SearchSpace({
    **{f"x{n}": ContinuousRange(-2.0, 2.0, 0.0) for n in range(4)},
    "scale": ContinuousRange(0.01, 1.0, 1.0, is_logarithmic=True),
    "count": IntegerRange(0, 10, 5),
    "kind": ChoiceRange(("a", "b", "c"), "a"),
})  # fmt: skip


def bowl(values):
    """Return a score with the minimum 0 at x = 1, scale = 0.1, count = 8 and kind = "b"."""
    return (
        sum((values[f"x{n}"] - 1.0) ** 2 for n in range(4))
        + math.log10(values["scale"] / 0.1) ** 2
        + 0.05 * (values["count"] - 8) ** 2
        + (values["kind"] != "b")
    )


def searched(search, seed, count=400, score=bowl):
    calls = []

    def batch_score(batch, first):
        calls.append((first, len(batch)))
        return [score(values) for values in batch]

    return search(SPACE, batch_score, count, np.random.default_rng(seed)), calls


@pytest.mark.parametrize("seed", range(3))
def test_the_evolution_finds_the_known_minimum(seed):
    done, _ = searched(differential_evolution_search, seed)
    best = min(done, key=lambda e: e.score)
    assert best.score < 0.02
    assert best.values["kind"] == "b" and abs(best.values["count"] - 8) <= 1
    assert best.values["x0"] == pytest.approx(1.0, abs=0.15)
    baseline, _ = searched(random_search, seed)
    assert min(e.score for e in baseline) > 10.0 * best.score


@pytest.mark.parametrize("search", [differential_evolution_search, random_search])
@pytest.mark.parametrize("count", [40, 57])
def test_the_number_of_evaluations_is_exact(search, count):
    done, calls = searched(search, 1, count)
    assert len(done) == count
    assert sum(size for _, size in calls) == count
    # Batches are numbered on.
    assert [first for first, _ in calls] == np.cumsum([0, *(n for _, n in calls[:-1])]).tolist()
    assert [e.score for e in done] == [bowl(e.values) for e in done]


def test_a_search_of_one_seed_repeats_itself():
    first, second, other = (searched(differential_evolution_search, s, 60)[0] for s in (1, 1, 2))
    assert first == second != other


@pytest.mark.parametrize("value", [1.0, math.inf])
def test_constant_and_infinite_scores_use_the_complete_budget(value):
    done, _ = searched(differential_evolution_search, 0, 60, lambda _: value)
    assert len(done) == 60


def test_the_best_points_of_the_design_start_the_evolution_again():
    done, calls = searched(differential_evolution_search, 5, 100)
    design, first = done[:25], done[25:35]
    assert calls[:2] == [(0, 25), (25, 10)]
    best = sorted(design, key=lambda e: e.score)[:10]
    assert [e.values for e in first] == [e.values for e in best]


@pytest.mark.parametrize(
    ("count", "population", "message"),
    [
        (0, 10, "evaluations: must be 1 or more"),
        (29, 10, "evaluations: must be at least 30"),
        (100, 4, "population: must be at least 5"),
    ],
)
def test_unusable_settings_are_refused(count, population, message):
    with pytest.raises(InputError, match=message):
        differential_evolution_search(
            SPACE, lambda batch, _: [0.0] * len(batch), count, np.random.default_rng(0), population
        )


@pytest.mark.parametrize("bad_from", [0, 30])
def test_a_score_that_is_no_number_is_refused(bad_from):
    with pytest.raises(InputError, match="score: must be a number"):
        differential_evolution_search(
            SPACE, lambda batch, first: [math.nan if first >= bad_from else 1.0] * len(batch),
            60, np.random.default_rng(0),
        )  # fmt: skip
