"""Shrinking of findings to the keys that they need."""

from __future__ import annotations

import pytest

from lunarsim.search import ChoiceRange, ContinuousRange, IntegerRange, SearchSpace, shrink

SPACE = SearchSpace({
    **{f"x{n}": ContinuousRange(0.0, 1.0, 0.0) for n in range(6)},
    "legs": IntegerRange(0, 16, 0),
    "kind": ChoiceRange(("a", "b"), "a"),
})  # fmt: skip
FOUND = {**{f"x{n}": 1.0 for n in range(6)}, "legs": 16, "kind": "b"}


def run(persists):
    """Return the shrunk values and all values that were tried."""
    tried = []

    def counted(values):
        tried.append(dict(values))
        return persists(values)

    return shrink(SPACE, FOUND, counted), tried


@pytest.mark.parametrize("pair", [("x0", "x1"), ("x1", "x5"), ("x3", "kind"), ("legs", "kind")])
def test_only_the_two_keys_that_matter_remain(pair):
    shrunk, tried = run(lambda v: all(v[key] != SPACE.nominal()[key] for key in pair))
    changed = {key for key, value in shrunk.items() if value != SPACE.nominal()[key]}
    assert changed == set(pair)
    assert len(tried) < 30
    # Nothing is tried twice.
    assert len({repr(sorted(v.items())) for v in tried}) == len(tried)


def test_the_remaining_values_are_as_close_to_nominal_as_the_bisection_resolves():
    shrunk, _ = run(lambda v: v["x2"] >= 0.3 and v["legs"] >= 5)
    assert 0.3 <= shrunk["x2"] <= 0.3 + 1.0 / 8.0
    assert 5 <= shrunk["legs"] <= 5 + 16 / 8


def test_a_key_is_nominal_if_another_key_replaces_it():
    shrunk, _ = run(lambda v: v["x0"] == 1.0 or v["x4"] == 1.0)
    assert sum(shrunk[f"x{n}"] != 0.0 for n in range(6)) == 1


def test_a_key_that_only_later_keys_make_needed_is_removed():
    # x0 is needed as long as x5 is not nominal.
    shrunk, _ = run(lambda v: v["kind"] == "b" and (v["x5"] == 0.0 or v["x0"] == 1.0))
    assert {k for k, v in shrunk.items() if v != SPACE.nominal()[k]} == {"kind"}


def test_keys_are_checked_until_none_can_be_removed():
    # x0 is needed as long as x3 is not nominal, and x3 as long as x5 is not.
    shrunk, _ = run(
        lambda v: (
            v["kind"] == "b"
            and (v["x5"] == 0.0 or v["x3"] == 1.0)
            and (v["x3"] == 0.0 or v["x0"] == 1.0)
        )
    )
    assert {k for k, v in shrunk.items() if v != SPACE.nominal()[k]} == {"kind"}


def test_a_failure_that_needs_no_key_or_every_key():
    assert run(lambda _: True)[0] == SPACE.nominal()
    assert run(lambda v: v == FOUND)[0] == FOUND
