"""What a field of a part says of itself."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pytest

from lunarsim.errors import InputError
from lunarsim.parts import hidden, quantity
from lunarsim.parts.quantity import check_bounds, quantity_of


def test_degrees_of_the_default_are_radians_in_the_object():
    @dataclass(frozen=True)
    class Part:
        angle: float = quantity(90.0, "deg")
        beam: float = quantity(2.0, "mrad")
        length: float = quantity(3.0, "m")
        corners: tuple[float, float] = quantity((180.0, 45.0), "deg")
        left_out: float | None = quantity(None, "deg")

    part = Part()
    assert part.angle == pytest.approx(np.pi / 2)
    assert part.beam == pytest.approx(2e-3)
    assert part.length == 3.0
    assert part.corners == pytest.approx((np.pi, np.pi / 4))
    assert part.left_out is None


@pytest.mark.parametrize("unit", ["deg", "deg/s", "mrad", "m", "1"])
@pytest.mark.parametrize("value", [10.0, 0.1, (5.0, 33.3)])
def test_there_and_back_is_the_value_itself(unit, value):
    q = quantity_of(fields(_part(quantity(7.0, unit)))[0].metadata)
    assert q.from_si(q.to_si(value)) == pytest.approx(value, rel=1e-12)
    assert q.from_si(q.to_si(None)) is None


def test_a_default_comes_back_to_the_bit():
    """A scenario shows what was written, not what is left of it by way of radians."""
    third = 1.0 / 3.0
    q = quantity_of(fields(_part(quantity(third, "deg")))[0].metadata)
    assert q.from_si(q.to_si(third)) == third


def _part(declared) -> type:
    @dataclass(frozen=True)
    class Part:
        value: float = declared

    return Part


@pytest.mark.parametrize(
    ("unit", "suffix"),
    [("", ""), ("1", ""), ("m", "_m"), ("m/s^2", "_m_s2"), ("deg/s", "_deg_s"), ("rad/s", "_rad_s"),
     ("1/m^2", "_per_m2"), ("e-", "_electrons"), ("Hz", "_hz")],
)  # fmt: skip
def test_units_end_the_keys(unit, suffix):
    assert quantity_of(fields(_part(quantity(1.0, unit)))[0].metadata).suffix == suffix


def test_unknown_units_are_refused_where_they_are_written():
    with pytest.raises(ValueError, match=r"unit: must be one of .*'m/s'.*got 'furlong'"):
        quantity(1.0, "furlong")


def test_hidden_fields_say_so_and_plain_ones_say_nothing():
    @dataclass
    class Part:
        own: int = hidden(3)
        plain: int = 4

    own, plain = fields(Part)
    assert quantity_of(own.metadata).hidden
    assert quantity_of(plain.metadata) is None
    assert Part() == Part(3, 4)


@pytest.mark.parametrize(
    ("values", "field", "expected"),
    [
        ({"angle": np.deg2rad(91.0)}, "angle", "between 0 and 90 deg"),
        ({"angle": np.nan}, "angle", "finite"),
        ({"length": 0.0}, "length", "positive"),
        ({"length": np.inf}, "length", "finite"),
        ({"corners": (0.1, -1e-9)}, "corners[1]", "0 or more"),
        ({"corners": np.array([0.1, np.nan])}, "corners[1]", "finite"),
    ],
)
def test_parts_made_in_python_keep_the_bounds_of_their_fields(values, field, expected):
    @dataclass(frozen=True)
    class Part:
        angle: float = quantity(45.0, "deg", ge=0, le=90)
        length: float = quantity(1.0, "m", gt=0)
        corners: tuple[float, float] = quantity((0.0, 5.0), "deg", ge=0)
        left_out: float | None = quantity(None, "m", gt=0)
        own: float = hidden(-1.0)

    check_bounds(Part(), "part")
    with pytest.raises(InputError) as caught:
        check_bounds(Part(**values), "part")
    assert caught.value.field == f"part.{field}"
    assert expected in caught.value.problem
