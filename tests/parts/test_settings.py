"""Tables made from parts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest
from pydantic import ValidationError

from lunarsim.errors import InputError
from lunarsim.parts import kinds, resolve, settings_of
from lunarsim.parts.quantity import hidden, quantity
from lunarsim.parts.registry import CONTRACTS
from lunarsim.parts.settings import bounds_of, table_of, unit_of


@dataclass(frozen=True)
class Inner:
    """A part of a part."""

    tilt: float = quantity(30.0, "deg", gt=0, lt=90)

    def __post_init__(self) -> None:
        if self.tilt > np.deg2rad(80.0):
            raise InputError("inner.tilt", self.tilt, "less steep")


INNER = Inner()


@dataclass(frozen=True)
class Part:
    """A part of all sorts of fields.

    More words that are no business of a table.
    """

    required: float
    length: float = quantity(2.0, "m", gt=0, le=10, help="of the thing")
    corners: tuple[float, float] = quantity((10.0, 20.0), "deg", ge=0)
    several: tuple[int, ...] = quantity((1, 2), ge=1)
    mode: Literal["a", "b"] = quantity("a")
    maybe: float | None = quantity(None, "s", gt=0)
    on: bool = quantity(False)
    inner: Inner = quantity(INNER)
    made: tuple[int, ...] = field(default_factory=lambda: (7,))
    name: str = hidden("part")
    _own: int = 0
    derived: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        if self.maybe is not None and self.maybe > self.length:
            raise InputError("part.maybe", self.maybe, "no more than the length")
        if self.required == 13.0:
            raise InputError("elsewhere", self.required, "another number")


TABLE = settings_of(Part)


def test_keys_are_fields_with_their_units():
    assert list(TABLE.model_fields) == [
        "required", "length_m", "corners_deg", "several", "mode", "maybe_s", "on", "inner", "made",
    ]  # fmt: skip
    assert TABLE.__doc__ == "A part of all sorts of fields."
    assert TABLE.model_fields["length_m"].description == "of the thing"
    assert settings_of(Part) is TABLE
    assert [unit_of(TABLE, key) for key in ("length_m", "mode", "none")] == ["m", "", ""]
    assert bounds_of(TABLE, "length_m") == "> 0, <= 10"
    assert bounds_of(TABLE, "mode") == bounds_of(TABLE, "required") == ""


def test_a_table_makes_its_part_in_si_units():
    made = TABLE.model_validate(
        {"required": 1, "corners_deg": [0, 90], "maybe_s": 1.5, "inner": {"tilt_deg": 45},
         "several": [3, 4, 5]}
    ).make()  # fmt: skip
    assert isinstance(made, Part)
    assert made.corners == pytest.approx((0.0, np.pi / 2))
    assert made.inner == Inner(np.deg2rad(45.0))
    assert (made.maybe, made.several, made.length, made.name) == (1.5, (3, 4, 5), 2.0, "part")


def test_defaults_of_table_and_part_are_the_same():
    assert TABLE(required=1.0).make() == Part(1.0)
    assert TABLE(required=1.0).inner.tilt_deg == 30.0


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"required": float("nan")},
        {"required": float("inf")},
        {"required": "1 m"},
        {"required": 1, "length": 1.0},
        {"required": 1, "length_m": 0.0},
        {"required": 1, "length_m": 11.0},
        {"required": 1, "corners_deg": [0.0, -1.0]},
        {"required": 1, "corners_deg": [0.0]},
        {"required": 1, "several": [1, 0]},
        {"required": 1, "several": [1.5]},
        {"required": 1, "mode": "c"},
        {"required": 1, "maybe_s": 0.0},
        {"required": 1, "inner": {"tilt_deg": 90.0}},
        {"required": 1, "inner": {"tilt": 1.0}},
        {"required": 1, "name": "other"},
        {"required": 1, "_own": 1},
        {"required": 1, "derived": 1.0},
    ],
    ids=str,
)
def test_what_does_not_fit_is_refused(wrong):
    with pytest.raises(ValidationError):
        TABLE.model_validate(wrong)


def test_what_a_part_refuses_is_reported_by_the_tables_key_and_value():
    with pytest.raises(InputError) as caught:
        TABLE(required=1.0, maybe_s=3.0).make()
    assert (caught.value.field, caught.value.value) == ("maybe_s", 3.0)
    assert caught.value.problem == "no more than the length"
    with pytest.raises(InputError) as caught:
        TABLE(required=13.0).make()
    assert (caught.value.field, caught.value.value) == ("elsewhere", 13.0)
    # The part in a part: in degrees, as the file has it.
    with pytest.raises(InputError) as caught:
        TABLE(required=1.0, inner={"tilt_deg": 85.0}).make()
    assert (caught.value.field, caught.value.value) == ("inner.tilt_deg", 85.0)


def test_a_table_of_a_part_makes_that_part():
    part = Part(2.0, 3.0, (0.1, 0.2), (9,), "b", 1.0, True, Inner(0.4))
    back = table_of(part).make()
    assert back.corners == pytest.approx(part.corners, rel=1e-12)
    assert back.inner.tilt == pytest.approx(0.4, rel=1e-12)
    assert (back.several, back.mode, back.maybe, back.on) == ((9,), "b", 1.0, True)


def test_tables_cannot_be_changed():
    with pytest.raises(ValidationError, match="frozen"):
        TABLE(required=1.0).length_m = 3.0


def test_only_dataclasses_have_tables():
    class Plain:
        pass

    with pytest.raises(TypeError, match="Plain must be a dataclass to be a part"):
        settings_of(Plain)


@pytest.mark.parametrize(
    ("contract", "kind"), [(c, k) for c in CONTRACTS for k in CONTRACTS[c].kinds], ids=str
)
def test_every_part_of_the_package_has_a_table_that_comes_back(contract, kind):
    assert kind in kinds(contract)
    of = resolve(contract, kind)
    table = settings_of(of)
    if kind in ("dtm", "library", "fmu", "process", "trajectory"):  # they need a path
        with pytest.raises(InputError, match="path"):
            table().make()
        return
    assert table().make() == of()
    assert table_of(of()).make() == of()
    if contract != "vehicle":  # whose moments follow from its masses where its table says nothing
        assert table_of(of()) == table()
    written = table().model_dump(mode="json", exclude_none=True)
    assert table.model_validate(written) == table()
    for key, info in table.model_fields.items():
        assert not info.is_required(), key
