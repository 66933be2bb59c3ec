"""The search for the worst case, from the first evaluation to shrunk findings."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.search import ChoiceRange, ContinuousRange, SearchSpace, WorstCaseSearch

SPACE = SearchSpace({
    **{f"x{n}": ContinuousRange(-1.0, 1.0, 0.0) for n in range(7)},
    "kind": ChoiceRange(("a", "b"), "a"),
})  # fmt: skip


def score(trial, noise=0.01):
    """Return a score with a deficit near x0 = 0.8 that is larger for the kind "b"."""
    values = trial.values
    deficit = 0.8 * math.exp(-((values["x0"] - 0.8) ** 2) / 0.05)
    if values["kind"] == "a":
        deficit *= 0.25
    return 1.0 - deficit + noise * np.random.default_rng(trial.draw).standard_normal()


def run(seed=1, score=score, **settings):
    trials = []

    def evaluate(batch):
        trials.extend(batch)
        return [score(trial) for trial in batch]

    search = WorstCaseSearch(SPACE, 0.95, 80, findings=2, **settings)
    return search.run(evaluate, seed), trials


def test_findings_name_the_two_keys_that_matter():
    found, _ = run()
    assert found
    for one in found:
        changed = {k for k, v in one.shrunk.items() if v != SPACE.nominal()[k]}
        assert changed == {"x0", "kind"} == set(one.scores_with_nominal)
        assert one.found_score < 0.3
        # Three quarters of the deficit remain.
        assert 0.95 - one.shrunk_score > 0.74 * (0.95 - one.found_score)
        assert all(s > one.shrunk_score + 0.1 for s in one.scores_with_nominal.values())


def test_both_methods_have_equal_budgets_and_meet_equal_draws():
    _, trials = run()
    draws = {m: [t.draw for t in trials if t.phase == m] for m in ("differential evolution",
             "random search")}  # fmt: skip
    assert list(draws.values()) == [list(range(80))] * 2


def test_findings_are_evaluated_on_draws_that_did_not_select_them():
    _, trials = run()
    used = {}
    for t in trials:
        used.setdefault(t.phase, set()).add(t.draw)
    phases = Counter(t.phase for t in trials)
    assert phases["found"] == phases["shrunk"] == 20
    reported = used["found"] | used["shrunk"] | used["one key nominal"]
    assert len(reported) == 10
    for phase in ("differential evolution", "random search", "screened", "shrinking"):
        assert not reported & used[phase]
    assert not used["screened"] & used["shrinking"]


def test_a_low_score_by_chance_is_no_finding():
    # Some single scores are far below the level; no mean is.
    found, trials = run(score=lambda t: 1.0 + 0.2 * np.random.default_rng(t.draw).standard_normal())
    assert min(np.random.default_rng(n).standard_normal() for n in range(80)) < -1.5
    assert found == [] or all(f.found_score > 0.8 for f in found)
    assert sum(t.phase == "screened" for t in trials) == 40


def test_a_score_at_the_level_gives_no_finding():
    assert run(score=lambda _: 0.95)[0] == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"draws": 0}, "draws: must be 1 or more"),
        ({"candidates": 0}, "candidates: must be 1 or more"),
        ({"kept_deficit": 0.0}, "kept_deficit: must be above 0"),
    ],
)
def test_unusable_settings_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        run(**settings)
