"""Ranges of a search: values, positions, and refusals."""

from __future__ import annotations

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.search import ChoiceRange, ContinuousRange, IntegerRange, SearchSpace

SPACE = SearchSpace({
    "length": ContinuousRange(1.0, 100.0, 10.0, is_logarithmic=True),
    "angle": ContinuousRange(-2.0, 2.0, 0.0),
    "legs": IntegerRange(3, 6, 4),
    "shape": ChoiceRange(("cube", "disc", "post"), "disc"),
})  # fmt: skip


def test_ends_and_middle_of_the_ranges():
    low, middle, high = (SPACE.values([u] * 4) for u in (0.0, 0.5, 1.0))
    assert low == {"length": 1.0, "angle": -2.0, "legs": 3, "shape": "cube"}
    assert middle == {"length": 10.0, "angle": 0.0, "legs": 5, "shape": "disc"}
    assert high == {"length": 100.0, "angle": 2.0, "legs": 6, "shape": "post"}


def test_positions_are_the_inverse_of_values():
    rng = np.random.default_rng(3)
    for point in rng.random((50, 4)):
        values = SPACE.values(point)
        again = SPACE.values(SPACE.position(values))
        assert again["legs"] == values["legs"] and again["shape"] == values["shape"]
        assert again["length"] == pytest.approx(values["length"], rel=2e-3)
        assert abs(SPACE.position(values)[:2] - point[:2]).max() < 1e-3


def test_positions_of_integers_and_choices_are_the_middle_of_their_intervals():
    legs, shape = SPACE.ranges["legs"], SPACE.ranges["shape"]
    assert [legs.position(n) for n in (3, 6)] == [0.125, 0.875]
    assert [shape.position(name) for name in ("cube", "post")] == pytest.approx([1 / 6, 5 / 6])


def test_integers_and_choices_are_equally_frequent():
    points = np.random.default_rng(0).random((6000, 4))
    values = [SPACE.values(point) for point in points]
    for key, levels in (("legs", (3, 4, 5, 6)), ("shape", ("cube", "disc", "post"))):
        for level in levels:
            count = sum(v[key] == level for v in values)
            expected = 6000 / len(levels)
            assert abs(count - expected) < 5.0 * expected**0.5


def test_values_move_toward_nominal():
    length, legs, shape = (SPACE.ranges[key] for key in ("length", "legs", "shape"))
    assert [length.toward_nominal(100.0, f) for f in (0.0, 0.5, 1.0)] == [10.0, 31.62, 100.0]
    assert [legs.toward_nominal(6, f) for f in (0.0, 0.5, 1.0)] == [4, 5, 6]
    assert [shape.toward_nominal("post", f) for f in (0.5, 1.0)] == ["disc", "post"]


def test_distance_is_the_mean_difference_of_positions():
    low, high = SPACE.values([0.0] * 4), SPACE.values([1.0] * 4)
    assert SPACE.distance(low, low) == 0.0
    assert SPACE.distance(low, high) == pytest.approx((1.0 + 1.0 + 0.75 + 2.0 / 3.0) / 4.0)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ContinuousRange(2.0, 1.0, 1.5), "low: must be less than high, which is 1"),
        (lambda: ContinuousRange(0.0, 1.0, 0.5, is_logarithmic=True), "low: must be positive"),
        (lambda: ContinuousRange(0.0, 1.0, 2.0), "nominal: must be between 0 and 1, got 2.0"),
        (lambda: ContinuousRange(0.0, float("inf"), 1.0), "high: must be a finite number"),
        (lambda: IntegerRange(1, 3, 2.5), "nominal: must be an integer, got 2.5"),
        (lambda: IntegerRange(3, 3, 3), "low: must be less than high"),
        (lambda: ChoiceRange(("a",), "a"), "values: must be at least two values"),
        (lambda: ChoiceRange(("a", "b", "a"), "a"), "values: must be at least two values"),
        (lambda: ChoiceRange(("a", "b"), "c"), "nominal: must be one of"),
        (lambda: SearchSpace({}), "ranges: must contain at least one key"),
        (lambda: SearchSpace({"x": (0.0, 1.0)}), "ranges.x: must be a ContinuousRange"),
    ],
)
def test_unusable_ranges_are_refused(build, message):
    with pytest.raises(InputError) as error:
        build()
    assert str(error.value).startswith(message)


def test_a_key_that_the_builder_refuses_is_named():
    def build(values):
        if values["legs"] > 5:
            raise InputError("vehicle.legs", values["legs"], "must be at most 5")

    with pytest.raises(InputError) as error:
        SPACE.check(build)
    assert error.value.field == "ranges.legs" and error.value.value == 6
    assert "vehicle.legs: must be at most 5" in str(error.value)
