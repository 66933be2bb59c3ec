"""Error messages show values plainly and name the wrong element."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from lunarsim.errors import InputError, check_types
from lunarsim.value_checks import check_elements, check_finite, check_shape, check_time


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (np.float64(0.5), "0.5"),
        (np.array([1.0, np.nan]), "[1.0, nan]"),
        (np.zeros((5, 5)), "an array of shape (5, 5)"),
        (np.ndarray, "ndarray"),
        (Path("a/b.toml"), "'a/b.toml'"),
        ("", "''"),
        (None, "None"),
    ],
)
def test_values_are_shown_plainly(value, shown):
    assert str(InputError("x", value, "must be 1")) == f"x: must be 1, got {shown}."


def test_a_long_value_is_shortened_in_its_middle():
    message = str(InputError("x", "a" * 500 + "z", "must be short"))
    assert len(message) < 150
    assert " ... " in message
    assert message.endswith("z'.")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ((1.0, "a"), r"x\.pair\[1\]: must be a number, got 'a'\."),
        ((1.0,), r"x\.pair: must be 2 numbers, got \(1\.0,\)\."),
        ("ab", r"x\.pair: must be 2 numbers, got 'ab'\."),
        (1.0, r"x\.pair: must be 2 numbers, got 1\.0\."),
    ],
)
def test_a_sequence_of_numbers_has_its_length(value, message):
    @dataclass
    class Settings:
        pair: "tuple[float, float]"

    check_types("x", Settings((1.0, 2)))
    with pytest.raises(InputError, match=message):
        check_types("x", Settings(value))


def test_the_wrong_element_is_named():
    check_finite("x", [1.0, 2.0])
    with pytest.raises(InputError, match=r"^x\[1, 0\]: must be finite, got -inf\.$"):
        check_finite("x", [[1.0, 2.0], [-np.inf, 3.0]])
    with pytest.raises(InputError, match=r"^x: must be finite, got nan\.$"):
        check_finite("x", np.nan)
    with pytest.raises(InputError, match=r"^x: must be 0 or more, got -1\.0\. Mend it\.$"):
        check_elements("x", -1.0, False, "must be 0 or more", "Mend it.")
    with pytest.raises(InputError, match=r"^x: must have shape \(2,\) for 2 beams, got \(3,\)\.$"):
        check_shape("x", np.zeros(3), (2,), "for 2 beams")


def test_time_does_not_run_backwards():
    check_time("time", 0.0, -np.inf)
    with pytest.raises(InputError, match=r"must be at least the previous time, 1\.0 s, got 0"):
        check_time("time", 0.5, 1.0)
    with pytest.raises(InputError, match=r"must be finite, got nan"):
        check_time("time", np.nan, -np.inf)
